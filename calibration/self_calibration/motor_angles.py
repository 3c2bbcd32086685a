"""Motor angles of a robot whose platform was put to many places, few or none of them known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array, set_frozen
from carosac_toolkit.base.errors import InvalidField

FLAT_EXTENT_SHARE = 1e-3  # of their extent: known positions that close to a line lie on it


@dataclass(frozen=True, kw_only=True, eq=False)
class MotorAngles:
    """N samples of n motors, taken while the platform rests.

    Attributes:
        samples: One name per sample, N of them.
        cables: Names of the motors, n of them: names of cables, or 01, 02, ... in order.
        motor_angle: Since one common reference, at which all are 0 [rad], positive paying cable
            out, shape (N, n).
        known_position: Platform origin in W where it is known, else 0 [m], shape (N, 3).
        is_known: True if it is known, or some of its coordinates, shape (N,).
        known_sigma: One standard deviation of known positions per axis [m], shape (N, 3); None:
            up to the settings.
        known_axes: True for each coordinate that is known, shape (N, 3); None: all three wherever
            `is_known`.
        tension: With which the motors hold the cables [N], shape (N, n); None: unknown.
    """

    samples: tuple[str, ...]
    cables: tuple[str, ...]
    motor_angle: Array
    known_position: Array
    is_known: NDArray[np.bool_]
    known_sigma: Array | None = None
    known_axes: NDArray[np.bool_] | None = None
    tension: Array | None = None

    def __post_init__(self) -> None:
        """Freeze the arrays; refuse names that come twice and sigmas that are none."""
        for field in ("samples", "cables"):
            names = tuple(getattr(self, field))
            if not names or len(set(names)) != len(names):
                double = sorted({name for name in names if names.count(name) > 1})
                raise InvalidField(field, f"{double or 'nothing'}", "at least one, all different")
            object.__setattr__(self, field, names)
        count = len(self.samples)
        set_frozen(self, {"motor_angle": (count, len(self.cables)), "known_position": (count, 3)})
        self._freeze_flags("is_known", (count,))
        if self.known_axes is not None:
            self._freeze_flags("known_axes", (count, 3))
            wrong = np.flatnonzero(self.known_axes.any(axis=1) != self.is_known)
            if len(wrong):
                allowed = "known exactly where one of the coordinates in known_axes is"
                raise InvalidField("is_known", f"sample {self.samples[wrong[0]]!r}", allowed)
        if self.tension is not None:
            set_frozen(self, {"tension": (count, len(self.cables))})
            if not (self.tension >= 0.0).all():
                raise InvalidField("tension", f"{self.tension.min():g} N", ">= 0 N")
        known = self.coordinates_known
        if self.known_sigma is not None:
            set_frozen(self, {"known_sigma": (count, 3)})
            if not (self.known_sigma[known] > 0.0).all():
                bad = float(self.known_sigma[known].min())
                raise InvalidField("known_sigma", f"{bad:g} m", "> 0 wherever a position is known")

    def _freeze_flags(self, field: str, shape: tuple[int, ...]) -> None:
        """Replace a field of flags by a read-only copy of the right shape."""
        flags = np.array(getattr(self, field), dtype=np.bool_)
        if flags.shape != shape:
            raise InvalidField(field, f"shape {flags.shape}", f"shape {shape}")
        flags.setflags(write=False)
        object.__setattr__(self, field, flags)

    @property
    def coordinates_known(self) -> NDArray[np.bool_]:
        """True for each coordinate that is known, shape (N, 3)."""
        if self.known_axes is None:
            return np.repeat(self.is_known[:, None], 3, axis=1)
        return self.known_axes

    @property
    def spans_plane(self) -> bool:
        """Whether at least three positions are known that are not on one line."""
        complete = self.coordinates_known.all(axis=1)
        known = self.known_position[complete]
        if len(known) < 3:
            return False
        extent = np.linalg.svd(known - known.mean(axis=0), compute_uv=False)
        return bool(extent[1] >= FLAT_EXTENT_SHARE * extent[0])

    def index(self, sample: str) -> int:
        """Return the place of a sample.

        Raises:
            InvalidField: There is none of this name.
        """
        if sample not in self.samples:
            raise InvalidField("sample", repr(sample), f"one of {list(self.samples)}")
        return self.samples.index(sample)

    def without_known(self, samples: Sequence[str]) -> MotorAngles:
        """Return the same angles, with the positions of some samples unknown."""
        rows = [self.index(sample) for sample in samples]
        known, position = self.is_known.copy(), self.known_position.copy()
        axes = self.coordinates_known.copy()
        known[rows], position[rows], axes[rows] = False, 0.0, False
        return replace(self, is_known=known, known_position=position, known_axes=axes)

    def in_order_of(self, cable_names: Sequence[str]) -> MotorAngles:
        """Return the same with one column per cable of a robot, in the robot's order.

        Raises:
            InvalidField: The motors are neither called like the cables nor numbered 1 to n.
        """
        names = list(self.cables)
        if sorted(names) == sorted(cable_names):
            columns = [names.index(name) for name in cable_names]
        elif all(name.isdigit() for name in names) and sorted(map(int, names)) == list(
            range(1, len(cable_names) + 1)
        ):
            columns = [int(k) for k in np.argsort([int(name) for name in names])]
        else:
            allowed = f"the robot's {list(cable_names)}, or 01 to {len(cable_names):02d}"
            raise InvalidField("motors", f"{names}", allowed)
        tension = None if self.tension is None else self.tension[:, columns]
        return replace(
            self,
            cables=tuple(cable_names),
            motor_angle=self.motor_angle[:, columns],
            tension=tension,
        )
