"""Whatever a file holds, reading it ends in a surface or a case, or in the error that is for it."""

import warnings

import hypothesis
import hypothesis.strategies as st
import pytest

from jaxwillmore.cases import CaseError, load_case, load_fit
from jaxwillmore.io import SurfaceWarning, read_surface
from jaxwillmore.mesh import SurfaceError

from .inputs import damaged, generated, good_files

GOOD = good_files()
RANDOM = st.randoms(use_true_random=False)
QUICK = hypothesis.settings(
    max_examples=25,
    deadline=None,
    derandomize=True,
    database=None,
    phases=[hypothesis.Phase.generate],
)


def read(path):
    """A surface, a case or the case of a fit; the error is for it and names the file."""
    try:
        if path.suffix == ".toml":
            for load in (load_case, load_fit):
                try:
                    load(path)
                except CaseError as error:
                    assert str(error).startswith(str(path))
        else:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", SurfaceWarning)
                try:
                    mesh, x = read_surface(path)
                except SurfaceError:
                    mesh, x = read_surface(path, repair=True, keep="largest", merge_tolerance=1e-6)
            assert mesh.n_nodes == len(x)
    except SurfaceError as error:
        assert str(path) in str(error)
        assert error.report is not None or "\n" not in str(error)


@pytest.mark.parametrize("kind", GOOD)
def test_no_damage_ends_in_anything_but_the_error_for_it(tmp_path, kind):
    path = tmp_path / f"a.{kind}"

    @QUICK
    @hypothesis.given(random=RANDOM)
    def check(random):
        path.write_bytes(damaged(random, random.choice(GOOD[kind])))
        read(path)

    check()


@pytest.mark.parametrize("kind", GOOD)
def test_no_header_ends_in_anything_but_the_error_for_it(tmp_path, kind):
    path = tmp_path / f"a.{kind}"

    @QUICK
    @hypothesis.given(random=RANDOM)
    def check(random):
        path.write_bytes(generated(random, kind))
        read(path)

    check()


@pytest.mark.parametrize("kind", GOOD)
def test_the_files_are_good_before_they_are_damaged(tmp_path, kind):
    for number, content in enumerate(GOOD[kind]):
        path = tmp_path / f"{number}.{kind}"
        path.write_bytes(content)
        read(path) if kind == "toml" else read_surface(path)
