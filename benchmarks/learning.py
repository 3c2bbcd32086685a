"""Learned control: how fast it learns, how well, against whom, and on a real recording.

Run from the project's root, each part a section of ``benchmarks/RESULTS.md``; ``make learning``
trains policies and runs `curves`, `bars`, `drive`, `inference` and `low` on them, the rest is run
by hand:

``python -m benchmarks.learning --parts throughput``: part of ``make bench``.
``python -m benchmarks.learning --parts gpu``: environments on a GPU beside one core.
``python -m benchmarks.learning --parts inference``: on an idle machine.
``python -m benchmarks.learning --parts curves bars --runs DIR``: of trainings that ``carosac train
--output DIR/NAME-SEED`` left behind.
``python -m benchmarks.learning --parts drive --policies FILE ... --seeds N``: policies, model
predictive control, input shaping and inverse kinematics on the same moves.
``python -m benchmarks.learning --parts low [--policies FILE ...]``: whether platforms calm down low
in the box, behind two estimators.
``python -m benchmarks.learning --parts ways --runs DIR --seeds 15``: learned from scratch,
distilled and both, after as much CPU time; trains what is missing in DIR, an hour a robot.
``python -m benchmarks.learning --parts ablation --runs DIR``: the paper's own training, changed;
trains what is missing in DIR, over two hours of one core.
``python -m benchmarks.learning --parts recording --recording FILE --robot FILE --policies FILE``:
lengths commanded to a simulator that was fitted to the recorded robot.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from benchmarks.results import write_section

COMMAND = "python -m benchmarks.learning"


def throughput_part(_: argparse.Namespace) -> tuple[str, str]:
    """Title and text."""
    from benchmarks import learning_throughput as part

    return part.TITLE, part.throughput()


def gpu_part(_: argparse.Namespace) -> tuple[str, str]:
    """Title and text."""
    from benchmarks import learning_throughput as part

    return part.GPU_TITLE, part.on_gpu()


def inference_part(_: argparse.Namespace) -> tuple[str, str]:
    """Title and text."""
    from benchmarks import learning_inference as part

    return part.TITLE, part.inference()


def curves_part(asked: argparse.Namespace) -> tuple[str, str]:
    """Title and text."""
    from benchmarks import learning_runs as part

    return "Learning curves", part.curves(part.find_trainings(asked.runs))


def bars_part(asked: argparse.Namespace) -> tuple[str, str]:
    """Title and text."""
    from benchmarks import learning_runs as part

    return "Learned control: bars", part.bars(part.find_trainings(asked.runs))


def drive_part(asked: argparse.Namespace) -> tuple[str, str]:
    """Title and text."""
    from benchmarks import learning_drive as part

    return part.TITLE, part.drive(asked.policies, asked.seeds, asked.robots, asked.processes)


def low_part(asked: argparse.Namespace) -> tuple[str, str]:
    """Title and text."""
    from benchmarks import learning_low as part

    return part.TITLE, part.low(asked.policies, asked.processes)


def recording_part(asked: argparse.Namespace) -> tuple[str, str]:
    """Title and text."""
    from benchmarks import learning_recording as part

    return part.TITLE, part.recording(asked.recording, asked.robot, asked.policies)


def ways_part(asked: argparse.Namespace) -> tuple[str, str]:
    """Title and text."""
    from benchmarks import learning_ways as part

    return part.TITLE, part.ways(asked.runs[0], asked.seeds, asked.robots, asked.processes)


def ablation_part(asked: argparse.Namespace) -> tuple[str, str]:
    """Title and text."""
    from benchmarks import learning_ablation as part

    return part.TITLE, part.ablation(asked.runs[0], asked.processes)


Part = Callable[[argparse.Namespace], tuple[str, str]]
PARTS: dict[str, tuple[Part, tuple[str, ...]]] = {  # with the options that it needs
    "throughput": (throughput_part, ()),
    "gpu": (gpu_part, ()),
    "inference": (inference_part, ()),
    "curves": (curves_part, ("runs",)),
    "bars": (bars_part, ("runs",)),
    "drive": (drive_part, ()),
    "low": (low_part, ()),
    "ways": (ways_part, ("runs",)),
    "ablation": (ablation_part, ("runs",)),
    "recording": (recording_part, ("recording", "robot", "policies")),
}


def options() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog=COMMAND, description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=["throughput"])
    parser.add_argument("--runs", nargs="+", type=Path, help="folders of trainings")
    parser.add_argument("--policies", nargs="+", type=Path, default=[], help="ONNX files")
    parser.add_argument("--seeds", type=int, default=3, help="of `drive` and `ways`")
    robots = ["carosac", "scampi"]
    parser.add_argument("--robots", nargs="+", default=robots, help="of `drive` and `ways`")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--recording", type=Path, help="CSV, Parquet or .mat, with poses")
    parser.add_argument("--robot", type=Path, help="what `carosac identify` made of it")
    parser.add_argument("--print-only", action="store_true", help="leave RESULTS.md as it is")
    return parser


def main() -> None:
    """Measure and write the sections."""
    parser = options()
    asked = parser.parse_args()
    for name in asked.parts:
        for needed in PARTS[name][1]:
            if not getattr(asked, needed):
                parser.error(f"part {name} needs --{needed}")
    for name in asked.parts:
        print(f"part: {name}", flush=True)
        title, text = PARTS[name][0](asked)
        print(text, flush=True)
        if not asked.print_only:
            command = "make bench" if name == "throughput" else f"{COMMAND} --parts {name}"
            command += f" --seeds {asked.seeds}" if name in ("drive", "ways") else ""
            command += f" --robots {' '.join(asked.robots)}" if name == "ways" else ""
            command += " --runs DIR" if name in ("ways", "ablation") else ""
            write_section(f"learning:{name}", title, command, text)


if __name__ == "__main__":
    main()
