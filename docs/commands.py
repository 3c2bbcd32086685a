"""The ``carosac`` commands of README and docs: which there are, what they need, how they are run.

``python docs/commands.py`` runs them all, those of each page in a scratch folder of its own, some
with shorter settings (`SHORTER`), and prints what each took; ``--jobs 2`` does so on two cores. The
tests run those of `QUICK` of three pages. Files that a reader brings (a survey, a run, a bag) are
made by `bring`; results of the reader's own that some commands show, by `make`.
"""

from __future__ import annotations

import argparse
import functools
import itertools
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import textwrap
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from links import markdown

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
LONGEST = 1200  # [s] that a command may take
PAGES = (ROOT / "README.md", *sorted(DOCS.glob("*.md")), *sorted(DOCS.glob("notebooks/*.ipynb")))

# Run in one process in the tests, those of three pages; they take a second or so each.
QUICK = ("calibrate", "check", "import", "robots", "validate")

# Options that are put in place of the page's, or added, so that a run takes seconds.
SHORTER: dict[str, dict[str, tuple[str, ...]]] = {
    "calibrate guide": {"--accuracy": ("0.008",), "--checks": ("1",)},
    "compare": {"--seeds": ("1",), "--trajectories": ("fast_move",), "--workers": ("0",)},
    "distill": {"--drives": ("1",), "--updates": ("20",)},
    "evaluate": {"--trajectories": ("2",)},
    "identify": {"--train": ("0:110",), "--test": ("110:160",)},  # of one recording
    "plc": {"--duration": ("40",)},
    "run": {"--duration": ("2",)},
    "smooth": {"--stop": ("60",)},
    "train": {"--steps": ("200",)},
    "validate": {"--stop": ("40",)},
    "view": {"--duration": ("2",)},
}

# What makes the results that pages name, and what is there then.
MADE = (
    ("compare --seeds 1 --workers 0 --output carosac-results/demo",
     "carosac-results/demo/report.html"),
    ("run --duration 2 --output carosac-results/run/20261122-041500.jsonl",
     "carosac-results/run/20261122-041500.jsonl"),
)  # fmt: skip

# Commands whose answer is negative on purpose.
NEGATIVE = (
    "carosac import robot gantry_bodies.xml gantry_cables.xml --form missing.yaml",
    "carosac import robot gantry_bodies.xml --form missing.yaml",
)

# Commands that may end with 1 here: in real time by a fault of the guard, as on a computer that is
# busy with other things; `identify` and `distill` as their verdict, as a tenth of a run says little
# and a network of four drives loses the platform.
VERDICTS = ("run", "identify", "distill")

# Other commands that may: a robot that is wrong on purpose, so that a part of the run may look like
# another frame, and a network of four drives.
UNCERTAIN = (
    "carosac validate poses.csv --robot carosac --models kinematic_solver --output before",
    "carosac compare --robot my-robot.yaml --controllers mpc approximate_mpc --set "
    "controller.approximate_mpc.policy=carosac-results/distill/my-robot-seed0/network.onnx",
)

# Seconds that one of a name takes (others about 4), to share them out among jobs.
SECONDS = {
    "compare": 30.0, "distill": 60.0, "train": 30.0, "identify": 20.0, "smooth": 20.0, "run": 15.0,
}  # fmt: skip

# Commands that cannot run here, and why.
EXCEPTIONS = {
    "carosac calibrate guide hand.csv --robot first.yaml --by-hand --tape a b": "a person presses "
    "Enter at each position",
    "carosac calibrate guide samples.csv --robot first.yaml --driver ads --enable": "in real time, "
    "a quarter of an hour on an emulated PLC",
    "carosac compare --controllers tilted:Tilted input_shaping mpc --trajectories minimum_snap "
    "waypoints circle --seeds 20 --output paper": "an hour; the first command "
    "of the page is the same with one path and two seeds",
    "carosac identify run.csv --robot calibrated.yaml --output identified.yaml": "its page "
    "measures one robot with all its tools, and the run here is of another; the command runs with "
    "more options on its own page",
    "carosac train --preset carosac --robot my-robot.yaml": "a second robot: 20 minutes, and the "
    "same command runs for the bundled one",
    "carosac train --preset residual --device cuda --set td3.environments=1024 --set "
    "td3.steps=4000000": "needs a GPU",
    **dict.fromkeys(
        (
            "carosac compare --suite reference",
            "carosac compare --suite reference --controllers my_module:MyController "
            "--against benchmarks/reference",
            "carosac compare --suite reference --estimators my_module:MyEstimator "
            "--against benchmarks/reference",
        ),
        "24 minutes; `make bench` runs the suite",
    ),
}


