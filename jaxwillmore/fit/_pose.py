"""Where a model stands: rotation, translation and size."""

import itertools

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

POSE_NAMES = ("turn_x", "turn_y", "turn_z", "shift_x", "shift_y", "shift_z", "log_size")


class Pose(eqx.Module):
    """A frame, about which a fit moves a surface of unit size.

    **Attributes:**

    - `axes`: the rotation in the frame.
    - `origin`: where the origin of the model goes.
    - `size`: length of the unit of the model.
    """

    axes: Float[Array, "3 3"]
    origin: Float[Array, "3"]
    size: Float[Array, ""]

    @eqx.filter_jit
    def place(
        self, x: Float[Array, "nodes 3"], motion: Float[Array, "7"]
    ) -> Float[Array, "nodes 3"]:
        r"""Nodes turned, scaled and moved.

        **Arguments:**

        - `motion`: half the turn as a Rodrigues vector $\tan(\alpha/2)\,a$ about the axis a; shift
          in units of `size`; logarithm of a factor of size. Zero gives the frame itself.
        """
        turned = x @ (rotation(motion[:3]) @ self.axes).T
        return self.origin[None] + self.size * (motion[None, 3:6] + jnp.exp(motion[6]) * turned)

    @eqx.filter_jit
    def back(
        self, x: Float[Array, "nodes 3"], motion: Float[Array, "7"]
    ) -> Float[Array, "nodes 3"]:
        """The inverse of `place`."""
        turned = (x - self.origin[None]) / self.size - motion[None, 3:6]
        return turned * jnp.exp(-motion[6]) @ (rotation(motion[:3]) @ self.axes)

    @eqx.filter_jit
    def moved(self, motion: Float[Array, "7"]) -> "Pose":
        """The frame that a motion leads to."""
        axes = rotation(motion[:3]) @ self.axes
        origin = self.origin + self.size * motion[3:6]
        return Pose(axes, origin, self.size * jnp.exp(motion[6]))


def rotation(g: Float[Array, "3"]) -> Float[Array, "3 3"]:
    r"""The rotation with Rodrigues vector $g = \tan(\alpha/2)\,a$, smooth at zero.

    $R = 1 + \frac{2}{1 + |g|^2} (G + G^2)$ with $Gv = g \times v$.
    """
    zero = jnp.zeros(())
    G = jnp.stack([zero, -g[2], g[1], g[2], zero, -g[0], -g[1], g[0], zero]).reshape(3, 3)
    return jnp.eye(3) + 2 / (1 + jnp.sum(g * g)) * (G + G @ G)


def principal_axes(
    x: Float[np.ndarray, "nodes 3"], weights: Float[np.ndarray, " nodes"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Mean and principal axes (as columns, by ascending spread, right-handed) of weighted nodes."""
    w = weights / weights.sum()
    mean = w @ x
    axes = np.linalg.eigh((x - mean).T * w @ (x - mean))[1]
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    return mean, axes


def aligned(
    model: Float[np.ndarray, "nodes 3"],
    model_weights: Float[np.ndarray, " nodes"],
    target: Float[np.ndarray, "points 3"],
    target_weights: Float[np.ndarray, " points"],
    size: float,
) -> list[Pose]:
    """The four frames that lay the principal axes of a model along those of a target."""
    to_mean, to = principal_axes(target, target_weights)
    from_mean, own = principal_axes(model, model_weights)
    poses = []
    for signs in itertools.product((1.0, -1.0), repeat=3):
        if np.prod(signs) > 0:
            axes = (to * np.array(signs)) @ own.T
            origin = to_mean - size * axes @ from_mean
            poses.append(Pose(jnp.asarray(axes), jnp.asarray(origin), jnp.asarray(size, float)))
    return poses
