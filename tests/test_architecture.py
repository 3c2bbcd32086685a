"""Data flows one way: who may import whom, and what a light import may not pull in."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MAY_IMPORT = {
    "carosac_toolkit": set(),
    "baselines": {"carosac_toolkit"},
    "sim_warp": {"carosac_toolkit"},
    "learned": {"carosac_toolkit", "sim_warp"},
    "calibration": {"carosac_toolkit", "sim_warp"},
}
# The core's subpackages from the bottom to the top. Each imports only from lines before its own;
# those on one line do not know one another. `docs/developing.md` says what lives in each.
LAYERS = (
    ("base",),
    ("robot",),
    ("loop",),
    ("physics",),
    ("physics.cable",),
    ("physics.rest",),
    ("physics.motion",),
    ("recordings",),
    ("trajectories",),
    ("safety", "safety.guard"),
    ("drivers",),
    ("plc",),
    ("plc.emulator",),
    ("validation", "workspace", "interchange", "conformance", "inspection"),
    ("live",),
    ("studies.run",),
    ("studies.compare",),
    ("studies.reference",),
    ("studies",),
    ("pictures",),
    ("reports",),
    ("viewer",),
    ("cli",),
)
ON_TOP = {"examples", "benchmarks", "docs", "tests"}
HEAVY = {
    "casadi", "filterpy", "gtsam", "matplotlib", "osqp", "pinocchio", "pyads", "pyarrow",
    "pydantic", "scipy", "stable_baselines3", "torch", "tyro", "viser", "yaml",
}  # fmt: skip
NUMBERS_ONLY = {"numpy", "warp"}  # third parties that the physics and the simulator need


def sources(folder: str) -> list[Path]:
    return sorted((ROOT / folder).rglob("*.py"))


def imported(path: Path) -> set[str]:
    """Top-level names a file imports, at module level and inside functions."""
    return {module.partition(".")[0] for module in imported_modules(path)}


def imported_at_load(path: Path) -> set[str]:
    """Top-level names a file imports when it is loaded; functions may import what they use."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return {module.partition(".")[0] for module in modules_in(tree.body, path)}


def imported_modules(path: Path) -> set[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return modules_in(ast.walk(tree), path)


def modules_in(nodes: Iterable[ast.AST], path: Path) -> set[str]:
    found: set[str] = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: a relative import"
            found.add(node.module or "")
    return found


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_packages_import_only_what_lies_below_them(package):
    others = (set(MAY_IMPORT) | ON_TOP) - {package} - MAY_IMPORT[package]
    assert sources(package), f"{package} holds no Python file"
    faults = {
        str(path.relative_to(ROOT)): sorted(imported(path) & others)
        for path in sources(package)
        if imported(path) & others
    }
    assert faults == {}


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_every_package_says_what_lives_there(package):
    tree = ast.parse((ROOT / package / "__init__.py").read_text(encoding="utf-8"))
    assert ast.get_docstring(tree)


@pytest.mark.parametrize("folder", ["carosac_toolkit/physics", "sim_warp"])
def test_physics_and_simulator_load_only_numpy_and_warp(folder):
    ours = {"carosac_toolkit", "sim_warp", "__future__"} | set(sys.stdlib_module_names)
    faults = {
        str(path.relative_to(ROOT)): sorted(imported_at_load(path) - ours - NUMBERS_ONLY)
        for path in sources(folder)
        if imported_at_load(path) - ours - NUMBERS_ONLY
    }
    assert faults == {}


def test_pydantic_stays_with_the_robot_file():
    users = [path for path in sources("carosac_toolkit") if "pydantic" in imported(path)]
    allowed = {"robot/file.py", "robot/schema.py", "robot/fields.py"}
    assert {str(path.relative_to(ROOT / "carosac_toolkit")) for path in users} <= allowed


def modules_of(folder: str) -> list[str]:
    """Module names of all files below a folder."""
    parts = (path.relative_to(ROOT).with_suffix("").parts for path in sources(folder))
    return [".".join(p[:-1] if p[-1] == "__init__" else p) for p in parts]


def loaded_by(modules: list[str]) -> set[str]:
    """Top-level modules in memory after importing these in a fresh interpreter."""
    program = (
        "import importlib, json, sys\n"
        f"for name in {modules!r}: importlib.import_module(name)\n"
        "print('\\n' + json.dumps(sorted({name.partition('.')[0] for name in sys.modules})))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return set(json.loads(done.stdout.splitlines()[-1]))


def test_importing_the_toolkit_loads_nothing_else():
    loaded = loaded_by(["carosac_toolkit"])
    assert loaded & (HEAVY | NUMBERS_ONLY | set(MAY_IMPORT)) == {"carosac_toolkit"}


@pytest.mark.parametrize("folder", ["carosac_toolkit/physics", "sim_warp"])
def test_importing_physics_or_simulator_stays_light(folder):
    assert loaded_by(modules_of(folder)) & HEAVY == set()


def test_values_protocols_and_robot_stay_light():
    names = (
        "base.arrays", "base.errors", "loop.plugins", "loop.protocols", "loop.values",
        "robot.robot",
    )  # fmt: skip
    loaded = loaded_by([f"carosac_toolkit.{name}" for name in names])
    assert loaded & (HEAVY | {"warp"}) == set()


def test_distributed_packages_are_those_of_the_table():
    import tomllib

    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert set(project["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]) == set(MAY_IMPORT)
