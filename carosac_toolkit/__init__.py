"""CaRoSaC Toolkit: estimation and control of cable-driven parallel robots whose cables sag.

The names below are the public contract; each is imported when it is first used, so that
``import carosac_toolkit`` stays light.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from carosac_toolkit.base.version import __version__ as __version__

if TYPE_CHECKING:
    from carosac_toolkit import loop, trajectories, workspace
    from carosac_toolkit.base.errors import CarosacError, InvalidField, InvalidFile
    from carosac_toolkit.loop.values import Belief, Command, Measurement, Pose, Reference, State
    from carosac_toolkit.physics.cable import catenary, straight_line
    from carosac_toolkit.physics.rest import modes, statics, tension_distribution
    from carosac_toolkit.physics.rest.structure import structure_matrix
    from carosac_toolkit.recordings.metadata import RecordingMetadata
    from carosac_toolkit.recordings.poses import PoseSamples
    from carosac_toolkit.recordings.recording import Recording, load_recording
    from carosac_toolkit.robot.file import list_robots, load_robot
    from carosac_toolkit.robot.robot import Robot
    from carosac_toolkit.studies.compare.results import StudyResults
    from carosac_toolkit.studies.compare.study import Study
    from carosac_toolkit.validation import validate

_MODULE_OF_NAME = {
    "Belief": "loop.values",
    "CarosacError": "base.errors",
    "Command": "loop.values",
    "InvalidField": "base.errors",
    "InvalidFile": "base.errors",
    "Measurement": "loop.values",
    "Pose": "loop.values",
    "PoseSamples": "recordings.poses",
    "Recording": "recording",
    "RecordingMetadata": "recordings.metadata",
    "Reference": "values",
    "Robot": "robot",
    "State": "values",
    "Study": "studies.study",
    "StudyResults": "studies.results",
    "list_robots": "robot_file",
    "load_recording": "recording",
    "load_robot": "robot_file",
    "structure_matrix": "physics.structure",
    "validate": "validation",
}
_MODULE_OF_NAMESPACE = {
    "catenary": "physics.catenary",
    "loop": "loop",
    "modes": "physics.modes",
    "statics": "physics.statics",
    "straight_line": "physics.straight_line",
    "tension_distribution": "physics.tension_distribution",
    "trajectories": "trajectories",
    "workspace": "workspace",
}

__all__ = [
    "Belief",
    "CarosacError",
    "Command",
    "InvalidField",
    "InvalidFile",
    "Measurement",
    "Pose",
    "PoseSamples",
    "Recording",
    "RecordingMetadata",
    "Reference",
    "Robot",
    "State",
    "Study",
    "StudyResults",
    "catenary",
    "list_robots",
    "load_recording",
    "load_robot",
    "loop",
    "modes",
    "statics",
    "straight_line",
    "structure_matrix",
    "tension_distribution",
    "trajectories",
    "validate",
    "workspace",
]


def __getattr__(name: str) -> Any:
    """Import a public name at its first use."""
    if name in _MODULE_OF_NAMESPACE:
        return import_module(f"{__name__}.{_MODULE_OF_NAMESPACE[name]}")
    if name in _MODULE_OF_NAME:
        return getattr(import_module(f"{__name__}.{_MODULE_OF_NAME[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
