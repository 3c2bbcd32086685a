r"""How far the end of a cable gives way per tension: it stretches, and its sag straightens.

For a taut parabola of unstrained length L under tension T,

.. math:: s = \frac{L}{EA} + \frac{(w_\perp L)^2 L}{12\, T^3}

with its weight per length :math:`w_\perp` across the chord. At a tenth of the tension the second
part is a thousand times as large: then sag is what a platform moves on. It holds for motions slower
than the cable's own waves.

References:
    Irvine, *Cable Structures*, MIT Press, 1981, section 2.
"""

from __future__ import annotations

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import Robot


def softness(robot: Robot, direction: Array, unstrained_length: Array, tension: Array) -> Array:
    """Return the change of each chord per change of its tension [m/N], shape (..., n).

    Args:
        robot: Robot description, n cables.
        direction: Unit vectors along the chords in W, shape (..., n, 3).
        unstrained_length: [m], shape (..., n).
        tension: [N], shape (..., n). One of less than half the cable's weight, which would hang
            deeply, counts as that.
    """
    weight = robot.weight_per_length * unstrained_length
    across = weight * np.linalg.norm(direction[..., :2], axis=-1)
    taut = np.maximum(tension, 0.5 * weight)
    stretch = unstrained_length / robot.axial_stiffness
    return np.asarray(stretch + across**2 * unstrained_length / (12.0 * taut**3))
