"""Names of the fields that sit side by side in one nodal array."""

from types import SimpleNamespace

import equinox as eqx
from jaxtyping import Array

from ._jet import Jet
from ._metric import Point


class Layout(eqx.Module):
    """Order and sizes of the fields in the columns of a nodal array of shape `nodes fields`.

    **Arguments:**

    - `names`: field names, in column order.
    - `sizes`: 1 for a scalar field, 3 for a vector field.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    sizes: tuple[int, ...] = eqx.field(static=True)

    def __check_init__(self):
        if len(self.names) != len(self.sizes):
            raise ValueError(f"{len(self.names)} field names but {len(self.sizes)} sizes.")

    @property
    def width(self) -> int:
        """Number of columns."""
        return sum(self.sizes)

    def columns(self, name: str) -> slice:
        """The columns of one field."""
        k = self.names.index(name)
        start = sum(self.sizes[:k])
        return slice(start, start + self.sizes[k])

    def restrict(self, names: tuple[str, ...]) -> "Layout":
        """The layout of a subset of the fields, in the given order."""
        return Layout(names, tuple(self.sizes[self.names.index(name)] for name in names))

    def split(self, array: Array, axis: int = 0) -> dict[str, Array]:
        """Take an array whose `axis` holds the columns apart, field by field.

        Scalar fields lose the axis; vector fields keep it with length 3.
        """
        out = {}
        index: list = [slice(None)] * array.ndim
        for name, size in zip(self.names, self.sizes, strict=True):
            columns = self.columns(name)
            index[axis] = columns.start if size == 1 else columns
            out[name] = array[tuple(index)]
        return out

    def jets(self, local: Array, point: Point) -> SimpleNamespace:
        """Jets from values and reference derivatives, an array of shape `fields 3`."""
        return SimpleNamespace(
            **{
                name: Jet(part[..., 0], part[..., 1:] @ point.lift.T)
                for name, part in self.split(local).items()
            }
        )
