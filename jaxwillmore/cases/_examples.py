"""Case files and meshes that come with the package, named `example:NAME`."""

import pathlib
import tomllib

from ._error import CaseError, shown, suggestion

_FOLDER = pathlib.Path(__file__).parents[1] / "examples"
_PREFIX = "example:"
_MESHES = (".npz", ".ply")


def example_names() -> list[str]:
    """Names of the examples that `load_case` reads: `example:torus` is called `torus`."""
    return sorted(set(_stems()) - set(fit_example_names()))


def fit_example_names() -> list[str]:
    """Names of the examples that `load_fit` reads: those with a `[target]`."""
    return [name for name in _stems() if "target" in tomllib.loads(_text(name))]


def _stems() -> list[str]:
    return sorted(path.stem for path in _FOLDER.glob("*.toml"))


def _text(name: str) -> str:
    return (_FOLDER / f"{name}.toml").read_text(encoding="utf-8")


def is_example(source: object) -> bool:
    """Whether `source` names an example rather than a file."""
    return isinstance(source, str) and source.startswith(_PREFIX)


def example_path(source: str) -> pathlib.Path:
    """The file behind `example:NAME` (a case) or `example:NAME.npz` (a mesh).

    **Raises:** `CaseError` with the nearest name when there is no such example.
    """
    name = source.removeprefix(_PREFIX)
    known = _stems() + sorted(path.name for path in _FOLDER.iterdir() if path.suffix in _MESHES)
    if name not in known:
        hint = suggestion(name, known)
        problem = f"no example is called {shown(name)}.{hint} Known examples: {', '.join(known)}."
        raise CaseError(problem, got=source, allowed=", ".join(known))
    return _FOLDER / (name if name.endswith(_MESHES) else f"{name}.toml")
