"""Compare controllers and estimators on the same draws of plants, paths and noise.

Every combination is a case; cases run on all cores, or on a dask cluster. Warns of values of a
robot that seem to be in another unit, and of paths that its tensions and winches cannot follow.
Prints one table of errors, tensions and limited commands, what diverged or failed and why, and what
the numbers say in three sentences; writes pictures, one self-contained report.html and the row of
every case in Parquet. Interrupted, the same command with the same --output goes on.

Exit status 1 means that a row of the table has no score: all its cases diverged or failed.
"""

from __future__ import annotations

from dataclasses import replace

from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.tables import counted, terminal_width, wrapped
from carosac_toolkit.cli.common import CommandResult
from carosac_toolkit.cli.compare_options import Options
from carosac_toolkit.cli.compare_reference import run_suite
from carosac_toolkit.inspection.report import report_robot
from carosac_toolkit.inspection.units import doubtful_units
from carosac_toolkit.loop.plugin_settings import chosen_settings
from carosac_toolkit.reports.page import check_folder
from carosac_toolkit.reports.study import (
    ANIMATION_FILE,
    animation_of,
    check_animation,
    write_report,
)
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.studies.compare.defaults import (
    DEFAULT_SEEDS,
    QUICK_SEEDS,
    default_controllers,
    default_estimation,
)
from carosac_toolkit.studies.compare.feasibility import infeasible
from carosac_toolkit.studies.compare.findings import conclusions
from carosac_toolkit.studies.compare.headlines import headlines
from carosac_toolkit.studies.compare.names import told_apart
from carosac_toolkit.studies.compare.paired import (
    check_baseline,
    paired_blocks,
    ways_of,
)
from carosac_toolkit.studies.compare.results import StudyResults
from carosac_toolkit.studies.compare.study import STUDY_AXES, Study
from carosac_toolkit.studies.compare.surprises import grave_surprises, surprises
from carosac_toolkit.studies.compare.tables import failures
from carosac_toolkit.studies.compare.terminal_table import caption, terminal_table
from carosac_toolkit.trajectories.catalogue import default_limits
from carosac_toolkit.trajectories.path_file import departure_from_rows, is_path_file


def run(options: Options) -> CommandResult:
    """Run the study, print and draw it."""
    if options.suite is not None:
        return run_suite(options, options.suite)
    if options.against is not None:
        raise InvalidField("--against", repr(options.against), "nothing without --suite")
    study, left_out = _study(options)
    study.check()
    if options.baseline is not None:
        check_baseline(
            options.baseline, ways_of(study.controllers, study.estimators, study.sensors)
        )
    study = replace(study, output=study.folder())
    check_folder("--output", study.folder())
    if options.animation:
        check_animation(options.animation, study.controllers)
    width = terminal_width()
    print(wrapped(_what(study), width), flush=True)
    for text in left_out:
        print(wrapped(text, width), flush=True)
    study.prepare()
    for text in _doubts(study):
        print(wrapped(text, width, "WARNING: "), flush=True)
    for one in infeasible(study.feasibility):
        print(wrapped(one.sentence(), width, "WARNING: "), flush=True)
    for text in filter(None, map(departure_from_rows, study.trajectories)):
        print(wrapped(text, width, "NOTE: "), flush=True)
    results = study.run()
    sentences, short = conclusions(results), headlines(results)
    blocks = paired_blocks(results, options.baseline)
    _print(results, short, width)
    animation = _animation(options, results, width)
    write_report(results, sentences, _words(options, study), blocks, animation)
    beside = "" if animation is None else f" and {ANIMATION_FILE}"
    print(f"report{beside}: {results.folder / 'report.html'}")
    data = {
        **results.data(),
        "paired": [block.data() for block in blocks],
        "surprises": surprises(results),
        "headlines": short,
        "conclusions": sentences,
        "output": str(results.folder),
    }
    return CommandResult(data, status=0 if results.complete else 1)


