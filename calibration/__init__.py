"""Calibration and identification: tachymeter, self-calibration from lengths, dynamics."""

__carosac__ = True  # marks this package as ours: the name is not unique
