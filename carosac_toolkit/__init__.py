"""CaRoSaC Toolkit: estimation and control of cable-driven parallel robots whose cables sag.

The names below are the public contract; each is imported when it is first used, so that
``import carosac_toolkit`` stays light.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from carosac_toolkit.base.lazy import lazy_names
from carosac_toolkit.base.version import __version__ as __version__

if TYPE_CHECKING:
    from carosac_toolkit import loop, trajectories, workspace
    from carosac_toolkit.base.errors import CarosacError, InvalidField, InvalidFile
    from carosac_toolkit.loop.values import Belief, Command, Measurement, Pose, Reference, State
    from carosac_toolkit.physics.cable import catenary, straight_line
    from carosac_toolkit.physics.rest import modes, statics, tension_distribution
    from carosac_toolkit.physics.rest.structure import structure_matrix
    from carosac_toolkit.recordings.files import export_tum, load_recording, save_recording
    from carosac_toolkit.recordings.metadata import RecordingMetadata
    from carosac_toolkit.recordings.poses import PoseSamples
    from carosac_toolkit.recordings.recording import Recording
    from carosac_toolkit.robot.bundled_names import list_robots
    from carosac_toolkit.robot.file import load_robot
    from carosac_toolkit.robot.robot import Robot
    from carosac_toolkit.studies.compare.results import StudyResults
    from carosac_toolkit.studies.compare.study import Study
    from carosac_toolkit.validation import validate

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
    "export_tum",
    "list_robots",
    "load_recording",
    "load_robot",
    "loop",
    "modes",
    "save_recording",
    "statics",
    "straight_line",
    "structure_matrix",
    "tension_distribution",
    "trajectories",
    "validate",
    "workspace",
]

_MODULES = {
    "Belief": "loop.values",
    "CarosacError": "base.errors",
    "Command": "loop.values",
    "InvalidField": "base.errors",
    "InvalidFile": "base.errors",
    "Measurement": "loop.values",
    "Pose": "loop.values",
    "PoseSamples": "recordings.poses",
    "Recording": "recordings.recording",
    "RecordingMetadata": "recordings.metadata",
    "Reference": "loop.values",
    "Robot": "robot.robot",
    "State": "loop.values",
    "Study": "studies.compare.study",
    "StudyResults": "studies.compare.results",
    "export_tum": "recordings.files",
    "list_robots": "robot.bundled_names",
    "load_recording": "recordings.files",
    "load_robot": "robot.file",
    "save_recording": "recordings.files",
    "structure_matrix": "physics.rest.structure",
    "validate": "validation",
}
_NAMESPACES = {
    "catenary": "physics.cable.catenary",
    "loop": "loop",
    "modes": "physics.rest.modes",
    "statics": "physics.rest.statics",
    "straight_line": "physics.cable.straight_line",
    "tension_distribution": "physics.rest.tension_distribution",
    "trajectories": "trajectories",
    "workspace": "workspace",
}
__getattr__, __dir__ = lazy_names(__name__, _MODULES, _NAMESPACES)
