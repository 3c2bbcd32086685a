"""The Warp cable simulator: many worlds, cables of particles or catenaries, winches, sensors."""

__carosac__ = True  # marks this package as ours: the name is not unique
