r"""Zero-vibration input shapers: impulses that leave a mode at rest.

A command that is convolved with impulses of amplitude :math:`A_i` at times :math:`t_i`, with
:math:`\sum_i A_i = 1`, leaves of a mode with angular frequency :math:`\omega` and damping ratio
:math:`\zeta` the share

.. math:: V = e^{-\zeta \omega t_m} \left| \sum_i A_i\, e^{\zeta \omega t_i}\,
    e^{j \omega \sqrt{1 - \zeta^2}\, t_i} \right|

of the vibration that the command itself would leave. ZV has two impulses, half a damped period
apart, and V = 0 at the frequency it is made for; ZVD has three, and dV/dw = 0 there too.

References:
    Singer, Seering, "Preshaping Command Inputs to Reduce System Vibration", Journal of Dynamic
    Systems, Measurement, and Control 112, 1990.
    Singhose, "Command Shaping for Flexible Systems: A Review of the First 50 Years", International
    Journal of Precision Engineering and Manufacturing 10, 2009.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField

Shaper = Literal["zv", "zvd"]
SHAPER_NAMES: tuple[str, ...] = get_args(Shaper)
_BINOMIAL_AMPLITUDES = {"zv": (1.0, 1.0), "zvd": (1.0, 2.0, 1.0)}


def impulses(shaper: Shaper, frequency: Array, damping: Array) -> tuple[Array, Array]:
    """Return the impulses of a shaper.

    Args:
        shaper: Which.
        frequency: Undamped natural frequency [Hz], > 0, shape (B,).
        damping: Damping ratio, 0 <= damping < 1, shape (B,).

    Returns:
        Times from the first one on [s], and amplitudes, whose sum is 1: both of shape (B, m), with
        m = 2 for ``zv`` and 3 for ``zvd``.

    Raises:
        InvalidField: A shaper, frequency or damping that makes no sense.
    """
    if shaper not in SHAPER_NAMES:
        raise InvalidField("shaper", repr(shaper), f"one of {list(SHAPER_NAMES)}")
    if not (np.isfinite(frequency) & (frequency > 0.0)).all():
        raise InvalidField("frequency", f"{frequency} Hz", "> 0 Hz, finite")
    if not ((damping >= 0.0) & (damping < 1.0)).all():
        raise InvalidField("damping", f"{damping}", "0 <= damping < 1")
    root = np.sqrt(1.0 - damping**2)
    decay = np.exp(-np.pi * damping / root)  # of the amplitude in half a damped period
    order = np.arange(len(_BINOMIAL_AMPLITUDES[shaper]))
    times = order * (0.5 / (frequency * root))[:, None]
    amplitudes = np.array(_BINOMIAL_AMPLITUDES[shaper]) * decay[:, None] ** order
    return times, amplitudes / amplitudes.sum(axis=1, keepdims=True)


def mean_delay(shaper: tuple[Array, Array]) -> Array:
    """Return the delay of a slow command: sum of amplitude times time [s], shape (B,)."""
    return np.asarray((shaper[0] * shaper[1]).sum(axis=1))


def residual(shaper: tuple[Array, Array], frequency: Array, damping: Array) -> Array:
    """Return the share V of the vibration that a shaper leaves of a mode.

    Args:
        shaper: Times [s] and amplitudes, each of shape (B, m).
        frequency: Undamped natural frequency of the mode [Hz], shape (B,).
        damping: Damping ratio of the mode, shape (B,).

    Returns:
        V, shape (B,); 1 is what an unshaped command leaves.
    """
    times, amplitudes = shaper
    rate = 2.0 * np.pi * frequency[:, None]
    root = np.sqrt(1.0 - damping**2)[:, None]
    phasor = np.exp((damping[:, None] + 1j * root) * rate * (times - times[:, -1:]))
    return np.asarray(np.abs((amplitudes * phasor).sum(axis=1)))
