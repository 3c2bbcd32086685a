"""Comparative study as one value: its axes, its conditions and its execution."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from carosac_toolkit import trajectories
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.numbers import check_whole
from carosac_toolkit.loop.plugins import name_of
from carosac_toolkit.loop.protocols import replays
from carosac_toolkit.physics.kernel_modules import compile_kernels
from carosac_toolkit.robot.condition_file import condition_digest, find_condition
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.robot.perturbations import DEFAULT_CONDITION
from carosac_toolkit.studies.compare.checks import (
    RECORDED_TRAJECTORY,
    check_known,
    check_positive,
    check_sensors,
    check_settings,
    check_swivels,
    check_truth,
    find_plugin,
)
from carosac_toolkit.studies.compare.defaults import (
    DEFAULT_SEEDS,
    DEFAULT_TRAJECTORIES,
    QUICK_SEEDS,
    default_controllers,
    default_estimation,
)
from carosac_toolkit.studies.compare.feasibility import PathFeasibility, path_feasibility
from carosac_toolkit.studies.compare.results import StudyResults
from carosac_toolkit.studies.run.batching import Batching
from carosac_toolkit.studies.run.case import TRUTH, Case, product
from carosac_toolkit.studies.run.cluster import default_workers, remote_client
from carosac_toolkit.studies.run.engine import DEFAULT_TIMEOUT_S, run_cases
from carosac_toolkit.studies.run.folder import check_statuses, free_folder, has_cases_left
from carosac_toolkit.studies.run.robot_copies import copy_paths, copy_robots
from carosac_toolkit.studies.run.run_case import (
    CASE_DRIVER_SETTINGS,
    DEFAULT_DRIVER,
    file_digests,
    own_settings,
    robot_digest,
    robot_of,
)
from carosac_toolkit.trajectories.catalogue import default_limits
from carosac_toolkit.trajectories.path_file import check_suffix, is_path_file, path_digest

CASE_FUNCTION = "carosac_toolkit.studies.run.run_case:run_case"
GROUPING_FUNCTION = "carosac_toolkit.studies.run.run_together:group_of"
BATCH_FUNCTION = "carosac_toolkit.studies.run.run_together:run_together"
DEFAULT_STUDY_FOLDER = Path("carosac-results") / "compare"
SEEDS_ALLOWED = "a whole number, 1 or more, or a list of seeds"


@dataclass(frozen=True, kw_only=True)
class Study:
    """Controllers and estimators, each run on the same draws of plant and noise, and scored.

    Every combination of the first seven is one case. Cases that differ in controller or estimator
    alone meet the same plant, the same trajectory and the same sensor noise.

    Attributes:
        robots: Bundled names, or paths of robot files.
        controllers: Names, ``module:Class``, or classes; a class is kept as ``module:Class``. None:
            on the driver ``simulator`` ``straight_line``, ``kinematic_solver``, ``input_shaping``,
            ``mpc`` and, where the robots have a bundled policy, ``td3``; on other drivers the first
            two.
        estimators: The same; ``truth`` is what a simulated driver knows. None:
            ``dynamic_estimator`` on the driver ``simulator``, ``kinematic_solver`` on others.
        sensors: Sensors that measure, such as ``lengths+imu``; the driver must have them. None:
            ``lengths+imu`` on the driver ``simulator``, ``lengths`` on others.
        trajectories: Of the catalogue, `carosac_toolkit.trajectories.TRAJECTORY_NAMES`, or files,
            see `carosac_toolkit.trajectories.from_file`, whose speeds are their own; on the driver
            `replay` all of these are ``recorded`` instead, the path of the recording.
        perturbations: Conditions that the plants are drawn from: names, or paths of YAML files.
        seeds: How many draws, 0, 1, 2 and so on; or which.
        driver: Name, ``module:Class``, or class.
        speed_max: Of the trajectories [m/s]; None: on the robot ``carosac`` 1 m/s, 2 m/s for
            ``fast_move``, and as `carosac_toolkit.trajectories.catalogue.default_limits` says for
            others.
        acceleration_max: Of the trajectories [m/s^2]; None: 1 m/s^2, or 2 m/s^2, likewise.
        controller_settings: By the name or class of a controller, fields of its own settings.
        estimator_settings: By the name or class of an estimator, fields of its own settings.
        driver_settings: Fields of the driver's own settings.
        output: Folder of the results; a second run with the same folder goes on. None is
            ``carosac-results/compare``, numbered where another study is there already.
        scheduler: Address of a dask scheduler, or None for processes of this machine.
        workers: Number of processes; 0 runs in this one; None is one per core.
        timeout: Time limit of a case [s].
        retry: Statuses of finished cases to run again: ``diverged``, ``failed``, ``crashed``,
            ``timed_out``.
        batch: Number of seeds that run together in one simulation, if driver, controller and
            estimator can; 1 is each alone. The rows are the same to rounding, but without
            latencies.
    """

    robots: Sequence[str] = ("carosac",)
    controllers: Sequence[Any] = None  # type: ignore[assignment]  # filled in as the next two
    estimators: Sequence[Any] = None  # type: ignore[assignment]
    sensors: Sequence[str] = None  # type: ignore[assignment]
    trajectories: Sequence[str] = DEFAULT_TRAJECTORIES
    perturbations: Sequence[str] = (DEFAULT_CONDITION,)
    seeds: int | Sequence[int] = DEFAULT_SEEDS
    driver: Any = DEFAULT_DRIVER
    speed_max: float | None = None
    acceleration_max: float | None = None
    controller_settings: Mapping[Any, Mapping[str, Any]] = field(default_factory=dict)
    estimator_settings: Mapping[Any, Mapping[str, Any]] = field(default_factory=dict)
    driver_settings: Mapping[str, Any] = field(default_factory=dict)
    output: str | Path | None = None
    scheduler: str | None = None
    workers: int | None = None
    timeout: float = DEFAULT_TIMEOUT_S
    retry: Sequence[str] = ()
    batch: int = 1

    def __post_init__(self) -> None:
        """Fill in defaults, turn lists into tuples and classes into names; refuse a string."""
        if None in (self.controllers, self.estimators, self.sensors):
            self._fill_in()
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name in ("seeds", "retry", *STUDY_AXES) and not isinstance(value, int):
                if isinstance(value, str) or not isinstance(value, Sequence):
                    allowed = SEEDS_ALLOWED if item.name == "seeds" else "a list"
                    raise InvalidField(item.name, repr(value), allowed)
                object.__setattr__(self, item.name, tuple(value))
        object.__setattr__(self, "driver", name_of(self.driver))
        for kind in ("controllers", "estimators"):
            object.__setattr__(self, kind, tuple(name_of(plugin) for plugin in getattr(self, kind)))
            settings = getattr(self, f"{kind[:-1]}_settings")
            by_name = {name_of(plugin): values for plugin, values in settings.items()}
            object.__setattr__(self, f"{kind[:-1]}_settings", by_name)
        known = self.trajectories and set(self.trajectories) <= set(trajectories.TRAJECTORY_NAMES)
        if self.driver == "replay" and known:  # `check` refuses all others
            object.__setattr__(self, "trajectories", (RECORDED_TRAJECTORY,))
        if isinstance(self.seeds, int) and (isinstance(self.seeds, bool) or self.seeds < 1):
            raise InvalidField("seeds", repr(self.seeds), SEEDS_ALLOWED)

    def _fill_in(self) -> None:
        """Take the defaults for what was not named; warn of what cannot be used here."""
        found: dict[str, Any] = {}
        texts: tuple[str, ...] = ()
        if self.controllers is None and not isinstance(self.robots, str):  # `check` refuses that
            found["controllers"], texts = default_controllers(self.driver, self.robots)
        if self.estimators is None or self.sensors is None:
            usual, more = default_estimation(self.driver)
            found |= {"estimators": usual.estimators, "sensors": usual.sensors}
            texts += more if self.estimators is None else ()
        for text in texts:
            warnings.warn(text, stacklevel=4)
        for name, value in found.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, value)

    def quick(self) -> Study:
        """Return the same study with the first two seeds: a first look, in under a minute."""
        return replace(self, seeds=self.seed_list[:QUICK_SEEDS])

    @property
    def seed_list(self) -> tuple[int, ...]:
        """Seeds of the study."""
        return tuple(range(self.seeds)) if isinstance(self.seeds, int) else tuple(self.seeds)

    def cases(self) -> list[Case]:
        """Return all cases, grouped by controller and estimator, the seeds changing fastest.

        Raises:
            InvalidField: An axis is empty or names a value twice, or a value is not allowed.
        """
        cases = product(
            **{name: getattr(self, name) for name in STUDY_AXES},
            seeds=self.seed_list,
            settings=self._settings(),
        )
        return [replace(case, settings=self._settings_of(case)) for case in cases]

    def check(self) -> None:
        """Refuse a study that could not run, before any work is done or anything is written.

        Raises:
            CarosacError: A name that leads nowhere, a number out of its range, a scheduler that
                does not answer.
        """
        _check(self)
        if self.scheduler is not None:
            with remote_client(self.scheduler):
                pass

    def prepare(self) -> None:
        """Compile the kernels of the toolkit, driver and estimators before several processes do.

        Without cases left to run on this machine nothing is compiled.
        """
        if self.scheduler is not None or self.workers == 0:
            return
        if has_cases_left(self.folder(), self.cases(), self.retry):
            compile_kernels(self._kernel_packages())

    @cached_property
    def feasibility(self) -> tuple[PathFeasibility, ...]:
        """Feasibility of the paths with the tensions and winches of each robot, before any run."""
        return tuple(path_feasibility(self.cases()))

    def folder(self) -> Path:
        """Return the folder of the results."""
        return (
            Path(self.output)
            if self.output is not None
            else free_folder(DEFAULT_STUDY_FOLDER, self.cases())
        )

    def run(self, *, progress: bool = True) -> StudyResults:
        """Check everything, run the missing cases of the folder, and score.

        Args:
            progress: True to report progress on standard error.

        Raises:
            CarosacError: As `check` and `run_cases`.
        """
        self.check()
        self.prepare()
        folder = self.folder()
        judged = self.feasibility
        rows = run_cases(
            self.cases(), CASE_FUNCTION, folder=folder, scheduler=self.scheduler,
            workers=self._worker_count(), timeout=self.timeout, retry=self.retry,
            batching=self._batching(), progress=progress,
            begun=lambda: self._copy_inputs(folder),
        )  # fmt: skip
        return StudyResults(rows=tuple(rows), folder=folder, feasibility=judged)

    def _kernel_packages(self) -> set[str]:
        """Return the top-level packages of the driver, of one behind it, and of the estimators."""
        driver = find_plugin("drivers", self.driver)
        usual = getattr(getattr(driver, "Settings", None), "driver", None)  # of a guard
        behind = own_settings(self.driver, self.driver_settings).get("driver", usual)
        plugins = [driver, *([find_plugin("drivers", behind)] if behind is not None else [])]
        plugins += [find_plugin("estimators", name) for name in self.estimators if name != TRUTH]
        return {plugin.__module__.partition(".")[0] for plugin in plugins}

    def _copy_inputs(self, folder: Path) -> None:
        """Copy the files that the study reads into its folder."""
        copy_robots(folder, self.robots)
        copy_paths(folder, [name for name in self.trajectories if is_path_file(name)])

    def _batching(self) -> Batching | None:
        """Return how cases run together."""
        if self.batch == 1:
            return None
        return Batching(group=GROUPING_FUNCTION, function=BATCH_FUNCTION, size=self.batch)

    def _worker_count(self) -> int | None:
        """Return the number of workers; user code runs in this process only on request.

        A plug-in of the user may hang or end its process, which must cost its own cases only.
        Without the packages of worker processes there is no choice.
        """
        outside = any(":" in name for name in (*self.controllers, *self.estimators, self.driver))
        if self.workers is None and self.scheduler is None and outside:
            return default_workers()
        return self.workers

    def _settings(self) -> dict[str, Any]:
        """Return the settings that all cases share; pictures are of the first seed."""
        settings: dict[str, Any] = {
            "driver": self.driver,
            "example_seed": self.seed_list[0] if self.seed_list else 0,
        }
        if self.driver_settings:
            settings["driver_settings"] = dict(self.driver_settings)
        return settings

    def _settings_of(self, case: Case) -> dict[str, Any]:
        """Return the settings of one case, with those of its controller and estimator."""
        digest = robot_digest(case.robot)
        speed, acceleration = default_limits(robot_of(case.robot, digest), case.trajectory)
        settings = dict(case.settings) | {
            "robot_digest": digest,
            "speed_max": speed if self.speed_max is None else float(self.speed_max),
            "acceleration_max": (
                acceleration if self.acceleration_max is None else float(self.acceleration_max)
            ),
        }
        path = path_digest(case.trajectory)
        if path is not None:  # its speeds are those of the file
            del settings["speed_max"], settings["acceleration_max"]
            settings["trajectory_digest"] = path
        condition = condition_digest(case.perturbation)
        if condition is not None:
            settings["condition_digest"] = condition
        if case.controller in self.controller_settings:
            settings["controller_settings"] = dict(self.controller_settings[case.controller])
        if case.estimator in self.estimator_settings:
            settings["estimator_settings"] = dict(self.estimator_settings[case.estimator])
        files = file_digests(settings)
        if files:
            settings["file_digests"] = files
        return settings


STUDY_AXES = ("robots", "controllers", "estimators", "sensors", "trajectories", "perturbations")


def _check(study: Study) -> None:
    """Refuse a study that could not run.

    Raises:
        CarosacError: What is wrong, and what is allowed.
    """
    for name, unit in (("speed_max", "m/s"), ("acceleration_max", "m/s^2")):
        if getattr(study, name) is not None:
            check_positive(name, getattr(study, name), unit)
    driver = find_plugin("drivers", study.driver)
    _check_trajectories(study, replayed=replays(driver))
    study.cases()
    _check_execution(study)
    robots = [load_robot(robot) for robot in study.robots]
    if not replays(driver):
        check_swivels(robots, study.sensors)
    for name in study.perturbations:
        find_condition(name)
    own = own_settings(study.driver, study.driver_settings)
    for name in sorted(set(CASE_DRIVER_SETTINGS) & set(own)):
        raise InvalidField(f"driver_settings.{name}", repr(own[name]), "none: each case sets it")
    check_sensors(driver, study.driver, study.sensors)
    check_settings("driver_settings", study.driver, driver, own)
    for kind in ("controllers", "estimators"):
        names = getattr(study, kind)
        wanted = getattr(study, f"{kind[:-1]}_settings")
        check_known(f"{kind[:-1]}_settings", wanted, names)
        for name in names:
            if kind == "estimators" and name == TRUTH:
                check_truth(driver, study.driver)
                continue
            plugin = find_plugin(kind, name)
            check_settings(f"{kind[:-1]}_settings", name, plugin, wanted.get(name, {}))
            if hasattr(plugin, "check_robot") and not wanted.get(name):
                _check_any_robot(study, plugin)


def _check_any_robot(study: Study, controller: Any) -> None:
    """Refuse a controller that refuses all robots of a study."""
    errors = []
    for robot in study.robots:
        try:
            controller.check_robot(load_robot(robot))
        except CarosacError as error:
            errors.append(error)
    if len(errors) == len(study.robots):
        raise errors[0]


def _check_trajectories(study: Study, *, replayed: bool) -> None:
    """Refuse trajectories that are not there, or files that a robot cannot follow."""
    names = trajectories.TRAJECTORY_NAMES
    files = [] if replayed else [name for name in study.trajectories if is_path_file(name)]
    drawn = [name for name in study.trajectories if name not in files]
    for name in drawn:
        check_suffix(name)
    check_known(
        "trajectory", drawn, (RECORDED_TRAJECTORY, *names) if replayed else names,
        more="" if replayed else ", or a file: .csv, a recording, or ./FOLDER with one",
    )  # fmt: skip
    for name, unit in (("speed_max", "m/s"), ("acceleration_max", "m/s^2")):
        if getattr(study, name) is not None and files and not drawn:
            allowed = "none: all trajectories are files, which have their own"
            raise InvalidField(name, f"{getattr(study, name)} {unit}", allowed)
    for name in files:
        for robot in study.robots:
            trajectories.from_file(name, robot_of(robot, robot_digest(robot)))


def _check_execution(study: Study) -> None:
    """Refuse what `run_cases` would refuse, before anything is said to run."""
    if not 0.0 < study.timeout < 1e7:
        raise InvalidField("timeout", f"{study.timeout} s", "0 < timeout < 1e7 s")
    check_statuses(study.retry)
    check_whole("batch", study.batch, 1)
    if study.workers is not None and study.scheduler is not None:
        raise InvalidField("workers", str(study.workers), "no number of workers with a scheduler")
    if study.workers is not None and study.workers < 0:
        raise InvalidField("workers", str(study.workers), "0 or more")
