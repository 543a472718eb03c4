"""The import graph of the package points downward only."""

import ast
import pathlib

import pytest

ROOT = pathlib.Path(__file__).parents[1] / "jaxwillmore"
LAYERS = [
    {"_types", "_version"},
    {"_arguments", "_cache", "_console", "_functions", "_interrupts", "_machine", "_observers"},
    {"reference"},
    {"mesh", "linalg"},
    {"fem"},
    {"surface"},
    {"phases"},
    {"energies"},
    {"flows", "schemes"},
    {"equilibria", "evolve"},
    {"shapes", "fit", "health", "io", "plot", "verify"},
    {"cases"},
    {"runs"},
    {"_closing", "_options"},
    {"cli", "__main__"},
]
RANK = {name: rank for rank, names in enumerate(LAYERS) for name in names}
FILES = sorted(ROOT.rglob("*.py"))


def imported_packages(path):
    """First component (inside the package) of everything `path` imports from the package."""
    here = path.relative_to(ROOT).parts
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name.split(".")[0] for alias in node.names]
            assert ROOT.name not in names, "import relatively"
        if not isinstance(node, ast.ImportFrom):
            continue
        assert node.level or (node.module or "").split(".")[0] != ROOT.name, "import relatively"
        if node.level:
            base = [*here[: len(here) - node.level], *(node.module or "").split(".")]
            parts = [part for part in base if part]
            yield from [parts[0]] if parts else [alias.name for alias in node.names]


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_point_downward(path):
    mine = path.relative_to(ROOT).parts[0].removesuffix(".py")
    if mine == "__init__":
        return
    assert mine in RANK, f"{mine} has no place in LAYERS"
    for other in imported_packages(path):
        # `cli` and `__main__` share a rank because `__main__` is nothing but a call of `cli`.
        allowed = other == mine or RANK[other] < RANK[mine] or (mine, other) == ("__main__", "cli")
        assert allowed, f"{mine} must not import {other}"


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_what_is_private_stays_in_its_package(path):
    """Modules of the top level with an underscore are private to the whole package."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level >= len(path.relative_to(ROOT).parts):
            inside = (node.module or "").split(".")[1:]
            names = [*inside, *(alias.name for alias in node.names)]
            hidden = [name for name in names if name.startswith("_") and name != "__version__"]
            top = not node.module
            assert top or not hidden, f"{hidden} of {node.module}"


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_files_stay_small_enough_to_read(path):
    source = path.read_text(encoding="utf-8")
    assert source.count("\n") <= 400, "split the file"
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            # A docstring may take the room it needs.
            documented = ast.get_docstring(node, clean=False) is not None
            body = node.body[1:] if documented else node.body
            lines = (body[-1].end_lineno or 0) - body[0].lineno + 1 if body else 0
            assert lines <= 80, f"{node.name} is too long"


def test_the_graph_is_seen_at_all():
    """The two tests above would also pass on an empty folder."""
    assert len(FILES) > 10
    cli = set(imported_packages(ROOT / "cli.py"))
    assert "runs" in cli
