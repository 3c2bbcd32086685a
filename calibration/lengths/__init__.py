"""Calibration from cable lengths with measured poses."""
