"""A case: everything that decides a run, complete with defaults."""

import dataclasses
import typing

from ._energy_sections import GLOBAL_ENERGIES, ConstraintsCase, EnergyCase
from ._error import CaseError, shown
from ._keys import entries
from ._sections import BranchCase, FlowCase, OutputCase, SurfaceCase, TimeCase
from ._toml import emit


@typing.no_type_check
@dataclasses.dataclass(frozen=True, kw_only=True)
class Case:
    """A surface, an energy, what is held, and a flow in time or a branch of equilibria.

    Values are checked when the case is made; what is wrong is a `CaseError` naming section, key,
    value and allowed range. `jaxwillmore.cases.load_case` reads one from a file. A flow needs
    `time`, a branch `branch`, an equilibrium neither.

    ```python
    case = Case(surface=SurfaceCase(shape="torus"), time=TimeCase(t1=1.0))
    run_case(case, "out/torus")
    ```
    """

    surface: SurfaceCase
    energy: EnergyCase = EnergyCase()
    constraints: ConstraintsCase = ConstraintsCase()
    flow: FlowCase = FlowCase()
    time: TimeCase | None = None
    branch: BranchCase | None = None
    output: OutputCase = OutputCase()

    def __post_init__(self):
        for field in dataclasses.fields(self):
            section, kind = getattr(self, field.name), SECTIONS[field.name]
            absent = section is None and field.name in ("time", "branch")
            if not (absent or isinstance(section, kind)):
                problem = f"must be a `{kind.__name__}`; got {shown(section)}."
                raise CaseError(problem, section=field.name, got=section)
        object.__setattr__(self, "output", self.output.within(self.time))

    def to_toml(self) -> str:
        """A case file with every key; reading it gives this case again."""
        energies = [getattr(self.energy, key) for key in GLOBAL_ENERGIES]
        later = (*energies, self.constraints, self.flow, self.time, self.branch, self.output)
        tables = {
            "surface": self.surface.entries(),
            "energy": entries(self.energy) + self.energy.remarks(),
            **{section.name: entries(section) for section in later if section is not None},
        }
        return emit(tables)


SECTIONS = {
    kind.name: kind
    for kind in (
        *(SurfaceCase, EnergyCase, *GLOBAL_ENERGIES.values(), ConstraintsCase),
        *(FlowCase, TimeCase, BranchCase, OutputCase),
    )
}
