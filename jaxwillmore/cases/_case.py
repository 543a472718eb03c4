"""A case: everything that decides a run, complete with defaults."""

import dataclasses
import typing

from ._energy_sections import ConstraintsCase, EnergyCase
from ._error import CaseError, shown
from ._keys import entries, sections_below
from ._mesh_section import MeshCase
from ._phase_section import MODULI, PhaseCase
from ._sections import BranchCase, EquilibriumCase, FlowCase, OutputCase, SurfaceCase, TimeCase
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
    phase: PhaseCase | None = None
    constraints: ConstraintsCase = ConstraintsCase()
    flow: FlowCase = FlowCase()
    time: TimeCase | None = None
    mesh: MeshCase = MeshCase()
    equilibrium: EquilibriumCase = EquilibriumCase()
    branch: BranchCase | None = None
    output: OutputCase = OutputCase()

    def __post_init__(self):
        for field in dataclasses.fields(self):
            section, kind = getattr(self, field.name), SECTIONS[field.name]
            absent = section is None and field.name in ("phase", "time", "branch")
            if not (absent or isinstance(section, kind)):
                problem = f"must be a `{kind.__name__}`; got {shown(section)}."
                raise CaseError(problem, section=field.name, got=section)
        object.__setattr__(self, "output", self.output.within(self.time))
        self._check_phase()

    def _check_phase(self):
        at_rest = self.flow.kind == "phase"
        if self.phase is None:
            if at_rest:
                problem = "needs a section [phase]: the surface is at rest, and nothing else moves."
                raise CaseError(problem, section="flow", key="kind", got="phase")
            return
        if self.flow.kind not in ("phase", "willmore"):
            problem = 'must be "willmore" (the surface bends) or "phase" (it rests) with [phase].'
            raise CaseError(problem, section="flow", key="kind", got=self.flow.kind)
        if self.flow.scheme != "implicit":
            problem = 'must be "implicit" with [phase], whose equations are not linear.'
            raise CaseError(problem, section="flow", key="scheme", got=self.flow.scheme)
        for key in MODULI:
            given, default = getattr(self.energy, key), getattr(EnergyCase(), key)
            if given != default:
                problem = f"belongs into [phase] where there is one: {key} = [at c = 0, at c = 1]."
                raise CaseError(problem, section="energy", key=key, got=given)
            if at_rest and getattr(self.phase, key) is not None:
                problem = 'has no effect with kind = "phase": the surface is at rest.'
                raise CaseError(problem, section="phase", key=key, got=getattr(self.phase, key))
        held = self.constraints
        if at_rest and self.mesh.remesh_when is not None:
            problem = 'has no effect with kind = "phase": the surface is at rest.'
            raise CaseError(problem, section="mesh", key="remesh_when", got=self.mesh.remesh_when)
        if at_rest and (held.area, held.volume, held.reduced_volume) != (None, None, None):
            problem = 'has no effect with kind = "phase": the surface is at rest.'
            raise CaseError(problem, section="constraints")

    def to_toml(self) -> str:
        """A case file with every key; reading it gives this case again."""
        later = (
            *self.energy.sections(),
            self.phase,
            self.constraints,
            self.flow,
            self.time,
            self.mesh,
            self.equilibrium,
            self.branch,
            self.output,
        )
        own = entries(self.energy)
        if self.phase is not None:
            own = [(k, None, "see [phase]") if k in MODULI else (k, v, m) for k, v, m in own]
        tables = {
            "surface": self.surface.entries(),
            "energy": own + self.energy.remarks(),
            **{section.name: entries(section) for section in later if section is not None},
        }
        return emit(tables)


SECTIONS = {
    kind.name: kind
    for kind in (
        *(
            SurfaceCase,
            EnergyCase,
            *sections_below(EnergyCase).values(),
            PhaseCase,
            ConstraintsCase,
        ),
        *(FlowCase, TimeCase, MeshCase, EquilibriumCase, BranchCase, OutputCase),
    )
}
