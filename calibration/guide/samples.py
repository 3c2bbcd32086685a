"""Samples of a guided calibration: one CSV that grows line by line and survives the process.

It is a file of motor angles, as ``carosac calibrate lengths`` reads it. Every sample is on the disk
before the robot moves on; a line that was cut by a crash is dropped. Comments hold what the angles
follow from: the readings at the reference, and the readings and tensions of each sample.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calibration.self_calibration.motor_angle_files import load_motor_angles
from calibration.self_calibration.motor_angles import MotorAngles
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField, InvalidFile
from carosac_toolkit.physics.cable.drum import drums_of
from carosac_toolkit.robot.robot import Robot

HOME_SAMPLE = "home"
CHECK_PREFIX = "check_"
_REFERENCE, _SAMPLE = "# reference ", "# sample "
_ALLOWED = "allowed: a new file, or samples of a guided calibration"
_UNEDITED = "allowed: the comment as it was written; begin a new file"
_FIELDS = (
    "name",
    "cable_names",
    "home_position",
    "home_rotation",
    "drum_radius",
    "drum_buildup",
    "drum_gear",
    "drum_advantage",
)  # of the robot: what motor angles and home mean


@dataclass(frozen=True, kw_only=True, eq=False)
class Rest:
    """Readings of a platform at rest.

    Attributes:
        length: Unstrained lengths by the drums of the robot file [m], shape (n,).
        tension: [N], shape (n,), or None where the driver measures none.
    """

    length: Array
    tension: Array | None


class SampleFile:
    """The samples, in memory and on the disk.

    Attributes:
        path: The CSV.
        names: One per sample.
        motor_angles: Since the reference [rad], N of shape (n,).
        tensions: [N], N of shape (n,); none where the driver measures none.
        reference: Readings where all angles are 0 [m], shape (n,), or None before the first.
    """

    def __init__(self, path: Path, robot: Robot) -> None:
        """Read what is there already.

        Args:
            path: The CSV; it need not exist.
            robot: Robot description, n cables with drums.

        Raises:
            InvalidFile: Not the samples of a guided calibration of this robot.
        """
        self.path, self._robot, self._drums = path, robot, drums_of(robot)
        self.names: list[str] = []
        self.motor_angles: list[Array] = []
        self.tensions: list[Array] = []
        self.reference: Rest | None = None
        if path.exists():
            self._read()

    @classmethod
    @contextlib.contextmanager
    def held(cls, path: Path, robot: Robot) -> Iterator[SampleFile]:
        """Read what is there already, and keep other processes from the file meanwhile.

        Raises:
            InvalidField: It cannot be written, or another process uses it.
            InvalidFile: Not the samples of a guided calibration of this robot.
        """
        with _writable(path):
            file = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0), 0o644)
        try:
            _lock(file, path)
            try:
                yield cls(path, robot)
            finally:
                if not os.fstat(file).st_size:  # not begun
                    path.unlink(missing_ok=True)
        finally:
            os.close(file)

    def start(self, reference: Rest) -> None:
        """Begin a file where all motor angles are 0.

        Raises:
            InvalidField: It cannot be written.
        """
        self.reference = reference
        header = ["sample", *(f"motor_{name}_rad" for name in self._robot.cable_names)]
        if reference.tension is not None:
            header += [f"force_{name}_n" for name in self._robot.cable_names]
        header += [f"known_{axis}_m" for axis in "xyz"]
        note = json.dumps({"robot": _described(self._robot), **_numbers(reference)})
        with _writable(self.path):
            self._append(f"{_REFERENCE}{note}\n{','.join(header)}\n")
            folder = os.open(self.path.absolute().parent, os.O_RDONLY)
            os.fsync(folder)
            os.close(folder)

    def add(self, name: str, rest: Rest) -> None:
        """Append a sample; it is on the disk when this returns.

        Raises:
            InvalidField: It cannot be written.
        """
        row = self.one(name, rest)
        numbers = [*row.motor_angle[0], *([] if row.tension is None else row.tension[0])]
        cells = [name, *(repr(float(x)) for x in numbers)]
        known = [repr(float(x)) for x in self._robot.home_position]
        cells += known if name == HOME_SAMPLE else [""] * 3
        note = json.dumps({"name": name, **_numbers(rest)})
        with _writable(self.path):
            self._append(f"{_SAMPLE}{note}\n{','.join(cells)}\n")
        self.names.append(name)
        self.motor_angles.append(row.motor_angle[0])
        if row.tension is not None:
            self.tensions.append(row.tension[0])

    def one(self, name: str, rest: Rest) -> MotorAngles:
        """Return one sample that is not in the file.

        Raises:
            CarosacError: With tensions where the file has none, or without.
        """
        assert self.reference is not None
        if (rest.tension is None) != (self.reference.tension is None):
            held, given = (
                ("no tensions", "some") if rest.tension is not None else ("tensions", "none")
            )
            raise CarosacError(
                f"{self.path}: its samples hold {held}, and the driver now gives {given}; allowed: "
                "the sensors of its first run, or a new file"
            )
        turned = self._drums.motor_angle(rest.length) - self._drums.motor_angle(
            self.reference.length
        )
        tensions = [] if rest.tension is None else [rest.tension]
        return self._angles([name], [turned], [np.maximum(f, 0.0) for f in tensions])

    def measured(self, *, checks: bool = False) -> MotorAngles:
        """Return the samples of the fit, or those of the checks."""
        rows = [k for k, name in enumerate(self.names) if name.startswith(CHECK_PREFIX) == checks]
        return self._angles(
            [self.names[k] for k in rows],
            [self.motor_angles[k] for k in rows],
            [self.tensions[k] for k in rows] if self.tensions else [],
        )

    def _angles(self, names: list[str], turned: list[Array], tension: list[Array]) -> MotorAngles:
        """Return samples, of which home is known."""
        known = np.array([name == HOME_SAMPLE for name in names], dtype=np.bool_)
        return MotorAngles(
            samples=tuple(names),
            cables=self._robot.cable_names,
            motor_angle=np.array(turned),
            known_position=np.where(known[:, None], self._robot.home_position, 0.0),
            is_known=known,
            tension=np.array(tension) if tension else None,
        )

    def _append(self, text: str) -> None:
        """Write at the end, all at once, and wait for the disk."""
        flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | getattr(os, "O_CLOEXEC", 0)
        file = os.open(self.path, flags, 0o644)
        try:
            left = text.encode()
            while left:
                left = left[os.write(file, left) :]
            os.fsync(file)
        finally:
            os.close(file)

    def _read(self) -> None:
        """Take the samples of an earlier run; drop a line that was cut."""
        try:
            text = self.path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            why = error.strerror if isinstance(error, OSError) else "no text"
            raise InvalidFile(self.path, [f"{why}; {_ALLOWED}"]) from error
        whole = text[: text.rfind("\n") + 1]
        lines = whole.splitlines()
        if len(lines) < 2 and (not text or text.startswith(_REFERENCE)):  # cut before any sample
            os.truncate(self.path, 0)
            return
        if not lines or not lines[0].startswith(_REFERENCE):
            raise InvalidFile(self.path, [f"not the samples of a guided calibration; {_ALLOWED}"])
        note = self._note(lines[0], _REFERENCE)
        self._check_robot(note.get("robot"))
        try:
            self.reference = _rest(note, self._robot.n)
        except (KeyError, TypeError, ValueError) as error:
            raise InvalidFile(self.path, [f"line 1, reference: {error}; {_UNEDITED}"]) from error
        if len(whole) < len(text):
            os.truncate(self.path, len(whole.encode()))
        if any(line and not line.startswith("#") for line in lines[2:]):
            angles = load_motor_angles(self.path).in_order_of(self._robot.cable_names)
            self.names, self.motor_angles = list(angles.samples), list(angles.motor_angle)
            self.tensions = [] if angles.tension is None else list(angles.tension)

    def _check_robot(self, held: object) -> None:
        """Require the robot of the samples, as far as they depend on its file."""
        held = held if isinstance(held, dict) else {"name": held}
        for field, value in _described(self._robot).items():
            if held.get(field) != value:
                fault = f"samples of a robot with {field} {held.get(field)!r}; allowed: {value!r}"
                raise InvalidFile(self.path, [f"{fault}, as in the robot file now, or a new file"])

    def _note(self, line: str, start: str) -> dict[str, Any]:
        """Read the numbers in a comment."""
        try:
            return dict(json.loads(line.removeprefix(start)))
        except ValueError as error:
            raise InvalidFile(self.path, [f"line 1: {line[:60]!r}; {_UNEDITED}"]) from error


def _lock(file: int, path: Path) -> None:
    """Lock a file, until it is closed or the process dies."""
    try:
        import fcntl
    except ImportError:  # a system without such locks
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        allowed = "a file that no other process collects samples in"
        raise InvalidField("SAMPLES", f"'{path}'", allowed) from error


@contextlib.contextmanager
def _writable(path: Path) -> Iterator[None]:
    """Tell where a file cannot be written."""
    try:
        yield
    except OSError as error:
        allowed = f"a file that can be written: {error.strerror}"
        raise InvalidField("SAMPLES", f"'{path}'", allowed) from error


def _numbers(rest: Rest) -> dict[str, Any]:
    """Return the numbers of a rest for a comment."""
    tension = None if rest.tension is None else rest.tension.tolist()
    return {"length_m": rest.length.tolist(), "tension_N": tension}


def _rest(note: dict[str, Any], n: int) -> Rest:
    """Read the numbers of a rest, of n cables."""
    tension = note.get("tension_N")
    numbers = [note["length_m"], *([] if tension is None else [tension])]
    length, *force = (np.array(x, dtype=np.float64).reshape(n) for x in numbers)
    return Rest(length=length, tension=force[0] if force else None)


def _described(robot: Robot) -> dict[str, Any]:
    """Return what samples depend on, ready for JSON."""
    fields = {name: getattr(robot, name) for name in _FIELDS}
    return {
        name: value if isinstance(value, str) else np.asarray(value).tolist()
        for name, value in fields.items()
    }
