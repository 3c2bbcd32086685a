"""Names of the columns, and their order."""

from __future__ import annotations

import re
from collections.abc import Iterable
from difflib import get_close_matches

PER_CABLE = {
    "unstrained_length": "unstrained_length_{:02d}_m",
    "length_rate": "length_rate_{:02d}_m_per_s",
    "tension": "tension_{:02d}_N",
    "command": "unstrained_length_command_{:02d}_m",
}
FIXED = {
    "poses": (
        *(f"position_{axis}_m" for axis in "xyz"),
        *(f"quaternion_{axis}" for axis in "wxyz"),
    ),
    "imu": (
        *(f"imu_angular_rate_{axis}_rad_per_s" for axis in "xyz"),
        *(f"imu_specific_force_{axis}_m_per_s2" for axis in "xyz"),
    ),
}
TIME = "time_s"
UNITS = {
    "time": "s",
    "unstrained_length": "m",
    "length_rate": "m/s",
    "tension": "N",
    "command": "m",
    "position": "m",
    "quaternion": "1",
    "imu_angular_rate": "rad/s",
    "imu_specific_force": "m/s^2",
}
_NUMBERED = re.compile(
    r"(unstrained_length|cable_length|length_rate|tension|unstrained_length_command|exit_point)"
    r"_(\d{1,3})_(m|m_per_s|N|x_m|y_m|z_m)"
)
_ALIASES = {"cable_length": "unstrained_length"}


def canonical(name: str) -> str:
    """Return the name that the format uses: two digits per cable, ``cable_length`` renamed."""
    match = _NUMBERED.fullmatch(name.strip())
    if match is None:
        return name.strip()
    stem, number, unit = match.groups()
    return f"{_ALIASES.get(stem, stem)}_{int(number):02d}_{unit}"


def cables(names: Iterable[str]) -> int:
    """Return the highest cable number among the length columns, 0 without any."""
    matches = (re.fullmatch(r"unstrained_length_(\d{2,3})_m", name) for name in names)
    return max((int(match.group(1)) for match in matches if match), default=0)


def channel_columns(channel: str, n: int) -> tuple[str, ...]:
    """Return the columns of a channel of n cables, in order."""
    if channel in FIXED:
        return FIXED[channel]
    return tuple(PER_CABLE[channel].format(i + 1) for i in range(n))


def exit_point_columns(n: int) -> tuple[str, ...]:
    """Return the columns of measured exit points of n cables, x y z per cable."""
    return tuple(f"exit_point_{i + 1:02d}_{axis}_m" for i in range(n) for axis in "xyz")


def known_columns(n: int) -> tuple[str, ...]:
    """Return every column that a recording of n cables may have."""
    channels = (*PER_CABLE, *FIXED)
    names = (name for channel in channels for name in channel_columns(channel, n))
    return (TIME, *names, *exit_point_columns(n))


def name_faults(names: list[str]) -> list[str]:
    """Describe every column that is unknown, double or missing; `names` are canonical."""
    n = max(cables(names), 1)
    known = known_columns(n)
    faults = []
    for name in dict.fromkeys(names):
        if name not in known:
            close = get_close_matches(name, known, n=1, cutoff=0.5)
            faults.append(f"column {name!r} is unknown" + _hint(close))
        elif names.count(name) > 1:
            faults.append(f"column {name!r} is there {names.count(name)} times")
    unknown = [name for name in names if name not in known]
    groups = [(TIME,), channel_columns("unstrained_length", n)]
    optional = (*(c for c in PER_CABLE if c != "unstrained_length"), *FIXED)
    candidates = (*(channel_columns(channel, n) for channel in optional), exit_point_columns(n))
    groups += [group for group in candidates if set(group) & set(names)]
    for name in (name for group in groups for name in group if name not in names):
        close = get_close_matches(name, unknown, n=1, cutoff=0.5)
        faults.append(f"column {name!r} is missing" + _hint(close))
    return faults


def _hint(close: list[str]) -> str:
    return f"; did you mean {close[0]!r}?" if close else ""
