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

Of a shape the frequency is that of the mode of the robot as known before which is most alike
(modal assurance criterion, over all that the mode moves: one that mostly does something else than
what was measured is not alike). It is chosen once, and counts by its place among the frequencies.
A damped sway is slower than an undamped one by half the square of its damping ratio; that is left
out of account.

References:
    Allemang, The modal assurance criterion: twenty years of use and abuse, *Sound and Vibration*
    37, 2003.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.identification.quadratic import Quadratic
from calibration.identification.unknowns import Coordinates
from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import CarosacError, InvalidField, InvalidFile, MissingFile
from carosac_toolkit.base.tables import Rows, counted
from carosac_toolkit.physics.device import lever
from carosac_toolkit.physics.rest import statics
from carosac_toolkit.physics.rest.modes import Modes, natural_modes
from carosac_toolkit.recordings.columns import CABLE_COLUMNS
from carosac_toolkit.recordings.csv_file import read_table
from carosac_toolkit.recordings.encoders import unstrained_lengths
from carosac_toolkit.recordings.files import neighbour
from carosac_toolkit.recordings.table import Faults, Table
from carosac_toolkit.robot.robot import Robot

SHAPE_COLUMNS = tuple(f"shape_{axis}_m" for axis in "xyz") + tuple(
    f"shape_{axis}_rad" for axis in ("roll", "pitch", "yaw")
)
AMBIGUOUS_RATIO = 0.7  # of the likeness of the second mode to that of the first
AMBIGUOUS_SIGMAS = 3.0  # of a frequency, by which modes that are alike have to differ to matter
RATIO_MAX = 3.0  # of a measured to a modelled frequency at first: more is another mode or unit
DERIVATIVE_STEP = 1e-4  # of coordinates
FAR_SIGMAS = 4.0  # from the identified robot, beyond which a measured frequency is warned of
MODES = 6
MODE_ALLOWED = f"a mode from 1 to {MODES}, or a shape"


