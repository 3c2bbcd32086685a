"""How far the model of a robot is off the real one, as told by a recording with poses."""

from __future__ import annotations

from dataclasses import dataclass

from carosac_toolkit.base.numbers import check_fields


@dataclass(frozen=True, kw_only=True)
class ModelError:
    """What a model and the measured poses miss, one standard deviation each; found by `identify`.

    Estimators take it in place of their own guesses, so that what they claim follows from a
    recording.

    Attributes:
        length: Of each cable between encoder and platform, constant [m].
        force: On the platform along each horizontal axis, for a while at a time [N].
        mass: Logarithm of the platform's mass, and of all that stretches the cables like it [1].
        acceleration: Density of accelerations of no duration, along each way to sway
            [m/s^2/sqrt(Hz)].
        position: Of measured poses, per axis [m].
        rotation: Of measured poses, per axis [rad].
    """

    length: float
    force: float
    mass: float
    acceleration: float
    position: float
    rotation: float

    def __post_init__(self) -> None:
        """Refuse what is no standard deviation."""
        check_fields(
            self, positive=("position", "rotation"),
            not_negative=("length", "force", "mass", "acceleration"),
        )  # fmt: skip


MODEL_ERROR_UNITS = {
    "length": "m", "force": "N", "mass": "1", "acceleration": "m/s^2/sqrt(Hz)", "position": "m",
    "rotation": "rad",
}  # fmt: skip