@dataclass(frozen=True)
class Written:
    """A command as it is written on a page.

    Attributes:
        page: Name of the page.
        text: The command, on one line, without comments.
    """

    page: str
    text: str

    @property
    def words(self) -> list[str]:
        """What stands after ``carosac``."""
        return shlex.split(self.text)[1:]

    @property
    def name(self) -> str:
        """First word of the command."""
        return self.words[0]

    @property
    def synopsis(self) -> bool:
        """Whether it says what may be written, with brackets and placeholders, and is none."""
        return " [" in self.text or re.search(r" [A-Z]{3,}\b| X Y Z", self.text) is not None


def written() -> list[Written]:
    """All commands in blocks of README, docs and text of notebooks, in order of the pages."""
    found = []
    for page in PAGES:
        text = markdown(page)
        for kind, block in re.findall(r"```(console|bash)\n(.*?)```", text, re.DOTALL):
            start = "$ carosac " if kind == "console" else "carosac "
            block = textwrap.dedent(block)  # blocks in lists are indented
            for line in re.sub(r"\\\n\s*|\n(?=\s+[\[-])", " ", block).splitlines():
                if line.startswith(start):
                    command = re.sub(r"\s+#.*", "", line.removeprefix("$ "))
                    found.append(Written(page.name, re.sub(r"\s+", " ", command).strip()))
    return found


def shortened(words: Sequence[str]) -> list[str]:
    """A command with the options of `SHORTER` for its own."""
    result = list(words)
    if "--held-out" in result:  # recordings as they are
        return result
    name = " ".join(words[:2]) if " ".join(words[:2]) in SHORTER else words[0]
    for option, values in SHORTER.get(name, {}).items():
        if option in result:
            at = result.index(option)
            end = at + 1
            while end < len(result) and not result[end].startswith("--"):
                end += 1
            del result[at:end]
        result += [option, *values]
    return result


def bring(folder: Path) -> None:
    """Put into a folder what readers bring: robot files, a survey, runs, a bag."""
    import carosac_toolkit as ct
    from carosac_toolkit.recordings.bundled import find_recording
    from carosac_toolkit.robot.file import robot_text

    for file in (DOCS / "files").iterdir():
        shutil.copy(file, folder)
    text = robot_text("carosac")
    for name in ("surveyed", "calibrated", "identified"):
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
    mine = text.replace("name: carosac", "name: my-robot", 1)  # results are named after it
    (folder / "my-robot.yaml").write_text(mine, encoding="utf-8")
    for page in (
        "calibration-tachymeter", "calibration-without-poses", "calibration-rests",
        "tutorial-calibrate",
    ):  # fmt: skip
        _program(page, folder)
    (folder / "tilted.py").write_text(programs("your-controller")[0], encoding="utf-8")
    policies = ROOT / "learned" / "policies"
    shutil.copy(policies / "carosac-residual.onnx", folder / "policy.onnx")
    trained = folder / "carosac-results" / "train" / "carosac-carosac-seed0" / "sag"
    trained.mkdir(parents=True)
    shutil.copy(policies / "carosac-settle.onnx", trained / "policy.onnx")
    run = ct.load_recording(find_recording("synthetic"))
    ct.save_recording(run.slice(0, 600), folder / "run.csv")
    for k in range(4):
        part = run.slice(100 * k, 100 * (k + 1))
        ct.save_recording(part, folder / f"swing{k + 1}.csv")
    _bag(folder / "run.bag")


