"""Options of ``carosac compare``, for studies of one's own and for the reference suite alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from carosac_toolkit.cli.common import CommonOptions, OutputFolder
from carosac_toolkit.robot.perturbations import DEFAULT_CONDITION
from carosac_toolkit.studies.compare.defaults import DEFAULT_TRAJECTORIES
from carosac_toolkit.studies.run.engine import DEFAULT_TIMEOUT_S
from carosac_toolkit.studies.run.run_case import DEFAULT_DRIVER


@dataclass(frozen=True, kw_only=True)
class Options(CommonOptions):
    """Options of ``carosac compare``."""

    robots: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["--robot"])] = ("carosac",)
    """Bundled robots or YAML files."""
    controllers: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["--controller"])] = ()
    """Controllers by name, or `module:Class` for your own; by default straight_line,
    kinematic_solver, input_shaping, mpc and, where the robot has a bundled policy, td3."""
    estimators: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["--estimator"])] = ()
    """Estimators by name, or `module:Class`; `truth` is the true state of a simulated driver; by
    default dynamic_estimator. NAME@LABEL is NAME with settings of its own, here and among the
    controllers."""
    suite: str | None = None
    """Run a reference suite, `reference`: it fixes robots, paths, plants, seeds and sensors. With
    --controllers or --estimators only these run, beside its baseline."""
    against: str | None = None
    """With --suite: folder of results of the same suite to compare with in pairs, such as
    benchmarks/reference."""
    sensors: tuple[str, ...] = ()
    """Sensors of the driver: `lengths`, then any of +imu, +pose, +tension, +swivel, +attitude and
    +inclination, in this order; by default lengths+imu."""
    trajectories: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["--trajectory"])] = (
        DEFAULT_TRAJECTORIES
    )
    """Trajectories of the catalogue, or files: a .csv with the columns time_s, position_x_m,
    position_y_m and position_z_m, or a recording or the folder with one; its speeds are the
    file's."""
    conditions: Annotated[
        tuple[str, ...],
        tyro.conf.arg(aliases=["--condition", "--perturbation", "--perturbations"]),
    ] = (DEFAULT_CONDITION,)
    """Conditions: how far plants, drawn at random, differ from the nominal robot. A name
    (nominal-2, nominal-1, none) or a YAML file such as my-hall.yaml."""
    seeds: int | None = None
    """Number of draws of plant, path and noise, with seeds counted up from --seed; by default
    10."""
    driver: str = DEFAULT_DRIVER
    """Driver to control: `simulator`, `quasi_static` (no sway), a recording by `replay`, or
    `module:Class`. On others than `simulator` the defaults are the first two controllers, the
    estimator kinematic_solver and lengths alone."""
    speed: float | None = None
    """Largest speed of the trajectories of the catalogue [m/s]; by default 1 m/s on the robot
    carosac, 2 m/s for fast_move, and on others as much more or less as their size asks for."""
    acceleration: float | None = None
    """Largest acceleration of the trajectories [m/s^2]; by default 1 m/s^2, and
    2 m/s^2 for fast_move."""
    settings: Annotated[
        tuple[str, ...], tyro.conf.arg(name="set", metavar="SETTING"), tyro.conf.UseAppendAction
    ] = ()
    """Setting of a plug-in: controller.NAME.FIELD=VALUE, estimator.NAME.FIELD=VALUE or
    driver.FIELD=VALUE, VALUE as JSON or text; may be given several times."""
    baseline: str | None = None
    """Baseline of all paired comparisons: a controller, or those parts of `CONTROLLER / ESTIMATOR /
    SENSORS` that differ; by default the first row of the table."""
    animation: tuple[str, ...] = ()
    """Draw animation.webp, which takes half a minute: the first seed of these controllers, one to
    three, side by side, with cables coloured by tension."""
    quick: tyro.conf.FlagCreatePairsOff[bool] = False
    """Two draws, unless --seeds is given: under a minute with the other defaults. A full run in the
    same folder continues from there."""
    scheduler: str | None = None
    """Address of a dask scheduler, such as tcp://host:8786."""
    workers: int | None = None
    """Worker processes on this machine; 0 runs all cases in this process; by default one per
    core."""
    batch: int = 1
    """Number of seeds simulated together, if driver, controller and estimator support it: 10
    together are 2 to 3 times faster on a CPU; the same numbers to rounding, but no latencies."""
    timeout: float = DEFAULT_TIMEOUT_S
    """Time limit of a case [s]."""
    retry: tuple[str, ...] = ()
    """Run cases again that ended as `diverged`, `failed`, `crashed` or `timed_out`."""
    output: OutputFolder = None
    """Results folder; a study already in it is continued. By default carosac-results/compare,
    numbered if that holds another study."""
