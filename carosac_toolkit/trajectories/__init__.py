"""Trajectories of the platform origin: timed paths that start and end at rest.

Every factory takes ``speed_max`` [m/s] and ``acceleration_max`` [m/s^2], bounds of the norms over
the whole trajectory. Without ``duration`` the trajectory is as fast as they allow, so that one of
them is reached; a ``duration`` that would break them is refused.
"""

from carosac_toolkit.trajectories.arcs import circle, spiral
from carosac_toolkit.trajectories.catalogue import TRAJECTORY_NAMES, build
from carosac_toolkit.trajectories.draws import random_minimum_snap, random_spline
from carosac_toolkit.trajectories.moves import line, waypoints
from carosac_toolkit.trajectories.path_file import from_file
from carosac_toolkit.trajectories.recorded import from_recording
from carosac_toolkit.trajectories.snap import minimum_snap
from carosac_toolkit.trajectories.splines import cubic_spline
from carosac_toolkit.trajectories.trajectory import Trajectory, TrajectorySamples

__all__ = [
    "TRAJECTORY_NAMES",
    "Trajectory",
    "TrajectorySamples",
    "build",
    "circle",
    "cubic_spline",
    "from_file",
    "from_recording",
    "line",
    "minimum_snap",
    "random_minimum_snap",
    "random_spline",
    "spiral",
    "waypoints",
]
