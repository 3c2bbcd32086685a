"""Exit points from a total station: levelled set-ups, blunders named, covariances kept."""

from calibration.tachymeter.observations import (
    Instrument,
    Reference,
    Shot,
    Sighting,
    Survey,
)
from calibration.tachymeter.result import Blunder, TachymeterResult
from calibration.tachymeter.solve import calibrate

__all__ = [
    "Blunder",
    "Instrument",
    "Reference",
    "Shot",
    "Sighting",
    "Survey",
    "TachymeterResult",
    "calibrate",
]
