"""Settings of the smoother."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from baselines.dynamic_estimator.settings import DynamicEstimatorSettings, informed, settings_for
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.numbers import check_fields, check_positive, check_whole
from carosac_toolkit.base.scaled import Scaled, resolved
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot

POSE_TREATMENTS = ("withheld", "half", "used")


def _dynamics() -> DynamicEstimatorSettings:
    """Return the estimator's settings for a smooth path of lengths: less noise, no damping."""
    return DynamicEstimatorSettings(
        stretch_damping=0.0,
        stretch_noise=Scaled(5e-4, "m"),
        rate_noise=Scaled(0.05, "m/s"),
        wind_force=Scaled(1.0, "N"),
    )


@dataclass(frozen=True, kw_only=True)
class SmootherSettings:
    """Settings of `smooth`; defaults with a unit are those of ``carosac`` and scale with the robot.

    Attributes:
        poses: Measured poses: ``withheld``; every second one, the ``half`` of them, the others to
            score with; or all ``used``.
        imu: Whether inertial samples are used.
        angles: Whether swivel angles are used, and the orientation by an AHRS or inclinometer whose
            mounting `dynamics` states.
        lag: An estimate rests on what is measured up to so much later, at least [s]; None: on the
            whole recording.
        iterations: Forward passes at most.
        tolerance: Change of the estimate from pass to pass that counts as none: of positions [m],
            and of rotations by which points at a lever of 1 m on ``carosac`` move as far.
        delay: One sigma of the delay by which lengths lead what else is measured, where neither
            the robot nor `dynamics` says it [s].
        dynamics: What the dynamics take for granted, as for `DynamicEstimator`; `gate` and
            `gap_max` have no effect.
    """

    poses: str = "withheld"
    imu: bool = True
    angles: bool = True
    lag: float | None = None
    iterations: int = 12
    tolerance: float = Scaled(2e-4, "m")
    delay: float = Scaled(0.03, "s")
    dynamics: DynamicEstimatorSettings = field(default_factory=_dynamics)

    def __post_init__(self) -> None:
        """Refuse numbers that make no sense."""
        if self.poses not in POSE_TREATMENTS:
            raise InvalidField("poses", repr(self.poses), f"one of {list(POSE_TREATMENTS)}")
        check_fields(self, positive=("tolerance",), not_negative=("delay",))
        if self.lag is not None:
            check_positive("lag", self.lag, "s")
        check_whole("iterations", self.iterations, 1)


def smoother_settings_for(robot: Robot, settings: SmootherSettings) -> SmootherSettings:
    """Return settings with the defaults of a robot in place of those of ``carosac``."""
    told = replace(
        settings,
        dynamics=informed(robot, settings.dynamics, open_loop=settings.poses == "withheld"),
    )
    here = resolved(told, Scales(robot).ratios)
    return replace(here, dynamics=settings_for(robot, here.dynamics))
