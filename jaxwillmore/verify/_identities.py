r"""The identities behind the shape derivatives, each checked against an independent answer.

Some hold at every point of a smooth surface and are checked by moving the exact surface through
its charts, where no level set and no mesh takes part; the others hold for the discrete surface up
to its order.
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..energies import Willmore, shape_derivative
from ..fem import inner, integrate
from ..mesh import SurfaceMesh, icosphere
from ..surface import area, gaussian_curvature, recover_normal, weingarten
from ._exact_surface import ExactSurface
from ._orders import with_orders
from ._shape_derivative import normal_speed

Row = dict[str, Any]


def chart_geometry(chart, uv: Float[Array, "2"]):
    r"""Normal and mean curvature of a parametrised surface, from its fundamental forms.

    $\nu = X_u\times X_v/|X_u\times X_v|$, $H = g^{ij}\,\nu_i\cdot X_j$.
    """

    def normal(uv):
        T = jax.jacfwd(chart)(uv)
        cross = jnp.cross(T[:, 0], T[:, 1])
        return cross / jnp.sqrt(jnp.sum(cross * cross))

    T, D = jax.jacfwd(chart)(uv), jax.jacfwd(normal)(uv)
    return normal(uv), jnp.trace(jnp.linalg.solve(T.T @ T, T.T @ D))


@eqx.filter_jit
def material_derivatives(surface: ExactSurface, every: int = 37) -> dict[str, Float[Array, ""]]:
    r"""Largest defect of the laws of motion, over a subset of the quadrature points.

    The charts are moved, $X_t = X + tV\nu$, and differentiated by $t$; the right sides come from
    the level set: $\partial^\bullet H = -\Delta V - |A|^2V$, $\partial^\bullet\nu = -\nabla V$ and,
    for the parallel surfaces $V = 1$, $\partial_\nu H = -|A|^2$. Relative to the right side.
    """
    level_set, zero = surface.level_set, jnp.zeros(2)

    def moved(base, speed):
        def at_time(t):
            def chart(uv):
                def still(uv):
                    return surface.chart(base, uv)

                X, nu = still(uv), chart_geometry(still, uv)[0]
                return X + t * speed(X) * nu

            return chart_geometry(chart, zero)

        return jax.jvp(at_time, (jnp.zeros(()),), (jnp.ones(()),))[1]

    def defects(base):
        p = surface.chart(base, zero)
        A = level_set.weingarten(p[None])[0]
        V = surface.jet(normal_speed, p)
        of_normal, of_curvature = moved(base, normal_speed)
        of_parallel = moved(base, lambda X: jnp.ones(()))[1]
        law = -surface.laplacian(normal_speed, p) - inner(A, A) * V.value
        pairs = ((of_curvature, law), (of_normal, -V.grad), (of_parallel, -inner(A, A)))
        differences = jnp.stack([jnp.max(jnp.abs(a - b)) for a, b in pairs])
        return differences, jnp.stack([jnp.max(jnp.abs(b)) for _, b in pairs])

    differences, sizes = jax.vmap(defects)(surface.bases[::every])
    worst = jnp.max(differences, axis=0) / jnp.max(sizes, axis=0)
    names = ("dH/dt = -Lap V - |A|^2 V", "dnu/dt = -grad V", "dH/dnu = -|A|^2")
    return dict(zip(names, worst, strict=True))


@eqx.filter_jit
def _curvature_sides(surface: ExactSurface):
    r"""$\int\nabla H\cdot\chi$ and $\int K$ over the exact surface."""
    p, weights = surface.points()
    work = jnp.sum(surface.level_set.mean_curvature_gradient(p) * jax.vmap(_test_field)(p), axis=1)
    return jnp.sum(weights * work), jnp.sum(weights * surface.level_set.gaussian_curvature(p))


@eqx.filter_jit
def _discrete_sides(mesh: SurfaceMesh, x, normal):
    r"""$\int -\nabla\nu\cdot\nabla\chi + |A|^2\nu\cdot\chi$ and $\int K$ over the discrete one."""
    fields = {"nu": normal, "chi": jax.vmap(_test_field)(x), "own": recover_normal(mesh, x)}

    def density(_, f):
        A = weingarten(f.nu)
        work = inner(A, A) * jnp.dot(f.nu.value, f.chi.value) - inner(f.nu.grad, f.chi.grad)
        return jnp.stack([work, gaussian_curvature(weingarten(f.own))])

    return integrate(mesh, x, density, fields)


def _test_field(p: Float[Array, "3"]) -> Float[Array, "3"]:
    return jnp.stack([p[0] + p[1] ** 2, jnp.sin(p[2]) - 0.4 * p[1], 0.7 * p[2] + p[0] * p[1]])


def identity_rows(
    surface: ExactSurface, levels: Sequence[int] = (1, 2, 3), degree: int = 2
) -> list[Row]:
    r"""Rows `identity`, `nodes`, `h`, `error`, `error_order`; the exact identities have no mesh.

    - the three laws of motion of `material_derivatives`;
    - $\nabla H = \Delta\nu + |A|^2\nu$, tested with a vector field and by parts, with the nodal
      interpolant of the exact normal on the discrete surface;
    - Gauss–Bonnet $\int K = 2\pi\chi$ with the Weingarten map of the recovered normals, relative
      to $4\pi$; and with the exact K, by quadrature.
    """
    work, total = _curvature_sides(surface)
    head = {"surface": surface.name}
    rows = [
        head | {"identity": name, "error": float(value)}
        for name, value in material_derivatives(surface).items()
    ]
    weak, bonnet = [], []
    for level in levels:
        mesh, x = surface.generate(level, degree)
        found = _discrete_sides(mesh, x, surface.level_set.normal(x))
        h = float(jnp.sqrt(area(mesh, x) / mesh.n_cells * 4 / jnp.sqrt(3.0)))
        row = head | {"nodes": mesh.n_nodes, "h": h}
        chi = 2 * np.pi * mesh.euler_characteristic
        weak.append(row | {"identity": "grad H = Lap nu + |A|^2 nu"})
        weak[-1]["error"] = abs(float(found[0] / work) - 1)
        bonnet.append(row | {"identity": "Gauss-Bonnet"})
        bonnet[-1]["error"] = abs(float(found[1]) - chi) / (4 * np.pi)
        if len(bonnet) == 1:
            exact = {"identity": "Gauss-Bonnet, exact", "error": abs(float(total) - chi)}
            rows.append(head | exact)
    return rows + with_orders(weak, "h", ("error",)) + with_orders(bonnet, "h", ("error",))


@eqx.filter_jit
def _second_variation(mesh: SurfaceMesh, x, V):
    def slope(x):
        return shape_derivative(Willmore(), mesh, x, V[:, None] * normal)

    normal = x / jnp.linalg.norm(x, axis=1, keepdims=True)
    curvature = jax.jvp(slope, (x,), (V[:, None] * normal,))[1]
    return curvature / integrate(mesh, x, lambda _, f: f.V.value**2, {"V": V})


_HARMONICS = {
    2: lambda p: p[0] * p[1] + 0.3 * (3 * p[2] ** 2 - 1),
    3: lambda p: p[0] * p[1] * p[2] + 0.2 * p[0] * (5 * p[2] ** 2 - 1),
    4: lambda p: p[0] * p[1] * (7 * p[2] ** 2 - 1),
}


def second_variation_rows(levels: Sequence[int] = (2, 3), degree: int = 2) -> list[Row]:
    r"""Rows of the second variation of the Willmore energy of the unit sphere.

    $\mathrm{d}^2E(Y\nu, Y\nu)/\int Y^2 = (l-1)l(l+1)(l+2)$ for a spherical harmonic Y of degree l;
    the discrete one by forward mode twice. Spheres are critical, so the path does not matter.
    """
    rows = []
    for mode, harmonic in _HARMONICS.items():
        exact = (mode - 1) * mode * (mode + 1) * (mode + 2)
        own = []
        for level in levels:
            mesh, x = icosphere(level, degree)
            found = float(_second_variation(mesh, x, jax.vmap(harmonic)(x)))
            h = float(jnp.sqrt(area(mesh, x) / mesh.n_cells * 4 / jnp.sqrt(3.0)))
            row = {"mode": mode, "nodes": mesh.n_nodes, "h": h, "exact": exact}
            own.append(row | {"second_variation": found, "error": abs(found / exact - 1)})
        rows += with_orders(own, "h", ("error",))
    return rows
