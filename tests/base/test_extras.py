from __future__ import annotations

import pickle

import pytest

from carosac_toolkit.base import extras
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.base.extras import MissingExtra, naming_extras, require, require_extras

METADATA = [
    "numpy>=2.0",
    "Their_Solver>=1; extra == 'fast'",
    "pin>=4 ; extra == \"fast\"",
    "their-solver; (python_version > '3') and extra == 'all'",
    "numpy; extra == 'all'",
    "numpy; extra == 'usual'",
]  # fmt: skip


@pytest.fixture
def metadata(monkeypatch):
    """A distribution with extras; of its packages only numpy is installed."""
    monkeypatch.setattr(extras, "requires", lambda name: METADATA)
    monkeypatch.setattr(extras, "_importable", lambda module: module == "numpy")
    extras._modules_by_extra.cache_clear()
    yield
    extras._modules_by_extra.cache_clear()


def test_what_is_installed_is_not_refused(metadata):
    require("this", "numpy")
    require_extras("this", ["usual"])


def test_a_missing_module_is_named_with_the_smallest_extra_that_brings_it(metadata):
    message = (
        r"^this needs the extra fast \(not installed: pinocchio\): "
        r"pip install 'carosac-toolkit\[fast\]'$"
    )
    with pytest.raises(MissingExtra, match=message):
        require("this", "numpy", "pinocchio")


def test_an_extra_that_is_there_in_part_says_which_packages_are_missing(metadata):
    with pytest.raises(MissingExtra, match=r"this needs the extra fast: pip install 'x\[fast\]'$"):
        require_extras("this", ["usual", "fast"], "x")
    with pytest.raises(MissingExtra, match=r"extra all \(not installed: their_solver\)"):
        require_extras("this", ["all"], "x")
    both = r"extras all and fast.*pip install 'x\[all,fast\]'$"
    with pytest.raises(MissingExtra, match=both) as caught:
        require_extras("this", ["fast", "all"], "x")
    assert caught.value.extras == ("all", "fast")


def test_a_failed_import_names_the_extra_and_keeps_its_cause(metadata):
    with pytest.raises(MissingExtra, match="this needs the extra fast") as caught:
        with naming_extras("this"):
            raise ModuleNotFoundError("No module named 'pinocchio.rpy'", name="pinocchio.rpy")
    assert isinstance(caught.value.__cause__, ModuleNotFoundError)


def test_another_failed_import_is_left_alone(metadata):
    with pytest.raises(ModuleNotFoundError, match="'foreign'"), naming_extras("this"):
        raise ModuleNotFoundError("No module named 'foreign'", name="foreign")


def test_it_is_an_error_of_ours_and_of_imports_and_survives_workers(metadata):
    error = MissingExtra("this", [], ["fast"], "x")
    assert isinstance(error, CarosacError) and isinstance(error, ImportError)
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again), again.extras) == (MissingExtra, str(error), ("fast",))


def test_without_metadata_the_modules_are_named(monkeypatch):
    def nothing(name):
        raise extras.PackageNotFoundError(name)

    monkeypatch.setattr(extras, "requires", nothing)
    monkeypatch.setattr(extras, "_importable", lambda module: False)
    extras._modules_by_extra.cache_clear()
    message = r"this needs more packages \(not installed: gtsam\): pip install 'carosac-toolkit'"
    with pytest.raises(MissingExtra, match=message):
        require("this", "gtsam")
    extras._modules_by_extra.cache_clear()
