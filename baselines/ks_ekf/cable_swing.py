r"""Swing of the cables themselves where their tension changes faster than they can follow.

A cable of length l and mass per length :math:`\rho` under a tension f is a string. Its slowest
motion across the chord, with the sag s of its middle, is an oscillator about its sag at rest,

.. math::

    \ddot s = \omega^2 (w l^2 / 8 f - s), \qquad \omega = (\pi / l) \sqrt{f / \rho},

w its weight per length across the chord; damping lets swings fade. A tension that changes slowly
takes the sag along. A cable that was nearly slack hangs by decimetres and is pulled taut within
tenths of a second: it swings, and with the amplitude a about the sag s it takes the length
:math:`8 ((s + a \cos \omega t)^2 - s^2) / 3 l` more than at rest. What is linear in a comes and
goes several times a second; :math:`8 a^2 / 3 l` stays, millimetres for a second or two.

A tension that shakes at twice the pace of the string would pump it without end in this equation. In
a cable it cannot: a swing that takes more length than the cable has to spare raises the tension
itself. So no swing goes farther than the cable has hung lately.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carosac_toolkit.base.arrays import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class CableStrings:
    """Cables of one robot at an instant, as strings.

    Attributes:
        length: Of the chords [m], shape (n,), > 0.
        tension: [N], shape (n,), > 0.
        density: Mass per length [kg/m], shape (n,).
        weight: Per length, across the chord [N/m], shape (n,).
    """

    length: Array
    tension: Array
    density: Array
    weight: Array

    @property
    def pace(self) -> Array:
        """Angular frequency of the slowest motion across the chord [rad/s], shape (n,)."""
        return np.asarray(np.pi / self.length * np.sqrt(self.tension / self.density))

    @property
    def sag(self) -> Array:
        """Of the middle at rest [m], shape (n,)."""
        return np.asarray(self.weight * self.length**2 / (8.0 * self.tension))


@dataclass(frozen=True, kw_only=True, eq=False)
class CableSwing:
    """Sag of the cables of one robot, as it moves.

    Attributes:
        sag: Of their middles [m], shape (n,); None where nothing is known yet.
        speed: Of the sag [m/s], shape (n,).
        loose: How far the cables have hung lately, and may swing [m], shape (n,).
        time: When it was that [s].
    """

    sag: Array | None = None
    speed: Array | float = 0.0
    loose: Array | float = 0.0
    time: float = 0.0

    def later(self, time: float, strings: CableStrings, damping_time: float) -> CableSwing:
        """Return the swing at a time [s] under later tensions; it fades in `damping_time` [s]."""
        rest, pace = strings.sag, strings.pace
        if self.sag is None:
            return CableSwing(sag=rest, speed=np.zeros_like(rest), loose=rest, time=time)
        gone = max(time - self.time, 0.0)
        turned, left = pace * gone, np.exp(-gone / damping_time)
        beyond, drift = self.sag - rest, self.speed / pace
        hung = rest + (self.loose - rest) * np.exp(-turned)  # it takes time to fall
        loose = np.maximum(hung, left * self.loose)
        far = left * np.hypot(beyond, drift)
        left = left * np.minimum(1.0, loose / np.maximum(far, 1e-12))
        sag = rest + left * (beyond * np.cos(turned) + drift * np.sin(turned))
        speed = left * pace * (drift * np.cos(turned) - beyond * np.sin(turned))
        return CableSwing(sag=sag, speed=speed, loose=loose, time=time)

    def taken(self, strings: CableStrings) -> Array:
        """Return the largest length the swing takes, beside its oscillation [m], shape (n,)."""
        if self.sag is None:
            return np.zeros_like(strings.length)
        square = (self.sag - strings.sag) ** 2 + (self.speed / strings.pace) ** 2
        return np.asarray(8.0 / (3.0 * strings.length) * square)
