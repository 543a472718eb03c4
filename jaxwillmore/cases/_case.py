"""A case: everything that decides a run, complete with defaults."""

import dataclasses
import typing

from ._error import CaseError, shown
from ._sections import (
    ConstraintsCase,
    EnergyCase,
    FlowCase,
    OutputCase,
    SurfaceCase,
    TimeCase,
    entries,
)
from ._toml import emit


@typing.no_type_check
@dataclasses.dataclass(frozen=True, kw_only=True)
class Case:
    """A surface, an energy, a flow, a time interval and what to write.

    Values are checked when the case is made; what is wrong is a `CaseError` naming section, key,
    value and allowed range. `jaxwillmore.cases.load_case` reads one from a file.

    ```python
    case = Case(surface=SurfaceCase(shape="torus"), time=TimeCase(t1=1.0))
    run_case(case, "out/torus")
    ```
    """

    surface: SurfaceCase
    energy: EnergyCase = EnergyCase()
    constraints: ConstraintsCase = ConstraintsCase()
    flow: FlowCase = FlowCase()
    time: TimeCase
    output: OutputCase = OutputCase()

    def __post_init__(self):
        for field in dataclasses.fields(self):
            section, kind = getattr(self, field.name), SECTIONS[field.name]
            if not isinstance(section, kind):
                problem = f"must be a `{kind.__name__}`; got {shown(section)}."
                raise CaseError(problem, section=field.name, got=section)
        object.__setattr__(self, "output", self.output.within(self.time))

    def to_toml(self) -> str:
        """A case file with every key; reading it gives this case again."""
        return emit(
            {
                "surface": self.surface.entries(),
                "energy": entries(self.energy),
                "constraints": entries(self.constraints),
                "flow": entries(self.flow),
                "time": entries(self.time),
                "output": entries(self.output),
            }
        )


SECTIONS = {
    kind.name: kind
    for kind in (SurfaceCase, EnergyCase, ConstraintsCase, FlowCase, TimeCase, OutputCase)
}
