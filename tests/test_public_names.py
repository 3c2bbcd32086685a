"""Public names of the packages: each resolves, none is heavy before it is used."""

from __future__ import annotations

import ast
import importlib
from pathlib import Path

import pytest

from tests.test_architecture import HEAVY, MAY_IMPORT, NUMBERS_ONLY, ROOT, loaded_by

PACKAGES = ("baselines", "calibration", "learned", "sim_warp")


def checked_types(package: str) -> set[str]:
    """Names that type checkers see: those imported under `TYPE_CHECKING`."""
    tree = ast.parse(Path(ROOT, package, "__init__.py").read_text(encoding="utf-8"))
    (guarded,) = [node for node in tree.body if isinstance(node, ast.If)]
    lines = [node for node in guarded.body if isinstance(node, ast.ImportFrom)]
    return {alias.name for line in lines for alias in line.names}


@pytest.mark.parametrize("package", PACKAGES)
def test_importing_a_package_loads_nothing_else(package):
    others = (HEAVY | NUMBERS_ONLY | set(MAY_IMPORT)) - {package, "carosac_toolkit"}
    assert loaded_by([package]) & others == set()


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_resolves_to_what_is_called_so(package):
    module = importlib.import_module(package)
    for name in module.__all__:
        if name == "CableGymEnvironment":
            pytest.importorskip("gymnasium")
            pytest.importorskip("stable_baselines3")
        value = getattr(module, name)
        assert getattr(value, "__name__", name) == name
        assert getattr(value, "__module__", package).startswith(package)


@pytest.mark.parametrize("package", PACKAGES)
def test_all_dir_and_type_checkers_agree_on_the_public_names(package):
    module = importlib.import_module(package)
    assert sorted(module.__all__) == dir(module) == sorted(checked_types(package))


@pytest.mark.parametrize("package", PACKAGES)
def test_an_unknown_name_is_an_attribute_error_and_modules_stay_importable(package):
    with pytest.raises(AttributeError, match=f"module '{package}' has no attribute 'Nothing'"):
        _ = importlib.import_module(package).Nothing
    first = next(path.stem for path in sorted((ROOT / package).glob("[a-z]*.py")))
    assert importlib.import_module(f"{package}.{first}").__name__ == f"{package}.{first}"
