"""A flow: laws that share one surface, composed into one system of equations."""

from collections import Counter
from functools import reduce
from operator import add
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fem import Jet, Layout, Point, inner
from ..mesh import SurfaceMesh
from ..surface import weingarten
from ._law import AbstractLaw, Field, Globals, Local, Statement, Units, Whole

# The tangential velocity of the nodes; a law that has it as an unknown makes nodes slip past the
# material.
SLIP = "w"


def composed_velocity(V: Jet, nu: Jet, w: Jet) -> Jet:
    r"""$v = V\nu + w$, with the gradient $\nu\otimes\nabla V + V\nabla\nu + \nabla w$."""
    gradient = jnp.outer(nu.value, V.grad) + V.value * nu.grad + w.grad
    return Jet(V.value * nu.value + w.value, gradient)


def material_transport(w: Jet, phi: Jet, chi: Jet) -> Float[Array, ""]:
    r"""$-(w\cdot\nabla\phi, \chi)$: nodes slip by $w$ past material that carries $\phi$."""
    return -inner(w.value, phi.grad) * chi.value


def conserved_transport(w: Jet, c: Jet, chi: Jet) -> Float[Array, ""]:
    r"""$(c\,w, \nabla\chi)$ in $\mathrm d(c, \chi)/\mathrm dt + (c\,w, \nabla\chi) = \dots$"""
    return c.value * inner(w.value, chi.grad)


def mean_curvature_transport(v: Jet, H: Jet, chi: Jet) -> Float[Array, ""]:
    r"""$-(v\cdot\nabla H, \chi)$ of $\partial^\bullet H = -\Delta V - |A|^2 V + v\cdot\nabla H$."""
    return -inner(v.value, H.grad) * chi.value


def normal_transport(v: Jet, nu: Jet, chi: Jet) -> Float[Array, ""]:
    r"""$-(A v, \chi)$ of $\partial^\bullet\nu = -\nabla V + A v$."""
    return -inner(weingarten(nu) @ v.value, chi.value)


