"""Names of the columns, and their order."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from difflib import get_close_matches

CABLE_COLUMNS = {
    "unstrained_length": "unstrained_length_{:02d}_m",
    "length_rate": "length_rate_{:02d}_m_per_s",
    "tension": "tension_{:02d}_N",
    "command": "unstrained_length_command_{:02d}_m",
    "swivel_angle": "swivel_angle_{:02d}_rad",
}
FIXED_COLUMNS = {
    "poses": (
        *(f"position_{axis}_m" for axis in "xyz"),
        *(f"quaternion_{axis}" for axis in "wxyz"),
    ),
    "imu": (
        *(f"imu_angular_rate_{axis}_rad_per_s" for axis in "xyz"),
        *(f"imu_specific_force_{axis}_m_per_s2" for axis in "xyz"),
    ),
    "attitude": tuple(f"attitude_quaternion_{axis}" for axis in "wxyz"),
    "inclination": ("inclination_roll_rad", "inclination_pitch_rad"),
}
QUATERNION_COLUMNS = {"poses": slice(3, 7), "attitude": slice(0, 4)}  # of a channel's columns
TIME_COLUMN = "time_s"
CHANNEL_UNITS = {
    "time": "s",
    "unstrained_length": "m",
    "length_rate": "m/s",
    "tension": "N",
    "command": "m",
    "position": "m",
    "quaternion": "1",
    "imu_angular_rate": "rad/s",
    "imu_specific_force": "m/s^2",
    "swivel_angle": "rad",
    "attitude": "1",
    "inclination": "rad",
}
_NUMBERED_COLUMN = re.compile(
    r"(unstrained_length|cable_length|length_rate|tension|unstrained_length_command|exit_point"
    r"|swivel_angle)_(\d{1,3})_(m|m_per_s|N|rad|x_m|y_m|z_m)"
)
_COLUMN_ALIASES = {"cable_length": "unstrained_length"}
_HINTS_MAX = 20  # names for which a similar one is searched
_NAME_LENGTH_SHOWN = 60  # characters of a name that messages show
POSE_COLUMNS_TEXT = (
    "a recording with measured poses: columns position_x_m, _y_m, _z_m and quaternion_w, _x, _y, _z"
)


def canonical(name: str) -> str:
    """Return the name that the format uses: two digits per cable, ``cable_length`` renamed."""
    match = _NUMBERED_COLUMN.fullmatch(name.strip())
    if match is None:
        return name.strip()
    stem, number, unit = match.groups()
    return f"{_COLUMN_ALIASES.get(stem, stem)}_{int(number):02d}_{unit}"


def cables(names: Iterable[str]) -> int:
    """Return the highest cable number among all columns of cables, 0 without any."""
    matches = (_NUMBERED_COLUMN.fullmatch(name) for name in names)
    return max((int(match.group(2)) for match in matches if match), default=0)


def spelled(name: str, written: Iterable[str]) -> str:
    """Spell a canonical name as the columns of a file do: ``cable_length_4_m`` beside others.

    Args:
        name: Canonical.
        written: Names as in the file.
    """
    for other in written:
        if canonical(other) == name:
            return other.strip()
    match = _NUMBERED_COLUMN.fullmatch(name)
    for other in written if match else ():
        like = _NUMBERED_COLUMN.fullmatch(other.strip())
        if match and like and _kind(match) == _kind(like):
            return f"{like[1]}_{int(match[2]):0{len(like[2])}d}_{match[3]}"
    return name


def channel_columns(channel: str, n: int) -> tuple[str, ...]:
    """Return the columns of a channel of n cables, in order."""
    if channel in FIXED_COLUMNS:
        return FIXED_COLUMNS[channel]
    return tuple(CABLE_COLUMNS[channel].format(i + 1) for i in range(n))


def exit_point_columns(n: int) -> tuple[str, ...]:
    """Return the columns of measured exit points of n cables, x y z per cable."""
    return tuple(f"exit_point_{i + 1:02d}_{axis}_m" for i in range(n) for axis in "xyz")


def known_columns(n: int) -> tuple[str, ...]:
    """Return every column that a recording of n cables may have."""
    channels = (*CABLE_COLUMNS, *FIXED_COLUMNS)
    names = (name for channel in channels for name in channel_columns(channel, n))
    return (TIME_COLUMN, *names, *exit_point_columns(n))


def name_faults(written: Iterable[str]) -> list[str]:
    """Describe every column that is unknown, double or missing, in the spelling of the file."""
    written = list(written)
    names = [canonical(name) for name in written]
    n = max(cables(names), 1)
    known = dict.fromkeys(known_columns(n))
    candidates = (*known, *(f"cable_length_{i + 1}_m" for i in range(n)))
    faults: list[str] = []
    unknown = [name for name in names if name not in known]
    for name, count in Counter(names).items():
        if name not in known:
            searched = candidates if len(faults) < _HINTS_MAX else ()
            close = get_close_matches(name[:_NAME_LENGTH_SHOWN], searched, n=1, cutoff=0.7)
            hint = _hint(close) or " and refused, as every extra column is: remove or rename it"
            faults.append(f"column {_shown(name)} is unknown{hint}")
        elif count > 1:
            faults.append(f"column {name!r} appears {count} times")
    missing = _missing(names, n)
    turned = [name for name in FIXED_COLUMNS["poses"][3:] if name in missing]
    if len(turned) == 4 and not set(unknown) & set(_near(turned, unknown)):
        missing = [name for name in missing if name not in turned]
        faults.append(
            f"columns {turned[0]!r} to {turned[3]!r} are missing: a pose needs its orientation, "
            "because the cable lengths depend on it; positions alone are not read"
        )
    for number, name in enumerate(missing):
        others = unknown[:_HINTS_MAX] if number < _HINTS_MAX else []
        close = get_close_matches(name, others, n=1, cutoff=0.5)
        faults.append(f"column {spelled(name, written)!r} is missing" + _hint(close))
    return faults


def _missing(names: list[str], n: int) -> list[str]:
    """Name the columns that n cables and the channels that are begun need, and are not there."""
    there = set(names)
    groups = [(TIME_COLUMN,), channel_columns("unstrained_length", n)]
    optional = (*(c for c in CABLE_COLUMNS if c != "unstrained_length"), *FIXED_COLUMNS)
    candidates = (*(channel_columns(channel, n) for channel in optional), exit_point_columns(n))
    groups += [group for group in candidates if set(group) & there]
    return [name for group in groups for name in group if name not in there]


def _near(names: list[str], unknown: list[str]) -> list[str]:
    """Return the unknown columns that may be misspelt ones of `names`."""
    return [name for n in names for name in get_close_matches(n, unknown, n=1, cutoff=0.5)]


def _kind(match: re.Match[str]) -> tuple[str, str]:
    """Return the channel of a numbered column under its canonical name."""
    return _COLUMN_ALIASES.get(match[1], match[1]), match[3]


def _shown(name: str) -> str:
    """Quote a name, cut where it is long."""
    return repr(name if len(name) <= _NAME_LENGTH_SHOWN else f"{name[:_NAME_LENGTH_SHOWN]}...")


def _hint(close: list[str]) -> str:
    return f"; did you mean {_shown(close[0])}?" if close else ""
