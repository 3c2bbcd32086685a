"""The toolkit without its extras, and each plug-in with exactly the extras that it names."""

from __future__ import annotations

import json
import re
import subprocess
import tomllib
from importlib.metadata import entry_points

import pytest

from tests.lean_environment import ROOT, make_environment

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]
FOR_DEVELOPERS = {"bench", "dev", "docs"}
KINDS = ("controllers", "estimators", "drivers", "links", "figures")
# The least that each command with an extra asks for on its line.
ARGUMENTS = {
    "calibrate.lengths": ["synthetic"],
    "calibrate.tachymeter": ["shots.gsi", "--robot", "carosac", "--targets", "targets.yaml"],
    "distill": ["--robot", "carosac"],
    "evaluate": ["carosac-residual"],
    "smooth": ["synthetic"],
    "train": ["--robot", "carosac"],
    "view": ["carosac"],
}
NEEDING_MODULES = {
    "calibration.tachymeter.synthetic", "learned.exploration", "learned.gym_environment",
    "learned.metric_policy", "learned.relabelling", "learned.td3", "learned.truth_policy",
    "learned.vector_environment",
}  # fmt: skip


def declared(kind):
    """Extras that the project declares for each plug-in of a kind."""
    points = PROJECT["entry-points"][f"carosac.{kind}"]
    return {
        name: tuple(re.findall(r"[a-z]+", value.partition("[")[2]))
        for name, value in points.items()
    }


def refusal(user, extras):
    """The line that names the extras and the command which installs them."""
    names = f"extra{'s' if len(extras) > 1 else ''} {' and '.join(extras)}"
    return f"{user} needs the {names}: pip install 'carosac-toolkit[{','.join(extras)}]'"


@pytest.fixture(scope="module")
def environment(tmp_path_factory):
    """Interpreters of environments with some extras, each made once."""
    made = {}

    def find(*extras):
        if extras not in made:
            folder = tmp_path_factory.mktemp("-".join(extras) or "base")
            made[extras] = make_environment(folder / "venv", extras)
        return made[extras]

    return find


@pytest.fixture
def carosac(environment, tmp_path):
    """Runner of a command in an environment without extras, in an empty folder."""

    def run(*words):
        command = [environment(), "-m", "carosac_toolkit.cli.main", *words]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)

    return run