class System(eqx.Module):
    r"""Laws that act on one surface together.

    Fields stand in the order of the laws, which is also that in which a linearly implicit step
    solves for them. Where one of the laws moves the nodes along the surface, every field gets the
    transport of its role, and parameters that sit on the nodes (`Statement.carried`) become
    unknowns, which stay with their material points.

    **Arguments:**

    - `laws`: at most one of each kind: a law of the surface (`WillmoreFlow`, `HelfrichFlow`,
      `MeanCurvatureFlow`, `SurfaceDiffusion`) or of its motion (`GivenMotion`; none: the surface is
      at rest), the energy and the kinetics of a concentration (`Mixing`, `CahnHilliard`,
      `AllenCahn`), `Loads`, `Forcing`, `NoDrift`, `MinimalDeformation`; or laws of your own.

    **Raises:** `ValueError` for something that is no law, for two laws with an unknown of the same
    name, and for a law that reads a field which none has.

    ```python
    flow = jw.flows.System(
        jw.flows.WillmoreFlow(), jw.flows.Loads(area=A, volume=V), jw.flows.MinimalDeformation()
    )
    ```
    """

    laws: tuple[AbstractLaw, ...]

    def __init__(self, *laws: "AbstractLaw | System"):
        parts = [law.laws if isinstance(law, System) else (law,) for law in laws]
        self.laws = tuple(law for part in parts for law in part)
        _check(self.laws)

    @property
    def _statements(self) -> tuple[Statement, ...]:
        return tuple(law.statement() for law in self.laws)

    @property
    def fields(self) -> tuple[Field, ...]:
        """All unknowns on the nodes, carried parameters last where nodes slip past them."""
        statements = self._statements
        own = tuple(field for s in statements for field in s.fields)
        if all(field.name != SLIP for field in own):
            return own
        return own + tuple(
            _carried_field(n, phi) for s in statements for n, phi in s.carried.items()
        )

    @property
    def layout(self) -> Layout:
        """The columns of the unknowns."""
        fields = self.fields
        return Layout(tuple(f.name for f in fields), tuple(f.components for f in fields))

    @property
    def evolving(self) -> tuple[str, ...]:
        """The unknowns whose equation has a time derivative; the others are algebraic."""
        return tuple(f.name for f in self.fields if f.role != "algebraic")

    @property
    def conserved(self) -> tuple[str, ...]:
        """The unknowns whose integral only their flux changes."""
        return tuple(f.name for f in self.fields if f.role == "conserved")

    @property
    def stages(self) -> tuple[tuple[str, ...], ...]:
        """Groups of unknowns that decouple when the coefficients are frozen, in order."""
        groups: list[tuple[str, ...]] = []
        for s in self._statements:
            groups += s.stages or [(field.name,) for field in s.fields]
        known = {name for group in groups for name in group}
        return (*groups, *((f.name,) for f in self.fields if f.name not in known))

    @property
    def carried(self) -> dict[str, Array]:
        """Parameters that sit on material points, by name."""
        return {name: phi for s in self._statements for name, phi in s.carried.items()}

    @property
    def data_names(self) -> tuple[str, ...]:
        """Names of the nodal data of a step."""
        unknown = {f.name for f in self.fields}
        names = [name for s in self._statements for name in (*s.data, *s.carried)]
        return tuple(name for name in names if name not in unknown)

    @property
    def global_names(self) -> tuple[str, ...]:
        """Names of the global unknowns, in order."""
        return tuple(name for part in self._globals for name in part.names)

    @property
    def n_globals(self) -> int:
        """Number of global unknowns."""
        return len(self.global_names)

    @property
    def _globals(self) -> tuple[Globals, ...]:
        return tuple(s.globals for s in self._statements if s.globals is not None)

    @property
    def lowers_energy(self) -> bool:
        """Whether the energy falls in time, or some law does work."""
        return all(s.lowers_energy for s in self._statements)

    @property
    def implicit_only(self) -> bool:
        """Whether a law has no linearly implicit scheme."""
        return any(s.implicit_only for s in self._statements)

    @property
    def moves(self) -> bool:
        """Whether the nodes follow from the unknowns; else their path is given, or they rest."""
        return any(s.velocity for s in self._statements)

    def local(self, point: Point, rate, hat, trial, data, multipliers) -> Local:
        """What the equations read at one point; `multipliers` is an array."""
        unknown = {name: getattr(hat, name) for name in self.carried if hasattr(hat, name)}
        data = SimpleNamespace(**{**vars(data), **unknown})
        named = self.named(multipliers)
        return Local(self._statements, point, rate, hat, trial, data, named)

    def named(self, multipliers: Float[Array, "*globals"]) -> SimpleNamespace:
        """The global unknowns by name."""
        pairs = zip(self.global_names, multipliers, strict=False)
        return SimpleNamespace(**dict(pairs))

    def equation(self, name: str, s: Local, chi: Jet) -> Float[Array, ""]:
        """The equation of one field with the transport of its role, tested with `chi`."""
        field = next(f for f in self.fields if f.name == name)
        return field.equation(s, chi) + self._transport(field, s, chi)

    def _transport(self, field: Field, s: Local, chi: Jet) -> Float[Array, ""]:
        if field.role == "algebraic" or not hasattr(s.hat, SLIP):
            return jnp.zeros(())
        if field.role == "material":
            return material_transport(s.trial.w, getattr(s.trial, field.name), chi)
        if field.role == "conserved":
            return conserved_transport(s.trial.w, getattr(s.trial, field.name), chi)
        v = composed_velocity(s.hat.V, s.hat.nu, s.hat.w)
        if field.components == 1:
            return mean_curvature_transport(v, getattr(s.hat, field.name), chi)
        return normal_transport(v, getattr(s.hat, field.name), chi)

    def velocity(self, nodal: SimpleNamespace) -> Float[Array, "3"]:
        """Velocity of one node from the unknowns there."""
        parts = [s.velocity(nodal) for s in self._statements if s.velocity]
        return reduce(add, parts)

    def velocity_of(self, U_j: Float[Array, " fields"]) -> Float[Array, "3"]:
        """The same from the columns of the unknowns of that node."""
        return self.velocity(SimpleNamespace(**self.layout.split(U_j)))

    def position(self, t: Float[Array, ""], x: Float[Array, "nodes 3"]) -> Float[Array, "nodes 3"]:
        """Nodes of a surface that does not follow from the unknowns; `x`: where they are now."""
        paths = [s.position for s in self._statements if s.position]
        return paths[0](t) if paths else x

    def units(self, length: Float[Array, ""]) -> Units:
        """Sizes that the unknowns are compared with on a surface of size `length`."""
        statements = self._statements
        potentials = [s.potential(length) for s in statements if s.potential]
        potential = sum(potentials, start=jnp.zeros(())) if potentials else jnp.ones(())
        times = [s.length_time(length) for s in statements if s.length_time]
        times += [s.diffusion_time(length, potential) for s in statements if s.diffusion_time]
        time = reduce(jnp.minimum, times) if times else jnp.ones(())
        return Units(length, potential, time)

    def scales(self, units: Units) -> Float[Array, " fields"]:
        """Typical size of every column of the unknowns."""
        columns = [f.scale(units) for f in self.fields for _ in range(f.components)]
        return jnp.stack(columns)

    def global_scales(self, units: Units) -> Float[Array, " globals"]:
        """Typical size of every global unknown."""
        return jnp.concatenate([jnp.zeros(0), *(g.scales(units) for g in self._globals)])

    def closures(self, s: Whole) -> Float[Array, " globals"]:
        """One equation per global unknown on the new surface, scaled to order one."""
        return jnp.concatenate([jnp.zeros(0), *(g.closures(s) for g in self._globals)])

    def nodal_data(self, s: Whole) -> Float[Array, "nodes data"]:
        """The columns of `data_names`."""
        # One of the fields where it is an unknown, and otherwise the parameter itself.
        fields = self.carried | s.fields
        s = Whole(s.t, s.mesh, s.x, fields, s.multipliers, s.units)
        values = {name: of(s) for part in self._statements for name, of in part.data.items()}
        columns = [(values | fields)[name] for name in self.data_names]
        return jnp.stack(columns, axis=1) if columns else jnp.zeros((s.mesh.n_nodes, 0))

    def start(
        self, mesh: SurfaceMesh, x: Float[Array, "nodes 3"], given: dict[str, Array]
    ) -> dict[str, Array]:
        """The fields with a time derivative at the start: as given, or recovered."""
        for name, phi in self.carried.items():
            if phi.shape != (mesh.n_nodes,):
                raise ValueError(
                    f"`{name}` must be one number, or one for each of the {mesh.n_nodes} nodes; "
                    f"got shape {phi.shape}."
                )
        out = {}
        for s in self._statements:
            if s.start:
                out |= s.start(mesh, x, given)
        unknown = {f.name for f in self.fields}
        carried = {name: phi for name, phi in self.carried.items() if name in unknown}
        return out | {name: given.get(name, phi) for name, phi in carried.items()}

    def energy(
        self,
        mesh: SurfaceMesh,
        x: Float[Array, "nodes 3"],
        fields: dict[str, Array] | None = None,
    ) -> Float[Array, ""]:
        """What the flow lowers, from the nodes and the fields of the moment."""
        parts = (s.energy(mesh, x, fields) for s in self._statements if s.energy is not None)
        return sum(parts, start=jnp.zeros(()))

    def energy_scale(
        self,
        mesh: SurfaceMesh,
        x: Float[Array, "nodes 3"],
        fields: dict[str, Array] | None = None,
    ) -> Float[Array, ""]:
        r"""The sizes of the terms of the energy, added: $\sum_i |E_i|$ for $E = \sum_i E_i$.

        What a change of the energy is small against. The energy itself passes through zero where
        its terms cancel, and their discretisation errors do not.
        """
        parts = (s.energy.scale(mesh, x, fields) for s in self._statements if s.energy is not None)
        return sum(parts, start=jnp.zeros(()))

    def record(self, s: Whole) -> dict[str, Float[Array, ""]]:
        """Columns of the history that the laws have."""
        parts = (part.record(s) for part in self._statements if part.record)
        return {name: value for part in parts for name, value in part.items()}

    def activity(self, s: Whole) -> Float[Array, ""]:
        """How far the flow is from rest, scaled to order one: the largest of all laws."""
        parts = [part.activity(s) for part in self._statements if part.activity]
        return reduce(jnp.maximum, parts) if parts else jnp.zeros(())