@dataclass(frozen=True, kw_only=True, eq=False)
class FrequencyTable:
    """Measured natural frequencies, m of them, of a robot of n cables at rest.

    Attributes:
        reading: Of the lengths, as of the recordings [m], > 0, shape (m, n).
        frequency: [Hz], > 0, shape (m,).
        sigma: One standard deviation of each [Hz], > 0, shape (m,).
        mode: Its place, from 1 for the slowest to 6; 0: that of the shape, shape (m,). With a shape
            as well, both have to agree.
        shape: Twists (linear, angular, in W at the platform origin), of any size; NaN: not
            measured, shape (m, 6).
        rows: Names of the rows, for messages.

    Raises:
        InvalidField: Other sizes or values.
    """

    reading: Array
    frequency: Array
    sigma: Array
    mode: NDArray[np.int64]
    shape: Array
    rows: tuple[str, ...]

    def __post_init__(self) -> None:
        """Refuse what is no table of frequencies."""
        count = len(self.rows)
        if not count:
            raise InvalidField("rows", "none", "one for each measured frequency")
        if not np.issubdtype(np.asarray(self.mode).dtype, np.integer):
            raise InvalidField("mode", f"type {np.asarray(self.mode).dtype}", "integers")
        for name, size in (("frequency", ()), ("sigma", ()), ("mode", ()), ("shape", (MODES,))):
            got = np.shape(getattr(self, name))
            if got != (count, *size):
                raise InvalidField(name, f"shape {got}", f"shape {(count, *size)}, as rows has")
        if np.ndim(self.reading) != 2 or len(self.reading) != count:
            got, allowed = f"shape {np.shape(self.reading)}", f"shape ({count}, n), as rows has"
            raise InvalidField("reading", got, allowed)
        for name in ("reading", "frequency", "sigma"):
            values = np.asarray(getattr(self, name)).reshape(count, -1)
            for k in np.flatnonzero(~((values > 0.0) & np.isfinite(values)).all(axis=1))[:1]:
                raise InvalidField(f"{name}, {self.rows[k]}", values[k], "> 0, finite")
        for k, (place, shape) in enumerate(zip(self.mode, self.shape, strict=True)):
            if not _says_which(float(place) or np.nan, shape):
                raise InvalidField(f"mode, {self.rows[k]}", place, MODE_ALLOWED)

    def modelled(self, robot: Robot) -> Array:
        """Return the frequencies of a robot [Hz], shape (m,); NaN where it does not hang at rest.

        Those of an unstable pose are negative.

        Raises:
            InvalidField: A shape without a mode, which `matched` finds.
        """
        for k in np.flatnonzero(self.mode == 0)[:1]:
            allowed = f"1 to {MODES}; 'matched' finds the modes of shapes"
            raise InvalidField(f"mode, {self.rows[k]}", 0, allowed)
        frequency = self._modes(robot).frequency
        return np.asarray(frequency[np.arange(len(self.mode)), self.mode - 1])

    def _modes(self, robot: Robot) -> Modes:
        """Return all modes of a robot at m places; NaN where it does not hang at rest."""
        lengths = unstrained_lengths(robot, self.reading)
        there = np.asarray((lengths > 0.0).all(axis=1))
        frequency, shape = np.full((len(there), MODES), np.nan), np.full((len(there), 6, 6), np.nan)
        if there.any():
            found = natural_modes(robot, statics.forward_kinematics(robot, lengths[there]))
            frequency[there], shape[there] = found.frequency, found.shape
        return Modes(frequency=frequency, shape=shape)

    def errors(self, robot: Robot) -> Array:
        """Return how much faster a robot sways than was measured, in sigmas, shape (m,)."""
        return np.asarray((self.modelled(robot) - self.frequency) / self.sigma)

    def matched(self, robot: Robot, name: str = "frequencies") -> FrequencyTable:
        """Return the table with a mode for each shape: that of a robot which is most alike.

        Args:
            robot: As it is known before.
            name: Of the table, in messages.

        Raises:
            InvalidField: What cannot be of this robot: other cables, lengths on which it does not
                hang, other frequencies, or a shape that may be of several modes.
        """
        if self.reading.shape[1] != robot.n:
            got, allowed = f"lengths of {self.reading.shape[1]} cables", f"of {robot.n}"
            raise InvalidField(name, got, f"{allowed}, as robot {robot.name!r} has")
        modes = self._modes(robot)
        hangs = np.asarray(np.isfinite(modes.frequency).all(axis=1))
        lost = [self.rows[k] for k in np.flatnonzero(~hangs)]
        if lost:
            got = f"{', '.join(lost[:3])}: lengths on which robot {robot.name!r} does not hang"
            raise InvalidField(name, got, "readings of its length sensors at rest")
        with np.errstate(divide="ignore"):
            ratio = np.log(np.maximum(modes.frequency, 0.0) / self.frequency[:, None])
        near = np.abs(ratio) <= np.log(RATIO_MAX)
        alike = self._likeness(modes.shape, lever(robot))
        likely = np.where(near | ~near.any(axis=1, keepdims=True), alike, 0.0)
        matched = replace(self, mode=np.where(self.mode == 0, likely.argmax(axis=1) + 1, self.mode))
        rival = matched._more_alike(alike, modes.frequency)
        # A rival of a shape alone is of no near mode, and tells which frequency was to be expected.
        place = np.where((rival > 0) & (self.mode == 0), rival, matched.mode)
        row = np.arange(len(place))
        found = modes.frequency[row, place - 1]
        for k in np.flatnonzero(~near[row, place - 1])[:1]:
            got = f"{self.rows[k]}: {self.frequency[k]:.4g} Hz, where it is {found[k]:.4g} Hz"
            allowed = f"natural frequencies of robot {robot.name!r} [Hz], within a factor of 3"
            raise InvalidField(name, got, allowed)
        for k in np.flatnonzero(self.mode == 0):
            matched._check_likeness(int(k), likely[k], modes.frequency[k], name)
        for k in np.flatnonzero(rival)[:1]:
            got = f"{self.rows[k]}: mode {self.mode[k]} with a shape most like mode {rival[k]}"
            raise InvalidField(name, got, "a mode and its own shape, or one of both")
        return matched

    def _check_likeness(self, k: int, alike: Array, frequency: Array, name: str) -> None:
        """Refuse a shape that is about as much like another mode (6,) of another frequency."""
        first = self.mode[k] - 1
        others = np.where(self._apart(k, frequency), alike, 0.0)
        second = int(others.argmax())
        if others[second] > AMBIGUOUS_RATIO * alike[first]:
            got = (
                f"{self.rows[k]}: a shape as much like mode {first + 1}, {frequency[first]:.4g} "
                f"Hz, as mode {second + 1}, {frequency[second]:.4g} Hz"
            )
            raise InvalidField(name, got, "more of the shape, or the mode by its number")

    def _apart(self, k: int, frequency: Array) -> NDArray[np.bool_]:
        """Say which modes (6,) are of another frequency than the one taken, as far as it counts."""
        away = np.abs(frequency - frequency[self.mode[k] - 1])
        return np.asarray(away > AMBIGUOUS_SIGMAS * self.sigma[k])

    def _more_alike(self, alike: Array, frequency: Array) -> NDArray[np.int64]:
        """Return modes that are clearly more like a shape than the one taken, (m,); 0: none.

        Args:
            alike: Each mode, from 0 to 1, shape (m, 6).
            frequency: Of each [Hz], shape (m, 6).
        """
        found = np.zeros(len(self.mode), dtype=np.int64)
        for k, (likeness, taken) in enumerate(zip(alike, self.mode - 1, strict=True)):
            others = np.where(self._apart(k, frequency[k]), likeness, 0.0)
            if likeness[taken] < AMBIGUOUS_RATIO * others.max():
                found[k] = others.argmax() + 1
        return found

    def _likeness(self, modes: Array, arm: float) -> Array:
        """Return how much each mode is like the shape of a row, from 0 to 1, shape (m, 6).

        Args:
            modes: In columns, shape (m, 6, 6).
            arm: By which turns compare with displacements [m].
        """
        unit = np.repeat([1.0, arm], 3)
        seen = np.nan_to_num(self.shape, nan=0.0) * unit
        each = modes * unit[:, None]
        both = np.einsum("mi,mij->mj", seen, each) ** 2
        sizes = (seen**2).sum(axis=1)[:, None] * (each**2).sum(axis=1)
        return np.asarray(both / np.maximum(sizes, np.finfo(np.float64).tiny))

    def changed(self, robot: Robot) -> list[int]:
        """Return the rows whose shape is clearly more like another mode of a robot."""
        modes = self._modes(robot)
        alike = self._likeness(modes.shape, lever(robot))
        return [int(k) for k in np.flatnonzero(self._more_alike(alike, modes.frequency))]