def answers(python, program, **names):
    """What a program leaves in `answer`, as JSON."""
    lines = [f"{name} = {value!r}" for name, value in names.items()]
    text = "\n".join([*lines, program, "import json; print(json.dumps(answer))"])
    done = subprocess.run([python, "-c", text], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_the_environments_hold_only_what_they_should(environment):
    program = """
from importlib.util import find_spec
answer = [x for x in ("casadi", "gtsam", "pinocchio", "torch", "viser", "pytest") if find_spec(x)]
"""
    assert answers(environment(), program) == []
    assert answers(environment("control"), program) == ["casadi", "pinocchio"]
    program = """
from carosac_toolkit.base.extras import missing_extras
answer = missing_extras(("calibration", "control", "learn", "parallel", "ros", "view"))
"""
    every = ["calibration", "control", "learn", "parallel", "ros", "view"]
    assert answers(environment(), program) == every
    assert answers(environment("control"), program) == [
        extra for extra in every if extra not in ("control", "parallel")
    ]


def test_the_extra_all_brings_what_all_others_bring():
    users = set(EXTRAS) - FOR_DEVELOPERS - {"all"}
    assert EXTRAS["all"] == [f"carosac-toolkit[{','.join(sorted(users))}]"]


def test_help_lists_every_command_and_what_it_needs(carosac):
    done = carosac("--help")
    assert (done.returncode, done.stderr) == (0, "")
    for name, extras in declared("commands").items():
        (line,) = re.findall(rf"^  {name.replace('.', ' ')}  .*", done.stdout, re.MULTILINE)
        needs = f" Needs carosac-toolkit[{','.join(extras)}]." if extras else ""
        if name == "import.recording":  # files are aligned without the extra
            needs = " Needs carosac-toolkit[ros] for bags."
        assert re.fullmatch(r"  \S+(?: \S+)?  +[A-Z][^[]*\.", line.removesuffix(needs))
        assert ("Needs" in line) == bool(needs)


def test_every_command_has_its_help_without_any_extra(environment):
    program = """
import contextlib, io
from carosac_toolkit.cli.main import main
answer = {}
for name in names:
    page = io.StringIO()
    with contextlib.redirect_stdout(page):
        try:
            main([*name.split("."), "--help"])
        except SystemExit as error:
            answer[name] = [error.code, page.getvalue().startswith("usage: carosac ")]
"""
    names = sorted(declared("commands"))
    assert answers(environment(), program, names=names) == {name: [0, True] for name in names}


@pytest.mark.parametrize("name", sorted(ARGUMENTS))
def test_a_command_without_its_extra_says_so_in_one_line(carosac, tmp_path, name):
    done = carosac(*name.split("."), *ARGUMENTS[name])
    expected = refusal(f"command '{name.replace('.', ' ')}'", declared("commands")[name])
    assert (done.returncode, done.stdout, done.stderr) == (2, "", f"carosac: {expected}\n")
    assert list(tmp_path.iterdir()) == []


def test_those_are_all_commands_that_need_an_extra():
    assert {name for name, extras in declared("commands").items() if extras} == set(ARGUMENTS)


def test_plug_ins_without_their_extra_say_so_and_all_others_load(environment):
    program = """
from carosac_toolkit.base.extras import MissingExtra
from carosac_toolkit.loop import plugins
answer = {}
for kind in kinds:
    for name in plugins.names(kind):
        try:
            plugins.load(kind, name)
        except MissingExtra as error:
            answer[f"{kind[:-1]} '{name}'"] = str(error)
"""
    missing = {
        f"{kind[:-1]} '{name}'": extras
        for kind in KINDS
        for name, extras in declared(kind).items()
        if extras
    }
    expected = {user: refusal(user, extras) for user, extras in missing.items()}
    assert answers(environment(), program, kinds=KINDS) == expected


@pytest.mark.parametrize("extras", [(), ("control",)])
def test_controllers_and_estimators_work_with_exactly_their_extras(environment, extras):
    """On a robot at home: a step each, so that all that they import is imported."""
    program = """
import carosac_toolkit as ct
from carosac_toolkit.loop import plugins
robot = ct.load_robot("carosac")
simulator = plugins.load("drivers", "simulator")
driver = simulator.build(robot, simulator.Settings(suite="lengths+imu+pose"))
driver.connect()
measurement = driver.measure()
solver = plugins.load("estimators", "kinematic_solver").build(robot)
belief = solver.reset(measurement)
answer = []
for name in estimators:
    found = plugins.load("estimators", name).build(robot)
    found.reset(measurement)
    answer.append(name)
for name in controllers:
    found = plugins.load("controllers", name).build(robot)
    found.reset(belief)
    answer.append(name)
"""
    estimators = [name for name, needs in declared("estimators").items() if needs == extras]
    controllers = [name for name, needs in declared("controllers").items() if needs == extras]
    assert estimators and controllers
    done = answers(environment(*extras), program, estimators=estimators, controllers=controllers)
    assert done == estimators + controllers


def test_extras_of_plug_ins_are_known_here():
    named = {
        extra
        for kind in (*KINDS, "commands")
        for extras in declared(kind).values()
        for extra in extras
    }
    assert named <= set(EXTRAS) - FOR_DEVELOPERS
    for kind in (*KINDS, "commands"):
        points = entry_points(group=f"carosac.{kind}")
        installed = {
            x.name: tuple(sorted(x.extras)) for x in points if x.dist.name == PROJECT["name"]
        }
        assert installed == declared(kind), "run `make setup`"


def test_modules_that_import_an_extra_when_loaded_are_few(environment):
    program = """
import importlib, pkgutil
answer = []
for package in packages:
    folder = importlib.import_module(package).__path__
    for module in pkgutil.walk_packages(folder, f"{package}."):
        try:
            importlib.import_module(module.name)
        except ImportError:
            answer.append(module.name)
"""
    packages = ["carosac_toolkit", "baselines", "sim_warp", "learned", "calibration"]
    assert set(answers(environment(), program, packages=packages)) == NEEDING_MODULES


def test_python_calls_without_their_extra_say_so(environment):
    program = """
import baselines, calibration, learned
import carosac_toolkit as ct
from calibration.tachymeter.gsi import read_gsi
from carosac_toolkit.base.extras import MissingExtra
from carosac_toolkit.physics.rest.tension_distribution import TensionDistributor
from carosac_toolkit.recordings.bundled import find_recording
from carosac_toolkit.recordings.files import load_recording
from carosac_toolkit.studies.run.cluster import local_client
robot = ct.load_robot("carosac")
calls = {
    "Mpc": lambda: baselines.Mpc.build(robot),
    "KsEkf": lambda: baselines.KsEkf.build(robot),
    "DynamicEstimator": lambda: baselines.DynamicEstimator.build(robot),
    "smooth": lambda: baselines.smooth(None, robot),
    "PolicyController": lambda: learned.PolicyController.build(robot),
    "train": lambda: learned.train(None, None),
    "CableGymEnvironment": lambda: learned.CableGymEnvironment,
    "write_gsi": lambda: calibration.write_gsi,
    "read_gsi": lambda: read_gsi("shots.gsi"),
    "calibrate_tachymeter": lambda: calibration.calibrate_tachymeter(robot, None),
    "calibrate_lengths": lambda: calibration.calibrate_lengths(robot, None),
    "TensionDistributor": lambda: TensionDistributor(8, 1.0, 2.0),
    "local_client": lambda: local_client(2).__enter__(),
}
answer = {}
for name, call in calls.items():
    try:
        call()
    except MissingExtra as error:
        answer[name] = list(error.extras)
"""
    assert answers(environment(), program) == {
        "Mpc": ["control"], "KsEkf": ["control"], "DynamicEstimator": ["control"],
        "smooth": ["calibration", "control"], "PolicyController": ["control"],
        "train": ["learn"], "CableGymEnvironment": ["learn"], "write_gsi": ["calibration"],
        "read_gsi": ["calibration"], "calibrate_tachymeter": ["calibration"],
        "calibrate_lengths": ["calibration"],
        "TensionDistributor": ["control"], "local_client": ["parallel"],
    }  # fmt: skip


def test_an_unknown_name_lists_what_an_extra_would_add(carosac):
    done = carosac("compare", "--controllers", "mpcc")
    assert done.returncode == 2
    expected = (
        "allowed: one of ['input_shaping', 'kinematic_solver', 'straight_line'], with "
        "carosac-toolkit[control] also ['approximate_mpc', 'mpc', 'td3'], or 'module:Class'; did "
        "you mean 'mpc'?"
    )
    assert expected in done.stderr


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["compare", "--workers", "2"], "a run on 2 worker processes needs the extra parallel"),
        (["compare", "--scheduler", "tcp://127.0.0.1:9"], "a dask scheduler needs the extra par"),
        (["run", "--robot", "carosac", "--driver", "ads"], "link 'ads' needs the extra control"),
        (["import", "recording", "run.bag", "--output", "a.parquet"], "bags needs the extra ros"),
        (["validate", "synthetic", "--models", "ks_ekf"], "estimator 'ks_ekf' needs the extra con"),
    ],
)
def test_an_option_that_needs_an_extra_says_so_in_one_line(carosac, tmp_path, words, message):
    done = carosac(*words)
    (line,) = done.stderr.splitlines()
    assert done.returncode == 2 and message in line and "pip install 'carosac-toolkit[" in line
    assert list(tmp_path.iterdir()) == []


def test_the_commands_of_the_base_work(carosac, tmp_path):
    assert "carosac" in carosac("robots").stdout
    assert carosac("check", "carosac", "--picture", "robot.png").returncode == 0
    assert (tmp_path / "robot.png").stat().st_size > 10_000
    assert carosac("workspace", "carosac", "--points", "60", "--no-pictures").returncode == 0
    assert carosac("validate", "synthetic", "--stop", "40", "--output", "models").returncode == 0
    assert (tmp_path / "models" / "report.html").is_file()


def test_a_study_runs_in_one_process_and_says_how_to_use_all_cores(environment, tmp_path):
    program = """
import contextlib, io
import carosac_toolkit as ct
with contextlib.redirect_stderr(io.StringIO()) as told:
    study = ct.Study(
        controllers=["straight_line"], driver="quasi_static", trajectories=["line"],
        seeds=5, output=folder,
    )
    results = study.run()
answer = [told.getvalue().splitlines()[0], *[row["status"] for row in results.rows]]
"""
    note, *statuses = answers(environment(), program, folder=str(tmp_path / "study"))
    assert note.endswith("on one core; for all cores: pip install 'carosac-toolkit[parallel]'")
    assert statuses == ["ok"] * 5
