"""Make the pictures in docs/images again, except those of the viewer: python docs/make_images.py.

With names, such as ``python docs/make_images.py paired workspace``, only those. The pictures of
the viewer are screenshots: python -m tests.viewer.make_pictures.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from learned.pictures.reward_figure import paper_reward_terms

HERE = Path(__file__).parent
IMAGES, EXAMPLES = HERE / "images", HERE.parent / "examples"
COMPARED = "compare --controllers straight_line kinematic_solver input_shaping"
PAIRED = (
    f"{COMPARED} --baseline kinematic_solver --estimators dynamic_estimator --sensors lengths+imu "
    "--trajectories minimum_snap waypoints --speed 2 --acceleration 2 --seeds 8 --batch 8"
)
LENGTHS = f"{COMPARED} --trajectories minimum_snap waypoints --speed 2.5 --acceleration 2 --seeds 1"
SLICES = "workspace carosac --box frame --slice x=0.4 y=-1.8 z=5"


def main(names: list[str]) -> None:
    """Make the pictures with these names, or all."""
    makers = {name: make for name, make in MAKERS.items() if name in names or not names}
    unknown = set(names) - set(MAKERS)
    if unknown:
        sys.exit(f"no picture {', '.join(sorted(unknown))}; allowed: {', '.join(MAKERS)}")
    for name, make in makers.items():
        with tempfile.TemporaryDirectory() as folder:
            make(Path(folder), IMAGES / f"{name}.png")
        print(f"{name}.png", flush=True)


def carosac(command: str, *more: str) -> None:
    """Run a command of the toolkit, without its output."""
    words = [sys.executable, "-m", "carosac_toolkit.cli.main", *command.split(), *more]
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL)


def example(stem: str) -> Callable[[Path, Path], None]:
    """Return what runs an example and takes its picture."""

    def make(folder: Path, picture: Path) -> None:
        subprocess.run([sys.executable, str(EXAMPLES / f"{stem}.py")], check=True, cwd=folder)
        shutil.copy(folder / f"{stem}.png", picture)

    return make


def output(command: str, file: str) -> Callable[[Path, Path], None]:
    """Return what runs a command and takes one picture of its folder."""

    def make(folder: Path, picture: Path) -> None:
        carosac(command, "--output", str(folder / "out"))
        shutil.copy(folder / "out" / file, picture)

    return make


def figure_lengths(folder: Path, picture: Path) -> None:
    """Draw the fourth figure of the paper from a small study."""
    carosac(LENGTHS, "--output", str(folder / "study"))
    carosac("figures", str(folder / "study"), "--output", str(folder), "--formats", "png")
    shutil.copy(folder / "04_commanded_length_error.png", picture)


def reward_terms(folder: Path, picture: Path) -> None:
    """Draw the terms of the reward."""
    paper_reward_terms(picture)


DRAWN_EXAMPLES = (
    "01_hang", "02_swing", "03_tachymeter", "05_self_calibration", "07_stop_the_sway",
    "14_other_programs", "15_smooth",
)  # fmt: skip
MAKERS = {
    **{stem: example(stem) for stem in DRAWN_EXAMPLES},
    "figure_lengths": figure_lengths,
    "paired": output(PAIRED, "paired.png"),
    "reward_terms": reward_terms,
    "workspace": output(SLICES, "slices.png"),
}

if __name__ == "__main__":
    main(sys.argv[1:])
