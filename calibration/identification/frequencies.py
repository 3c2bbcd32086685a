"""Natural frequencies measured with locked winches, as data of an identification.

A table of them is a CSV file with a header, and one row for each frequency:

=================  =================================================================================
column             holds
=================  =================================================================================
lengths            as the sensors of the recordings read them: ``unstrained_length_01_m`` ...
``frequency_Hz``   measured natural frequency
``sigma_Hz``       one standard deviation of it
``mode``           its place among the frequencies there, 1 for the slowest; or it has a shape
shape              ``shape_x_m`` y z of the platform origin in W, ``shape_roll_rad`` pitch yaw about
                   its axes, of any common size; empty cells were not measured
=================  =================================================================================

Of a shape the frequency is that of the mode which is most alike (modal assurance criterion).
A damped sway is slower than an undamped one by half the square of its damping ratio; that is left
out of account.

References:
    Allemang, The modal assurance criterion: twenty years of use and abuse, *Sound and Vibration*
    37, 2003.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.identification.unknowns import Coordinates
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField, InvalidFile, MissingFile
from carosac_toolkit.base.tables import Rows, counted
from carosac_toolkit.physics.device import lever
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.modes import natural_modes
from carosac_toolkit.recordings.columns import CABLE_COLUMNS
from carosac_toolkit.recordings.csv_file import read_table
from carosac_toolkit.recordings.encoders import unstrained_lengths
from carosac_toolkit.recordings.files import neighbour
from carosac_toolkit.recordings.table import Faults, Table
from carosac_toolkit.robot.robot import Robot

SHAPE_COLUMNS = tuple(f"shape_{axis}_m" for axis in "xyz") + tuple(
    f"shape_{axis}_rad" for axis in ("roll", "pitch", "yaw")
)
RATIO_MAX = 3.0  # of a measured to a modelled frequency at first: more is another mode or unit
DERIVATIVE_STEP = 1e-4  # of coordinates
FAR_SIGMAS = 4.0  # from the identified robot, beyond which a measured frequency is warned of
MODES = 6


@dataclass(frozen=True, kw_only=True, eq=False)
class FrequencyTable:
    """Measured natural frequencies, m of them, of a robot of n cables at rest.

    Attributes:
        reading: Of the lengths, as of the recordings [m], shape (m, n).
        frequency: [Hz], shape (m,).
        sigma: One standard deviation of each [Hz], shape (m,).
        mode: Its place, from 1 for the slowest; 0: that of the shape, shape (m,).
        shape: Twists (linear, angular, in W at the platform origin), of any size; NaN: not
            measured, shape (m, 6).
        rows: Names of the rows, for messages.
    """

    reading: Array
    frequency: Array
    sigma: Array
    mode: NDArray[np.int64]
    shape: Array
    rows: tuple[str, ...]

    def modelled(self, robot: Robot) -> Array:
        """Return the frequencies of a robot [Hz], shape (m,); NaN where it does not hang at rest.

        Those of an unstable pose are negative.
        """
        lengths = unstrained_lengths(robot, self.reading)
        if (lengths <= 0.0).any():
            return np.full(len(lengths), np.nan)
        modes = natural_modes(robot, statics.forward_kinematics(robot, lengths))
        row, place = np.arange(len(lengths)), self.mode - 1
        by_shape = np.flatnonzero(self.mode == 0)
        if len(by_shape):
            alike = _likeness(self.shape[by_shape], modes.shape[by_shape], lever(robot))
            place[by_shape] = alike.argmax(axis=1)
        return np.asarray(modes.frequency[row, place])

    def errors(self, robot: Robot) -> Array:
        """Return how much faster a robot sways than was measured, in sigmas, shape (m,)."""
        return np.asarray((self.modelled(robot) - self.frequency) / self.sigma)

    def check(self, robot: Robot, name: str = "frequencies") -> None:
        """Refuse what cannot be of this robot.

        Args:
            robot: As it is known before.
            name: Of the table, in messages.

        Raises:
            InvalidField: Other cables, lengths on which it does not hang, or other frequencies.
        """
        if self.reading.shape[1] != robot.n:
            got, allowed = f"lengths of {self.reading.shape[1]} cables", f"of {robot.n}"
            raise InvalidField(name, got, f"{allowed}, as robot {robot.name!r} has")
        found = self.modelled(robot)
        lost = [row for row, one in zip(self.rows, found, strict=True) if not np.isfinite(one)]
        if lost:
            got = f"{', '.join(lost[:3])}: lengths on which robot {robot.name!r} does not hang"
            raise InvalidField(name, got, "readings of its length sensors at rest")
        with np.errstate(divide="ignore"):
            far = np.abs(np.log(np.maximum(found, 0.0) / self.frequency)) > np.log(RATIO_MAX)
        for k in np.flatnonzero(far)[:1]:
            got = f"{self.rows[k]}: {self.frequency[k]:.4g} Hz, where it is {found[k]:.4g} Hz"
            allowed = f"natural frequencies of robot {robot.name!r} [Hz], within a factor of 3"
            raise InvalidField(name, got, allowed)


def _likeness(measured: Array, modes: Array, arm: float) -> Array:
    """Return how much each mode is like a shape, from 0 to 1, shape (m, 6).

    Args:
        measured: Shape (m, 6); NaN: not measured.
        modes: In columns, shape (m, 6, 6).
        arm: By which turns compare with displacements [m].
    """
    unit = np.repeat([1.0, arm], 3)
    known = np.isfinite(measured)
    seen = np.where(known, measured, 0.0) * unit
    each = np.where(known[:, :, None], modes, 0.0) * unit[:, None]
    both = np.einsum("mi,mij->mj", seen, each) ** 2
    sizes = (seen**2).sum(axis=1)[:, None] * (each**2).sum(axis=1)
    return np.asarray(both / np.maximum(sizes, np.finfo(np.float64).tiny))


class KnownFrequencies:
    """What measured frequencies tell of coordinates (k,) of a robot."""

    def __init__(self, table: FrequencyTable, unknowns: Coordinates) -> None:
        """Begin without having looked anywhere."""
        self._table = table
        self._unknowns = unknowns
        self._errors: dict[bytes, Array] = {}
        self._slopes: tuple[bytes, Array] = (b"", np.zeros(0))

    def errors(self, coordinates: Array) -> Array:
        """Return errors in sigmas, shape (m,); infinite where there is no such robot at rest."""
        key = coordinates.tobytes()
        if key not in self._errors:
            try:
                found = self._table.errors(self._unknowns.robot_at(coordinates))
            except InvalidField:
                found = np.full(len(self._table.frequency), np.inf)
            self._errors[key] = np.where(np.isfinite(found), found, np.inf)
        return self._errors[key]

    def cost(self, coordinates: Array) -> float:
        """Return the sum of squared errors; infinite where there is no such robot at rest."""
        return float((self.errors(coordinates) ** 2).sum())

    def slopes(self, coordinates: Array) -> Array:
        """Return the derivatives of the errors, shape (m, k)."""
        key = coordinates.tobytes()
        if self._slopes[0] != key:
            here = self.errors(coordinates)
            ends = coordinates + DERIVATIVE_STEP * np.eye(len(coordinates))  # bounds lie below
            change = np.array([self.errors(end) - here for end in ends]) / DERIVATIVE_STEP
            self._slopes = key, change.T
        return self._slopes[1]

    def information(self, coordinates: Array) -> Array:
        """Return the information that they add, shape (k, k)."""
        slopes = self.slopes(coordinates)
        return np.asarray(slopes.T @ slopes)

    def gradient(self, coordinates: Array) -> Array:
        """Return half the derivative of the cost, shape (k,)."""
        return np.asarray(self.slopes(coordinates).T @ self.errors(coordinates))


@dataclass(frozen=True, kw_only=True, eq=False)
class ComparedFrequencies:
    """Measured frequencies beside those of a robot as it was known, and as it was identified.

    Attributes:
        table: As measured, m of them.
        before: Of the robot as it was known [Hz], shape (m,).
        after: Of the identified robot [Hz], shape (m,).
    """

    table: FrequencyTable
    before: Array
    after: Array

    @classmethod
    def of(cls, table: FrequencyTable, before: Robot, after: Robot) -> ComparedFrequencies:
        """Compare with two robots."""
        return cls(table=table, before=table.modelled(before), after=table.modelled(after))

    @property
    def off(self) -> Array:
        """How much faster the identified robot sways, in sigmas, shape (m,)."""
        return np.asarray((self.after - self.table.frequency) / self.table.sigma)

    def sentences(self) -> list[str]:
        """Say how well they fit."""
        measured = self.table.frequency
        shares = [100.0 * np.abs(each / measured - 1.0).max() for each in (self.before, self.after)]
        return [
            f"{counted(len(measured), 'measured frequency', 'measured frequencies')}: off by "
            f"{shares[0]:.2g} % at most before, by {shares[1]:.2g} % after, "
            f"{np.sqrt((self.off**2).mean()):.2g} sigmas RMS"
        ]

    def warnings(self) -> Iterator[str]:
        """Warn of those that do not fit."""
        for k in np.flatnonzero(~(np.abs(self.off) <= FAR_SIGMAS)):
            yield (
                f"frequencies, {self.table.rows[k]}: {self.table.frequency[k]:.4g} Hz was "
                f"measured, {abs(self.off[k]):.1f} sigmas from {self.after[k]:.4g} Hz of the "
                "identified robot; is it of another mode, or of other lengths?"
            )

    def rows(self) -> Rows:
        """Return a table for people, under `HEADER`."""
        return [
            (name, f"{measured:.4g}", f"{sigma:.2g}", f"{old:.4g}", f"{new:.4g}", f"{off:.1f}")
            for name, measured, sigma, old, new, off in zip(
                self.table.rows, self.table.frequency, self.table.sigma, self.before, self.after,
                self.off, strict=True,
            )
        ]  # fmt: skip

    def data(self) -> dict[str, Any]:
        """Return all numbers, ready for JSON."""
        return {
            "measured_Hz": self.table.frequency,
            "sigma_Hz": self.table.sigma,
            "before_Hz": self.before,
            "after_Hz": self.after,
        }


HEADER = ("measured", "[Hz]", "sigma [Hz]", "before [Hz]", "after [Hz]", "off [sigmas]")


def load_frequencies(path: str | Path, robot: Robot) -> FrequencyTable:
    """Read a table of measured frequencies.

    Args:
        path: A CSV file with columns as above.
        robot: Whose cables have a column each.

    Raises:
        MissingFile: There is no such file.
        InvalidFile: With all faults that were found.
    """
    file = Path(path)
    if file.is_dir():
        raise InvalidFile(file, ["this is a folder; allowed: a CSV file"])
    if not file.is_file():
        raise MissingFile(file, neighbour(file))
    table, _ = read_table(file)
    lengths = tuple(CABLE_COLUMNS["unstrained_length"].format(k + 1) for k in range(robot.n))
    needed = (*lengths, "frequency_Hz", "sigma_Hz")
    optional = ("mode", *SHAPE_COLUMNS)
    faults = Faults()
    faults.add(f"column {name!r} is missing" for name in needed if name not in table.names)
    faults.add(
        f"column {name!r}: allowed: {', '.join((*needed, *optional))}"
        for name in table.names
        if name not in (*needed, *optional)
    )
    if not set(optional) & set(table.names):
        faults.add([f"no column says which modes: allowed: 'mode', or {', '.join(SHAPE_COLUMNS)}"])
    faults.check(file)
    if not table.rows:
        raise InvalidFile(file, ["no rows; allowed: one for each measured frequency"])
    columns = {name: _column(table, name) for name in (*needed, *optional)}
    names = tuple(table.row_name(k) for k in range(table.rows))
    for name in needed:
        faults.add(
            f"{names[k]}, column {name!r}: got "
            f"{'nothing' if np.isnan(columns[name][k]) else columns[name][k]}; allowed: > 0, finite"
            for k in np.flatnonzero(~((columns[name] > 0.0) & np.isfinite(columns[name])))
        )
    shape = np.stack([columns[name] for name in SHAPE_COLUMNS], axis=1)
    mode = columns["mode"]
    shaped = (np.nan_to_num(shape, nan=0.0) != 0.0).any(axis=1) & ~np.isinf(shape).any(axis=1)
    for k, (place, has_shape) in enumerate(zip(mode, shaped, strict=True)):
        if not (has_shape if np.isnan(place) else place in range(1, MODES + 1)):
            got = "neither" if np.isnan(place) else f"mode {place:g}"
            faults.add([f"{names[k]}: got {got}; allowed: a mode from 1 to {MODES}, or a shape"])
    faults.check(file)
    return FrequencyTable(
        reading=np.stack([columns[name] for name in lengths], axis=1),
        frequency=columns["frequency_Hz"],
        sigma=columns["sigma_Hz"],
        mode=np.nan_to_num(mode, nan=0.0).astype(np.int64),
        shape=shape,
        rows=names,
    )


def _column(table: Table, name: str) -> Array:
    """Return a column, shape (rows,); NaN where a cell is empty, or there is no such column."""
    column = np.full(table.rows, np.nan)
    if name in table.names:
        values, filled = table.take(name)
        column[filled] = values
    return column
