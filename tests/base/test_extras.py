from __future__ import annotations

import pickle
import sys

import pytest

from carosac_toolkit.base import extras
from carosac_toolkit.base.errors import CarosacError
from carosac_toolkit.base.extras import MissingExtra, naming_extras, require, require_extras

REQUIREMENTS = [
    "numpy>=2.0",
    "Their_Solver>=1; extra == 'fast'",
    "pin>=4 ; extra == \"fast\"",
    "their-solver; (python_version > '3') and extra == 'all'",
    "numpy; extra == 'all'",
    "numpy; extra == 'usual'",
]  # fmt: skip
EXTRAS = ["all", "fast", "usual"]


def write_distribution(folder, name, requirements=(), extras=()):
    """Write the metadata of an installed distribution without any module."""
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir(parents=True)
    lines = [f"Name: {name}", "Version: 1.0", "Metadata-Version: 2.3"]
    lines += [f"Requires-Dist: {line}" for line in requirements]
    lines += [f"Provides-Extra: {extra}" for extra in extras]
    (info / "METADATA").write_text("\n".join(lines) + "\n")


@pytest.fixture
def metadata(monkeypatch, tmp_path):
    """The toolkit and a distribution x with extras; of their packages only numpy is installed."""
    for name in ("carosac_toolkit", "x"):
        write_distribution(tmp_path, name, REQUIREMENTS, EXTRAS)
    write_distribution(tmp_path, "numpy")
    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    monkeypatch.delitem(sys.modules, "gtsam", raising=False)  # where another test imported it
    monkeypatch.setattr(extras, "_importable", lambda module: module == "numpy")
    extras._requirements.cache_clear()
    yield tmp_path
    extras._requirements.cache_clear()


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
    with pytest.raises(MissingExtra, match=r"extra all \(not installed: their-solver\)"):
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


def test_a_package_counts_under_its_own_name_where_its_marker_holds(metadata):
    """None of the installed packages can be imported under its name."""
    for name in ("scikit_learn", "PyYAML", "zope.interface"):
        write_distribution(metadata, name)
    foreign = f"sys_platform != '{sys.platform}'"
    write_distribution(
        metadata, "plug_in",
        [
            "scikit-learn; extra == 'ml'", "pyyaml; extra == 'ml'", "zope-interface; extra=='ml'",
            f"pywin32; {foreign} and extra == 'ml'", f"pywin32; extra == 'ml' and {foreign}",
            f"absent; sys_platform == '{sys.platform}' and extra == 'more'",
        ],
        ["ml", "more"],
    )  # fmt: skip
    require_extras("this", ["ml"], "plug-in")
    with pytest.raises(MissingExtra, match=r"extra more: pip install 'plug-in\[more\]'"):
        require_extras("this", ["more"], "plug-in")


def test_an_extra_may_name_extras_of_itself_and_of_others(metadata):
    requirements = ["carosac-toolkit[fast]; extra == 'ours'", "y[ours,both]; extra == 'both'"]
    write_distribution(metadata, "y", requirements, ["ours", "both"])
    for name in ("ours", "both"):
        with pytest.raises(MissingExtra, match=r"\(not installed: pin, their-solver\)"):
            require_extras("this", [name], "y")


def test_without_metadata_the_modules_are_named(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    monkeypatch.delitem(sys.modules, "gtsam", raising=False)  # where another test imported it
    extras._requirements.cache_clear()
    message = r"this needs more packages \(not installed: gtsam\): pip install 'carosac-toolkit'"
    with pytest.raises(MissingExtra, match=message):
        require("this", "gtsam")
    extras._requirements.cache_clear()
