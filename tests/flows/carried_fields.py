"""A flow with carried fields on an ellipsoid: exact law, and the discrete law with its errors."""

from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxwillmore.fem import Jet, integrate, load, project
from jaxwillmore.flows import HelfrichFlow, as_system
from jaxwillmore.surface import Ellipsoid

from ..energies.variations import Exact
from .systems import equation, nodal_data

AXES = (1.0, 1.2, 1.5)
EXACT = Exact(Ellipsoid(AXES))


# Fields in space without symmetry; their values at the nodes are the nodal fields.
def b(p):
    return 1.2 + 0.4 * jnp.sin(p[0] + 0.5 * p[1]) + 0.2 * p[2]


def H0(p):
    return 0.4 + 0.3 * p[2] * p[0] + 0.2 * p[1]


def b_k(p):
    return 0.3 * jnp.exp(0.5 * p[0]) * (1 + p[1] * p[2])


def on(x, f):
    return jax.vmap(f)(x)


def flow_on(x):
    """The flow with all three fields on the nodes `x`."""
    return HelfrichFlow(0.5 * on(x, b), on(x, H0), on(x, b_k))


def U(p):
    return b(p) * (EXACT.H(p) - H0(p))


def speed(p):
    """V = ΔU + |A|²U − ½bH(H − H₀)² + ∇·((HI − A)∇b_k), each term made from its definition."""
    H, excess = EXACT.H(p), EXACT.H(p) - H0(p)
    return (
        EXACT.laplacian(U)(p)
        + EXACT.A2(p) * U(p)
        - 0.5 * b(p) * H * excess**2
        + EXACT.gauss_operator(b_k)(p)
    )


def constant(value):
    return Jet(jnp.asarray(value), jnp.zeros(3))


def velocity_of_law(flow, mesh, x, H, nu, multipliers=()):
    """V_h of the discrete law for nodal H and ν, from the equations of the flow."""
    flow = as_system(flow)
    fields = {"H": H, "nu": nu}
    data = nodal_data(flow, mesh, x, fields)
    fields |= {f"data_{name}": values for name, values in data.items()}
    zero = constant(0.0)

    def solve(name, solved):
        def density(here, f, phi, grad):
            hat = SimpleNamespace(H=f.H, nu=f.nu)
            data = SimpleNamespace(**{n: getattr(f, f"data_{n}") for n in flow.data_names})
            trial = SimpleNamespace(H=f.H, nu=f.nu, V=zero, q=getattr(f, "q", zero))
            if name == "q":
                trial.q = zero
            chi, rate = Jet(phi, grad), SimpleNamespace()
            return -equation(flow, name, here, rate, hat, trial, data, chi, multipliers)

        return project(mesh, x, load(mesh, x, density, fields | solved)[:, None])[:, 0]

    solved = {"q": solve("q", {})} if "q" in flow.layout.names else {}
    return solve("V", solved)


@eqx.filter_jit
def descent(flow, law, mesh, x, multipliers=()):
    """Relative errors of dE(V_h ν) = −∫V_h², of dE(φν) = −∫V_h φ for a smooth φ, and of V_h."""
    H, nu, phi = on(x, EXACT.H), on(x, EXACT.normal), x[:, 0] ** 2
    V = velocity_of_law(flow, mesh, x, H, nu, multipliers)
    _, slopes = jax.linearize(lambda x: as_system(flow).energy(mesh, x), x)
    fields = {"V": V, "exact": law(x), "phi": phi}

    def density(_, f):
        V, exact, phi = f.V.value, f.exact.value, f.phi.value
        return jnp.stack([V**2, V * phi, jnp.abs(V * phi), (V - exact) ** 2, exact**2])

    square, weak, size, error, exact = integrate(mesh, x, density, fields)
    rate = jnp.abs(slopes(V[:, None] * nu) + square) / square
    weak = jnp.abs(slopes(phi[:, None] * nu) + weak) / size
    return jnp.stack([rate, weak, jnp.sqrt(error / exact)])
