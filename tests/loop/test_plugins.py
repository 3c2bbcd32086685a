from __future__ import annotations

import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.loop import plugins

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def site(tmp_path, monkeypatch):
    """A folder on the Python path, to install distributions in."""
    monkeypatch.syspath_prepend(str(tmp_path))
    before = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - before:
        if getattr(sys.modules[name], "__file__", None) and str(tmp_path) in str(
            sys.modules[name].__file__
        ):
            del sys.modules[name]


def install(site: Path, distribution: str, points: str, **modules: str) -> None:
    """Lay out what pip would: metadata with entry points, and modules."""
    info = site / f"{distribution}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(textwrap.dedent(points))
    for name, text in modules.items():
        (site / f"{name}.py").write_text(text)


def test_installed_estimators_are_found_by_name():
    assert {"straight_line", "kinematic_solver"} <= set(plugins.names("estimators"))
    assert plugins.load("estimators", "straight_line").__name__ == "StraightLine"


def test_a_plug_in_of_another_distribution_joins_by_name(site):
    points = "[carosac.controllers]\nlazy = their_robot:Lazy\n"
    install(site, "their-robot", points, their_robot="class Lazy: pass\n")
    assert "lazy" in plugins.names("controllers")
    assert "their_robot" not in sys.modules  # found, not imported
    assert plugins.load("controllers", "lazy").__name__ == "Lazy"


def test_module_and_class_need_no_installation(site):
    (site / "my_controller.py").write_text("class Outer:\n    class Inner: pass\n")
    assert plugins.load("controllers", "my_controller:Outer.Inner").__name__ == "Inner"


def test_an_unknown_name_lists_what_is_installed_and_the_closest():
    message = (
        r"estimator: got 'straight_lien'; allowed: one of \[.*'straight_line'.*\], "
        r"or 'module:Class'; did you mean 'straight_line'\?"
    )
    with pytest.raises(InvalidField, match=message):
        plugins.load("estimators", "straight_lien")


def test_a_class_that_its_module_lacks_is_named_with_the_closest():
    message = r"a name that baselines\.straight_line defines .*; did you mean 'StraightLine'\?"
    with pytest.raises(InvalidField, match=message):
        plugins.load("estimators", "baselines.straight_line:StraightLien")


def test_a_class_under_the_main_guard_of_a_script_is_refused_with_the_reason(site):
    (site / "script.py").write_text("if __name__ == '__main__':\n    class Mine:\n        pass\n")
    with pytest.raises(InvalidField, match=r"script:Mine.* when imported, in no 'if __name__'"):
        plugins.load("controllers", "script:Mine")


@pytest.mark.parametrize("name", [":Class", "module:", "a b:c"])
def test_what_is_neither_name_nor_module_and_class_is_refused(name):
    with pytest.raises(InvalidField, match="allowed: a name, or 'module:Class'"):
        plugins.load("drivers", name)


def test_an_import_that_fails_says_what_is_missing():
    message = "driver 'no_such:Thing': cannot import no_such: No module"
    with pytest.raises(CarosacError, match=message):
        plugins.load("drivers", "no_such:Thing")


def test_an_unknown_kind_is_refused():
    with pytest.raises(InvalidField, match="kind: got 'observers'"):
        plugins.names("observers")  # type: ignore[arg-type]


def test_a_name_that_two_distributions_claim_is_refused(site):
    install(site, "first", "[carosac.drivers]\nwinch = first_robot:A\n", first_robot="A = 1\n")
    install(site, "second", "[carosac.drivers]\nwinch = second_robot:B\n", second_robot="B = 2\n")
    with pytest.raises(CarosacError, match=r"claimed by several.*first_robot:A.*second_robot:B"):
        plugins.load("drivers", "winch")


@pytest.mark.parametrize("package", plugins.OUR_PACKAGES)
def test_our_packages_carry_the_marker(package):
    plugins.check_package(package)


@pytest.mark.parametrize("text", ["", "raise ImportError('needs tensorflow 1')\n"])
def test_a_foreign_package_that_hides_ours_is_reported(tmp_path, text):
    foreign = tmp_path / "baselines"
    foreign.mkdir()
    (foreign / "__init__.py").write_text(text)
    program = textwrap.dedent(f"""
        import sys
        from carosac_toolkit.loop import plugins as registry  # before the foreign folder
        from carosac_toolkit.base.errors import CarosacError
        sys.path.insert(0, {str(tmp_path)!r})
        try:
            registry.load("estimators", "straight_line")
        except CarosacError as error:
            print(error)
    """)
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=ROOT)
    assert str(foreign) in done.stdout, done.stderr
    assert "does not belong to carosac-toolkit" in done.stdout


def test_looking_up_names_imports_no_plug_in():
    program = (
        "import sys; from carosac_toolkit.loop import plugins; plugins.names('estimators');"
        "print([m for m in ('baselines', 'numpy', 'warp') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout.strip() == "[]", done.stderr


class AtTheTop:
    """What a user may hand to a study."""


def test_a_class_at_the_top_of_a_module_is_found_by_its_name():
    assert plugins.name_of("mpc") == "mpc"
    name = plugins.name_of(AtTheTop)
    assert name.endswith("test_plugins:AtTheTop")
    assert plugins.load("controllers", name) is AtTheTop


def test_a_class_that_no_other_process_could_import_is_refused():
    class Inside:
        pass

    with pytest.raises(InvalidField, match="Inside; allowed: a class at the top of a module"):
        plugins.name_of(Inside)
    typed = type("Typed", (), {"__module__": "<stdin>"})
    with pytest.raises(InvalidField, match="Typed; allowed: a class at the top of a module"):
        plugins.name_of(typed)
