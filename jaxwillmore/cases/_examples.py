"""Case files and meshes that come with the package, named `example:NAME`."""

import pathlib

from ._error import CaseError, shown, suggestion

_FOLDER = pathlib.Path(__file__).parents[1] / "examples"
_PREFIX = "example:"
_MESHES = (".npz", ".ply")


def example_names() -> list[str]:
    """Names of the case files among the examples: `example:torus` is called `torus`."""
    return sorted(path.stem for path in _FOLDER.glob("*.toml"))


def is_example(source: object) -> bool:
    """Whether `source` names an example rather than a file."""
    return isinstance(source, str) and source.startswith(_PREFIX)


def example_path(source: str) -> pathlib.Path:
    """The file behind `example:NAME` (a case) or `example:NAME.npz` (a mesh).

    **Raises:** `CaseError` with the nearest name when there is no such example.
    """
    name = source.removeprefix(_PREFIX)
    known = example_names() + sorted(
        path.name for path in _FOLDER.iterdir() if path.suffix in _MESHES
    )
    if name not in known:
        hint = suggestion(name, known)
        problem = f"no example is called {shown(name)}.{hint} Known examples: {', '.join(known)}."
        raise CaseError(problem, got=source, allowed=", ".join(known))
    return _FOLDER / (name if name.endswith(_MESHES) else f"{name}.toml")