def _says_which(place: float, shape: Array) -> bool:
    """Say whether a mode, or, without one (NaN), a shape (6,) says which frequency it is."""
    if np.isinf(shape).any():
        return False
    if np.isnan(place):
        return bool(np.nan_to_num(shape, nan=0.0).any())
    return place in range(1, MODES + 1)


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownFrequencies:
    """What measured frequencies tell of coordinates (k,) of a robot.

    Attributes:
        table: As measured, each of a mode.
        unknowns: Of which robot.
    """

    table: FrequencyTable
    unknowns: Coordinates

    def errors(self, coordinates: Array) -> Array:
        """Return errors in sigmas, shape (m,); infinite where there is no such robot at rest."""
        try:
            robot = self.unknowns.robot_at(coordinates)
        except InvalidField:
            return np.full(len(self.table.frequency), np.inf)
        found = self.table.errors(robot)
        return np.where(np.isfinite(found), found, np.inf)

    def cost(self, coordinates: Array) -> float:
        """Return the sum of squared errors; infinite where there is no such robot at rest."""
        return float((self.errors(coordinates) ** 2).sum())

    def about(self, coordinates: Array) -> Quadratic:
        """Return the cost about coordinates, of errors that change linearly.

        Raises:
            CarosacError: The robot does not hang at rest there, or beside it.
        """
        points = coordinates + DERIVATIVE_STEP * np.eye(len(coordinates))  # bounds lie below
        here, *ends = (self.errors(point) for point in (coordinates, *points))
        lost = np.flatnonzero(~np.isfinite([here, *ends]).all(axis=0))
        if len(lost):
            raise CarosacError(
                "identification: the robot that is searched no longer hangs on the lengths of "
                f"frequencies, {self.table.rows[lost[0]]}"
            )
        slopes = (np.array(ends) - here).T / DERIVATIVE_STEP
        return Quadratic(
            cost=float(here @ here), gradient=slopes.T @ here, information=slopes.T @ slopes
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class ComparedFrequencies:
    """Measured frequencies beside those of a robot as it was known, and as it was identified.

    Attributes:
        table: As measured, m of them.
        before: Of the robot as it was known [Hz], shape (m,).
        after: Of the identified robot [Hz], shape (m,).
        changed: Rows with a shape that is most like another mode of the identified robot.
    """

    table: FrequencyTable
    before: Array
    after: Array
    changed: tuple[int, ...] = ()

    @classmethod
    def of(cls, table: FrequencyTable, before: Robot, after: Robot) -> ComparedFrequencies:
        """Compare with two robots a table whose shapes were matched."""
        return cls(
            table=table, before=table.modelled(before), after=table.modelled(after),
            changed=tuple(table.changed(after)),
        )  # fmt: skip

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
        for row in self.changed:
            yield (
                f"frequencies, {self.table.rows[row]}: of the identified robot its shape is most "
                f"like another mode than {self.table.mode[row]}, which was fitted; identify again, "
                "from the identified robot"
            )

    def rows(self) -> Rows:
        """Return a table for people, under `FREQUENCY_HEADER`."""
        return [
            (
                name, str(mode), f"{measured:.4g}", f"{sigma:.2g}", f"{old:.4g}", f"{new:.4g}",
                f"{off:.1f}",
            )
            for name, mode, measured, sigma, old, new, off in zip(
                self.table.rows, self.table.mode, self.table.frequency, self.table.sigma,
                self.before, self.after, self.off, strict=True,
            )
        ]  # fmt: skip

    def data(self) -> dict[str, Any]:
        """Return all numbers, ready for JSON."""
        return {
            "mode": self.table.mode,
            "measured_Hz": self.table.frequency,
            "sigma_Hz": self.table.sigma,
            "before_Hz": self.before,
            "after_Hz": self.after,
        }


FREQUENCY_HEADER = (
    "row", "mode", "measured [Hz]", "sigma [Hz]", "before [Hz]", "after [Hz]", "off [sigmas]",
)  # fmt: skip


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
    for k, place in enumerate(mode):
        if not _says_which(float(place), shape[k]):
            got = "neither" if np.isnan(place) else f"mode {place:g}"
            got = "an infinite shape" if np.isinf(shape[k]).any() else got
            faults.add([f"{names[k]}: got {got}; allowed: {MODE_ALLOWED}"])
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
