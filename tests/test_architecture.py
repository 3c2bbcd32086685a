"""Data flows one way: who may import whom, and what a light import may not pull in."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MAY_IMPORT = {
    "carosac_toolkit": set(),
    "baselines": {"carosac_toolkit"},
    "sim_warp": {"carosac_toolkit"},
    "learned": {"carosac_toolkit", "sim_warp", "baselines"},
    "calibration": {"carosac_toolkit", "sim_warp", "baselines"},
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
    ("safety",),
    ("safety.guard",),
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


def subpackage(module: str) -> str:
    """Folder of a module of ours: its subpackage, or the package itself."""
    path = ROOT / Path(*module.split("."))
    return module if path.is_dir() else module.rpartition(".")[0]


@lru_cache
def file_imports() -> dict[str, set[str]]:
    """Imports from file to file inside our packages, deferred ones and those for types included."""
    known = {module for package in MAY_IMPORT for module in modules_of(package)}
    paths = {
        m: p
        for package in MAY_IMPORT
        for m, p in zip(modules_of(package), sources(package), strict=True)
    }
    imports: dict[str, set[str]] = {}
    for module, path in paths.items():
        named = set()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                named |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                inner = {f"{node.module}.{alias.name}" for alias in node.names} & known
                named |= inner or {str(node.module)}
        imports[module] = (named & known) - {module}
    return imports


def layer_of(name: str) -> int:
    """Line of a core subpackage in `LAYERS`."""
    return next(k for k, line in enumerate(LAYERS) if name in line)


def circles(imports: dict[str, set[str]]) -> list[list[str]]:
    """Files that lie on circles of imports, or between two of them."""
    left = {module: set(names) for module, names in imports.items()}
    while True:  # take away what imports nothing that is left, then what nothing left imports
        leaves = {m for m, names in left.items() if not names & left.keys()}
        used = set().union(*left.values()) if left else set()
        roots = {m for m in left if m not in used}
        if not leaves | roots:
            return [sorted(left)] if left else []
        left = {m: names - leaves - roots for m, names in left.items() if m not in leaves | roots}


def test_every_subpackage_of_the_core_has_its_layer_and_says_what_lives_there():
    core = {subpackage(m).removeprefix("carosac_toolkit").lstrip(".") for m in file_imports()
            if m.startswith("carosac_toolkit.")}  # fmt: skip
    assert core <= {name for line in LAYERS for name in line}
    loose = [p.name for p in (ROOT / "carosac_toolkit").glob("*.py") if p.name != "__init__.py"]
    assert loose == []
    for name in sorted(core):
        tree = ast.parse(
            (ROOT / "carosac_toolkit" / Path(*name.split(".")) / "__init__.py").read_text()
        )
        assert ast.get_docstring(tree), name


def test_subpackages_import_only_what_lies_below_them():
    print("\n" + "\n".join(f"{k:2d}  {' | '.join(line)}" for k, line in enumerate(LAYERS)))
    prefix, faults = "carosac_toolkit.", []
    for module, names in file_imports().items():
        if not module.startswith(prefix):
            continue
        own = subpackage(module).removeprefix(prefix)
        for name in sorted(names - {"carosac_toolkit"}):
            other = subpackage(name).removeprefix(prefix)
            if other != own and name.startswith(prefix) and layer_of(other) >= layer_of(own):
                faults.append(f"{module} imports {name}")
    assert faults == []


def test_no_two_folders_import_each_other():
    """The `__init__` of a folder may hand on names of any folder below it."""
    files = {m: names for m, names in file_imports().items() if subpackage(m) != m}
    pairs = {(subpackage(m), subpackage(n)) for m, names in files.items() for n in names}
    assert sorted((a, b) for a, b in pairs if a < b and (b, a) in pairs) == []


def test_no_files_import_one_another_in_a_circle():
    imports = file_imports()
    inner = {
        m: names - {"carosac_toolkit"} for m, names in imports.items() if m != "carosac_toolkit"
    }
    assert circles(inner) == []


def test_only_the_plc_command_imports_the_emulator():
    users = {module for module, names in file_imports().items()
             if any(name.startswith("carosac_toolkit.plc.emulator") for name in names)
             and not module.startswith("carosac_toolkit.plc.emulator")}  # fmt: skip
    assert users <= {"carosac_toolkit.cli.plc"}


def test_distributed_packages_are_those_of_the_table():
    import tomllib

    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert set(project["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]) == set(MAY_IMPORT)