def make(run: Callable[[list[str]], int], folder: Path) -> None:
    """Make what some commands show, in the folder where `run` runs: a study, a run, a robot."""
    (folder / "carosac-results" / "run").mkdir(parents=True, exist_ok=True)
    for words, made in MADE:
        run(shlex.split(words))
        if not (folder / made).exists():
            raise RuntimeError(f"carosac {words} made no {made}")


def programs(page: str) -> list[str]:
    """The Python programs of a page."""
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    return re.findall(r"```python\n(.*?)```", text, re.DOTALL)


def _program(page: str, folder: Path) -> None:
    """Run the first program of a page, as its reader does: it writes files."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        exec(programs(page)[0], {})
    finally:
        os.chdir(before)


def _bag(path: Path) -> None:
    """Five seconds of the bundled run as a bag of ROS 1."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    import carosac_toolkit as ct
    from carosac_toolkit.recordings.bundled import find_recording

    run = ct.load_recording(find_recording("synthetic")).slice(0, 100)
    store = get_typestore(Stores.ROS1_NOETIC)
    kinds = store.types

    def header(seconds: float) -> object:
        whole = int(seconds)
        stamp = kinds["builtin_interfaces/msg/Time"](whole, round((seconds - whole) * 1e9))
        return kinds["std_msgs/msg/Header"](seq=0, stamp=stamp, frame_id="world")

    def vector(values: Sequence[float], kind: str = "Vector3") -> object:
        return kinds[f"geometry_msgs/msg/{kind}"](*(float(value) for value in values))

    def turn(wxyz: Sequence[float]) -> object:
        return vector([*wxyz[1:], wxyz[0]], "Quaternion")

    start, nothing = 1.75e9, np.zeros(9)
    names, none = ["front_left", "front_right", "rear_right", "rear_left"], np.zeros(0)
    with Writer(path) as writer:

        def send(topic: str, kind: str, seconds: float, **values: object) -> None:
            message = kinds[kind](header=header(seconds), **values)
            known = {c.topic: c for c in writer.connections}
            link = known.get(topic) or writer.add_connection(topic, kind, typestore=store)
            writer.write(link, round(seconds * 1e9), store.serialize_ros1(message, kind))

        for when, lengths in zip(run.time, run.unstrained_length, strict=True):
            send("/joint_states", "sensor_msgs/msg/JointState", start + when, name=names,
                 position=lengths, velocity=none, effort=none)  # fmt: skip
        for when, place, wxyz in zip(
            run.poses.time, run.poses.position, run.poses.quaternion, strict=True
        ):
            pose = kinds["geometry_msgs/msg/Pose"](vector(place, "Point"), turn(wxyz))
            send("/mocap/pose", "geometry_msgs/msg/PoseStamped", start + when, pose=pose)
        for k in range(200):
            send("/imu", "sensor_msgs/msg/Imu", start + 0.005 * k, orientation=turn([1, 0, 0, 0]),
                 orientation_covariance=nothing, angular_velocity=vector([0, 0, 0]),
                 angular_velocity_covariance=nothing, linear_acceleration=vector([0, 0, 9.81]),
                 linear_acceleration_covariance=nothing)  # fmt: skip


def to_run(names: Sequence[str] = ()) -> list[Written]:
    """Commands to run, each once, the quick ones once a page; of some names only, if any."""
    found: dict[tuple[str, str], Written] = {}
    for command in written():
        if not command.synopsis and command.text not in EXCEPTIONS:
            page = command.page if command.name in QUICK else ""  # files of one page are its own
            found.setdefault((page, command.text), command)
    return [command for command in found.values() if not names or command.name in names]


def run_all(run: Callable[[list[str]], int], commands: Sequence[Written]) -> list[str]:
    """Run commands, in the current folder or where `run` does; returns what failed.

    Args:
        run: Takes what stands after ``carosac``, returns the exit status.
        commands: In their order.
    """
    failed = []
    for command in commands:
        start = time.perf_counter()
        status = run(shortened(command.words))
        took = f"{time.perf_counter() - start:6.1f} s"
        print(f"{took}  status {status}  {command.page}: {command.text}", flush=True)
        verdict = command.name in VERDICTS or command.text in UNCERTAIN
        allowed = (1,) if command.text in NEGATIVE else (0, 1) if verdict else (0,)
        if status not in allowed:
            failed.append(f"{command.page}: {command.text}: status {status}")
    return failed


