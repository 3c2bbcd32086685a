"""Options of ``carosac run``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from carosac_toolkit.cli.common import DefaultRobotOptions
from carosac_toolkit.cli.position_option import Place

DEFAULT_TRAJECTORY = "line"


@dataclass(frozen=True, kw_only=True)
class Options(DefaultRobotOptions):
    """Options of ``carosac run``."""

    driver: str = "simulator"
    """Driver: `simulator`, `ads` (a PLC), or `module:Class`; the guard is put around it."""
    controller: str = "kinematic_solver"
    """Controller by name, or `module:Class`."""
    estimator: str = "kinematic_solver"
    """Estimator by name, or `module:Class`."""
    sensors: str = "lengths"
    """Sensors of the driver, such as `lengths+imu`."""
    trajectory: str = DEFAULT_TRAJECTORY
    """Trajectory of the catalogue."""
    to: Place = None
    """Go straight there from --home [m] instead, from rest to rest (minimum snap): a first path."""
    by_hand: tyro.conf.FlagCreatePairsOff[bool] = False
    """Follow a target moved by keys, or by lines `x y z` [m] of the standard input, instead; a
    target outside the workspace box is refused."""
    enable: tyro.conf.FlagCreatePairsOff[bool] = False
    """Let the winches move; without it the run is dry."""
    home: Place = None
    """Position of the platform at the start [m]; by default the home position of the robot, and
    required where --enable moves a robot behind a PLC. With it a dry run is homed and checked too,
    and nothing is sent."""
    reset: tyro.conf.FlagCreatePairsOff[bool] = False
    """Clear the fault that the PLC holds from an earlier run, once you know why it came, and end;
    with --enable go on: home and move."""
    home_anew: tyro.conf.FlagCreatePairsOff[bool] = False
    """Home also where that changes an offset by more than 0.1 m; only at a pose that was
    measured. Load cells, IMU and pose measurement that contradict it are obeyed."""
    home_confirmed: tyro.conf.FlagCreatePairsOff[bool] = False
    """You have measured --home a second time: needed with --home-anew and --enable where the
    sensors would not notice a wrong home, as encoders alone never do."""
    speed: float = 0.3
    """Largest speed of the platform [m/s]. No winch is asked for more than 1.5 times that: cables
    of a platform that moves at v change their lengths at v at most, and a little more where it
    tilts; driver.guard.speed_max says otherwise."""
    acceleration: float = 0.3
    """Largest acceleration of the platform [m/s^2]."""
    duration: float | None = None
    """Duration of the run by the clock of the driver from its first cycle on [s]; by default
    to the end of the trajectory and a second of rest. The clock of a PLC is that of the wall; that
    of the simulator stays behind it where cycles are late."""
    rate: float = 100.0
    """Commands a second, for a controller whose period can be chosen."""
    priority: tyro.conf.FlagCreatePairsOff[bool] = False
    """Run in real time: before all ordinary processes, with memory locked, the loop on an
    isolated core, and garbage collected at rest only; on Linux, and with the right to it."""
    settings: Annotated[
        tuple[str, ...], tyro.conf.arg(name="set", metavar="SETTING"), tyro.conf.UseAppendAction
    ] = ()
    """Setting of a plug-in: controller.NAME.FIELD=VALUE, estimator.NAME.FIELD=VALUE,
    driver.FIELD=VALUE, or driver.guard.FIELD=VALUE for the guard around a driver that has none of
    its own; may be given several times."""
    output: Annotated[Path | None, tyro.conf.arg(metavar="FILE", aliases=["--recording"])] = None
    """File of the recording, ending in .jsonl; by default a new file in carosac-results/run."""
