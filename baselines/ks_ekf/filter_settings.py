"""Settings of the filter for a robot: those of the user, and what no user sets."""

from __future__ import annotations

from dataclasses import dataclass, fields

from baselines.ks_ekf.settings import KsEkfSettings
from carosac_toolkit.base.scaled import Scaled, resolved
from carosac_toolkit.physics.scales import Scales
from carosac_toolkit.robot.robot import Robot


@dataclass(frozen=True, kw_only=True, eq=False)
class FilterSettings(KsEkfSettings):
    """Settings of `KsEkf` with what it takes for granted beside them; see `filter_settings`.

    Numbers with a unit are those of ``carosac``, and scale with the robot.

    Attributes:
        lag_max: Of the filter behind now, even where no lengths come [s].
        slope_half_width: Over which the angular rate gives its derivative: a few samples [s].
        initial_sway: Root mean square at the first measurement, which is taken at rest [m].
        reject_time: Lengths that misfit longer count as far as the gate allows: the model errs
            [s].
        rest_use_period: Between two uses of a rest, whose samples overlap and say little new [s].
        rest_window: Quiet for so long is at rest: shorter ones see the turning point of a sway [s].
        rest_length_range: Of a length in the window: encoder noise and creep of a held winch [m].
        rest_lever: At which `rest_rate` gives the speed that counts as none [m].
        rest_position_error: Model error of the equilibrium, per axis, where the platform rests [m].
        rest_rotation_error: The same of the orientation [rad].
        rest_speed_error: The same of the velocity with which it moves from rest to rest [m/s].
        rest_spin_error: The same of the angular velocity [rad/s].
        sway_position_error: Of the mean pose beside the sway, in large motion [m].
        sway_rotation_error: The same of the orientation [rad].
        length_step: For derivatives by differences [m].
        lost_position: Deviation per axis where no pose was found [m].
        lost_rotation: The same [rad].
        lost_speed: The same [m/s].
        lost_spin: The same [rad/s].
        moment_lever: At which a force that is left over counts as much as a moment, where tensions
            cannot balance all [m].
        swing_fade_time: In which a cable's own swing fades to 1/e: a second or two in recordings
            [s].
    """

    lag_max: float = Scaled(0.2, "s")
    slope_half_width: float = Scaled(0.0125, "s")
    initial_sway: float = Scaled(0.01, "m")
    reject_time: float = Scaled(0.1, "s")
    rest_use_period: float = Scaled(0.5, "s")
    rest_window: float = Scaled(1.0, "s")
    rest_length_range: float = Scaled(3e-3, "m")
    rest_lever: float = Scaled(1.0, "m")
    rest_position_error: float = Scaled(3e-3, "m")
    rest_rotation_error: float = 5e-3
    rest_speed_error: float = Scaled(3e-3, "m/s")
    rest_spin_error: float = Scaled(5e-3, "rad/s")
    sway_position_error: float = Scaled(0.02, "m")
    sway_rotation_error: float = 0.05
    length_step: float = Scaled(1e-3, "m")
    lost_position: float = Scaled(1.0, "m")
    lost_rotation: float = 0.5
    lost_speed: float = Scaled(1.0, "m/s")
    lost_spin: float = Scaled(0.5, "rad/s")
    moment_lever: float = Scaled(1.0, "m")
    swing_fade_time: float = Scaled(2.0, "s")


def filter_settings(robot: Robot, settings: KsEkfSettings) -> FilterSettings:
    """Return settings with the defaults of a robot in place of those of ``carosac``."""
    asked = {item.name: getattr(settings, item.name) for item in fields(KsEkfSettings)}
    return resolved(FilterSettings(**asked), Scales(robot).ratios)