def _study(options: Options) -> tuple[Study, tuple[str, ...]]:
    """Return the study that the options ask for, and a sentence for each plug-in left out."""
    count = (
        options.seeds
        if options.seeds is not None
        else QUICK_SEEDS
        if options.quick
        else DEFAULT_SEEDS
    )
    if count < 1:
        raise InvalidField("--seeds", str(count), "1 or more")
    if options.seed < 0:
        raise InvalidField("--seed", str(options.seed), "0 or more")
    controllers, left_out = options.controllers, tuple[str, ...]()
    if not controllers:
        controllers, left_out = default_controllers(options.driver, options.robots)
    estimators, sensors = options.estimators, options.sensors
    if not (estimators and sensors):
        usual, more = default_estimation(options.driver)
        left_out += () if estimators else more
        estimators, sensors = estimators or usual.estimators, sensors or usual.sensors
    study = Study(
        robots=options.robots,
        controllers=controllers,
        estimators=estimators,
        sensors=sensors,
        trajectories=options.trajectories,
        perturbations=options.conditions,
        seeds=range(options.seed, options.seed + count),
        driver=options.driver,
        speed_max=options.speed,
        acceleration_max=options.acceleration,
        output=options.output,
        scheduler=options.scheduler,
        workers=options.workers,
        timeout=options.timeout,
        batch=options.batch,
        retry=options.retry,
        **chosen_settings(options.settings, controllers=controllers, estimators=estimators),
    )
    return study, left_out


def _doubts(study: Study) -> list[str]:
    """Ask for the units of implausible values of the robots."""
    return [
        f"{robot.name}: {text}"
        for robot in map(load_robot, study.robots)
        for text in doubtful_units(report_robot(robot))
    ]


def _animation(options: Options, results: StudyResults, width: int) -> bytes | None:
    """Draw the animation if one is asked for; if it cannot be drawn, print why."""
    if not options.animation:
        return None
    try:
        return animation_of(results, options.animation)
    except CarosacError as error:
        print(wrapped(f"animation left out: {error}", width), flush=True)
        return None


def _words(options: Options, study: Study) -> list[str]:
    """Return the command line that repeats this study."""
    axes = {name: f"--{name}" for name in STUDY_AXES} | {"perturbations": "--conditions"}
    return [
        "carosac", "compare",
        *(
            word
            for name, option in axes.items()
            for word in (option, *getattr(study, name))
        ),
        "--seed", str(options.seed), "--seeds", str(len(study.seed_list)),
        "--driver", options.driver, "--timeout", f"{options.timeout:g}",
        *(["--baseline", options.baseline] if options.baseline is not None else []),
        *(["--animation", *options.animation] if options.animation else []),
        *(["--batch", str(options.batch)] if options.batch != 1 else []),
        *(["--speed", f"{options.speed:g}"] if options.speed is not None else []),
        *(["--acceleration", f"{options.acceleration:g}"] if options.acceleration is not None
          else []),
        *(word for text in options.settings for word in ("--set", text)),
    ]  # fmt: skip


def _what(study: Study) -> str:
    """Describe the study that is about to run."""
    robots = told_apart({name: load_robot(name).name for name in study.robots})
    drawn = [name for name in study.trajectories if not is_path_file(name)]
    files = [name for name in study.trajectories if name not in drawn]
    paths = [f"{counted(len(drawn), 'trajectory', 'trajectories')} ({', '.join(drawn)}) of up to "
             f"{_limits(study)}"] if drawn else []  # fmt: skip
    if files:
        own = "as fast as the file says" if len(files) == 1 else "as fast as the files say"
        paths.append(f"{', '.join(files)} {own}")
    return (
        f"{', '.join(robots.values())} on driver {study.driver}, "
        f"{'condition' if len(study.perturbations) == 1 else 'conditions'} "
        f"{', '.join(study.perturbations)}: {', '.join(paths)}, "
        f"{counted(len(study.seed_list), 'seed')}, in all {counted(len(study.cases()), 'case')}"
    )


def _limits(study: Study) -> str:
    """Return largest speed and acceleration in words, from the least to the most of the robots."""
    each = [
        default_limits(load_robot(robot), path)
        for robot in study.robots
        for path in study.trajectories
        if not is_path_file(path)
    ]
    words = []
    for asked, values, unit in zip(
        (study.speed_max, study.acceleration_max), zip(*each, strict=True), ("m/s", "m/s^2"),
        strict=True,
    ):  # fmt: skip
        numbers = sorted(
            {f"{x:.3g}" for x in ([asked] if asked is not None else values)}, key=float
        )
        words.append(f"{' to '.join(dict.fromkeys((numbers[0], numbers[-1])))} {unit}")
    return " and ".join(words)


def _print(results: StudyResults, sentences: list[str], width: int) -> None:
    """Print the table, what it does not show, the failures and the headlines."""
    print(f"\n{terminal_table(results, width)}\n{wrapped(caption(results, width), width)}")
    grave, failed = grave_surprises(results), failures(results)
    if grave or failed:
        print()
    for line in grave:
        print(wrapped(line, width, "! "))
    for line in failed:
        indent = " " * (len(line) - len(line.lstrip()))
        print(wrapped(line.lstrip(), width, indent))
    print()
    for line in sentences:
        print(wrapped(line, width, "* "))
