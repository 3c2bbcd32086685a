"""Guided self-calibration: the robot goes where it learns most, by what it knows by then."""