def as_system(flow) -> System:
    """A system as it is; a law as the system of this one law."""
    return flow if isinstance(flow, System) else System(flow)


def _carried_field(name: str, phi: Float[Array, " nodes"]) -> Field:
    def equation(s: Local, chi: Jet):
        return getattr(s.rate, name) * chi.value

    return Field(name, equation, lambda _: _size(phi), role="material")


def _size(phi: Float[Array, " nodes"]) -> Float[Array, ""]:
    """The largest value of a field; one for a field that is zero."""
    size = jnp.max(jnp.abs(jax.lax.stop_gradient(phi)))
    return jnp.where(size > 0, size, 1.0)


def _check(laws) -> None:
    """Refuse what is no law, names that two laws have, and fields that none has."""
    if not laws:
        raise ValueError("A system needs at least one law.")
    for law in laws:
        if not isinstance(law, AbstractLaw):
            name = law.__name__ if isinstance(law, type) else type(law).__name__
            hint = f" Write `{name}(...)`." if isinstance(law, type) else ""
            raise ValueError(f"A system is made of laws; got {name}, which is none.{hint}")
    statements = [(type(law).__name__, law.statement()) for law in laws]
    owners: dict[str, str] = {}
    for law, s in statements:
        kinds = {
            "unknown": [f.name for f in s.fields],
            "nodal field": [*s.data, *s.carried],
            "global unknown": s.globals.names if s.globals else (),
        }
        for kind, name in ((kind, name) for kind, names in kinds.items() for name in names):
            if name in owners:
                raise ValueError(
                    f"Two laws have the {kind} `{name}`: {owners[name]} and {law}. A system "
                    "has one law of a kind; put all loads into one `Loads`, add energies and "
                    "forcings, not laws."
                )
            owners[name] = law
    present = {f.name for _, s in statements for f in s.fields}
    for law, s in statements:
        missing = [name for name in s.reads if name not in present]
        if missing:
            raise ValueError(
                f"{law} needs {', '.join(f'`{name}`' for name in missing)}, which no law of the "
                f"system has; it has {', '.join(sorted(present)) or 'no fields'}."
            )
        staged = Counter(name for stage in s.stages for name in stage)
        if staged and staged != Counter(f.name for f in s.fields):
            raise ValueError(f"The stages of {law} must hold each of its fields once.")
    following = [law for law, s in statements if s.needs_density]
    if following and not any(s.density for _, s in statements):
        raise ValueError(
            f"{following[0]} lowers an energy of the concentration, and no law of the system has "
            "one; add `Mixing(GinzburgLandau(...))`."
        )
    movers = [law for law, s in statements if s.position]
    if len(movers) > 1 or (movers and any(s.velocity for _, s in statements)):
        raise ValueError(
            f"{movers[0]} gives the path of the nodes, and another law moves them too; "
            "leave one of them out."
        )