class Processes:
    """Runs each command in a process of its own; an emulated PLC stays until the next one."""

    def __init__(self, folder: Path) -> None:
        """Run them in a folder."""
        self._folder = folder
        self._plc: subprocess.Popen[str] | None = None

    def run(self, words: list[str]) -> int:
        """Run what stands after ``carosac``; returns the exit status."""
        if words[0] == "plc":  # stays, for `carosac run` after it
            return self._start_plc(words)
        if "ads" in words:
            self._start_plc(shortened(["plc", "carosac"]))
        try:
            done = subprocess.run(
                _call(words), capture_output=True, text=True, timeout=LONGEST, cwd=self._folder
            )
        except subprocess.TimeoutExpired:
            print(f"carosac {shlex.join(words)}: over {LONGEST} s", file=sys.stderr)
            return 124
        if done.returncode:
            print(done.stdout[-2000:], done.stderr, file=sys.stderr)
        return done.returncode

    def close(self) -> None:
        """End the PLC."""
        if self._plc is not None:
            self._plc.terminate()
            self._plc.wait()

    def _start_plc(self, words: list[str]) -> int:
        """Start a PLC in place of the one before, and wait until it is ready."""
        self.close()
        self._plc = subprocess.Popen(
            _call(words), stdout=subprocess.PIPE, text=True, cwd=self._folder
        )
        assert self._plc.stdout is not None
        return 0 if "ready" in self._plc.stdout.readline() else 1


def _call(words: list[str]) -> list[str]:
    """A ``carosac`` command as a process."""
    return [sys.executable, "-m", "carosac_toolkit.cli.main", *words]


def shares(commands: Sequence[Written], jobs: int) -> list[list[Written]]:
    """Commands by who runs them; those of a page, and all pages with a PLC, stay together.

    Args:
        commands: In their order, which stays.
        jobs: How many run at a time.
    """
    live = {c.page for c in commands if c.name in ("plc", "run")}
    groups: dict[str, list[Written]] = {}
    for command in commands:
        groups.setdefault("live" if command.page in live else command.page, []).append(command)
    found: list[list[Written]] = [[] for _ in range(jobs)]
    for group in sorted(groups.values(), key=_seconds, reverse=True):
        min(found, key=_seconds).extend(group)
    return [share for share in found if share]


def _seconds(commands: Sequence[Written]) -> float:
    """About how long they take."""
    return sum(SECONDS.get(command.name, 4.0) for command in commands)


def run_share(template: Path, commands: Sequence[Written]) -> list[str]:
    """Run commands, those of each page in a copy of the template; returns what failed."""
    failed = []
    for page, group in itertools.groupby(commands, key=lambda command: command.page):
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(scratch) / page
            shutil.copytree(template, folder)
            processes = Processes(folder)
            try:
                failed += run_all(processes.run, list(group))
            finally:
                processes.close()
    return failed


def main() -> int:
    """Run all of them, each in a process of its own."""
    parser = argparse.ArgumentParser(description=__doc__)
    known = sorted({command.name for command in to_run()})
    parser.add_argument("--only", nargs="+", default=[], choices=known, help="only these")
    parser.add_argument("--jobs", type=int, default=1, choices=range(1, 17), metavar="N",
                        help="how many run at a time")  # fmt: skip
    options = parser.parse_args()
    os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    with tempfile.TemporaryDirectory() as scratch, ThreadPoolExecutor(options.jobs) as pool:
        template = Path(scratch)
        bring(template)
        make(Processes(template).run, template)
        share = functools.partial(run_share, template)
        parts = pool.map(share, shares(to_run(options.only), options.jobs))
        failed = [text for part in parts for text in part]
    print("\n".join(failed) or "all ran")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
