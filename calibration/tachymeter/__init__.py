"""Exit points from a total station: levelled set-ups, blunders named, covariances kept."""

from calibration.tachymeter.calibrate import calibrate_tachymeter
from calibration.tachymeter.observations import (
    Instrument,
    ReferencePoint,
    Shot,
    Sighting,
    Survey,
)
from calibration.tachymeter.result import ReadingBlunder, TachymeterResult

__all__ = [
    "Instrument",
    "ReadingBlunder",
    "ReferencePoint",
    "Shot",
    "Sighting",
    "Survey",
    "TachymeterResult",
    "calibrate_tachymeter",
]
