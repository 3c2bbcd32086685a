"""Calibration from sensors at poses of rest that nobody measured."""
