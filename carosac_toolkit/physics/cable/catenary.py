r"""The elastic catenary: tensions at the ends of one cable that hangs between two points.

Irvine's closed form. With the horizontal tension H, vertical tensions :math:`V_l` and
:math:`V_u = V_l + wL`, :math:`T = \sqrt{H^2 + V^2}`,

.. math::
    s = \frac{HL}{EA} + \frac{H}{w}\left(\operatorname{asinh}\frac{V_u}{H}
        - \operatorname{asinh}\frac{V_l}{H}\right), \qquad
    z = \frac{T_u - T_l}{w} + \frac{L}{EA}\left(V_l + \frac{wL}{2}\right)

span and rise are the gradient of a convex function of (H, V), so Newton with a line search finds
the one solution there is, for a taut, a sagging, a vertical and a slack cable alike.

References:
    Irvine, *Cable Structures*, MIT Press, 1981, section 1.4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from carosac_toolkit.base.arrays import Array, as_floats, batch
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics import warp_setup
from carosac_toolkit.physics.cable import hanging_kernels

CATENARY_CLOSURE_MAX = 1e-11  # of the length, above which a cable counts as not converged


@dataclass(frozen=True, kw_only=True, eq=False)
class Catenary:
    """Tensions of B cables.

    Attributes:
        horizontal: Horizontal tension, the same all along the cable [N], shape (B,).
        vertical_lower: Upward component, at the lower end, of the tension the cable exerts on
            that end [N], shape (B,); negative where the cable hangs below that end.
        vertical_upper: Upward force of the support at the upper end [N], shape (B,).
        closure: Distance by which the shape misses the upper end [m], shape (B,).
        converged: Whether there is a solution and it was found, shape (B,); where it is False
            every other field is NaN.
        jacobian: d(horizontal, vertical_lower) / d(span, rise) [N/m], shape (B, 2, 2).
        iterations: Newton steps, shape (B,).
    """

    horizontal: Array
    vertical_lower: Array
    vertical_upper: Array
    closure: Array
    converged: NDArray[np.bool_]
    jacobian: Array
    iterations: NDArray[np.int32]


def solve(
    span: ArrayLike,
    rise: ArrayLike,
    unstrained_length: ArrayLike,
    weight_per_length: ArrayLike,
    axial_stiffness: ArrayLike,
    *,
    device: str = "cpu",
) -> Catenary:
    """Solve B elastic catenaries.

    Args:
        span: Horizontal distance from the lower to the upper end [m], shape (B,), >= 0.
        rise: Vertical distance from the lower to the upper end [m], shape (B,); where it is
            negative the "lower" end is the higher one, and all signs keep their meaning.
        unstrained_length: [m], shape (B,). A length <= 0, or a weightless cable that is not
            stretched, has no solution: ``converged`` is False there.
        weight_per_length: [N/m] of unstrained length, shape (B,) or one number, >= 0.
        axial_stiffness: EA [N], shape (B,) or one number, > 0.
        device: Warp device.

    Returns:
        The tensions, with a status per cable.

    Raises:
        InvalidField: A wrong shape, a number that is not finite or has a sign no cable can have.
    """
    first = batch("span", span, ())
    size = len(first)
    values = {"span": first}
    for name, value in (
        ("rise", rise),
        ("unstrained_length", unstrained_length),
        ("weight_per_length", weight_per_length),
        ("axial_stiffness", axial_stiffness),
    ):
        array = as_floats(name, value)
        array = np.full(size, array) if array.ndim == 0 else array
        values[name] = batch(name, array, ())
        if len(array) != size:
            raise InvalidField(name, f"shape {array.shape}", f"shape ({size},), as span")
    _check_sign("span", values["span"], strict=False)
    _check_sign("weight_per_length", values["weight_per_length"], strict=False)
    _check_sign("axial_stiffness", values["axial_stiffness"], strict=True)
    return _run(values, device)


def _check_sign(name: str, value: Array, *, strict: bool) -> None:
    """Refuse negative (or, if strict, zero) entries."""
    bad = value <= 0.0 if strict else value < 0.0
    if bad.any():
        index = int(np.argmax(bad))
        raise InvalidField(f"{name}[{index}]", value[index], f"{name} {'>' if strict else '>='} 0")


def _run(values: dict[str, Array], device: str) -> Catenary:
    """Launch the kernel on the cables that can have a solution."""
    chord = np.hypot(values["span"], values["rise"])
    length, weight = values["unstrained_length"], values["weight_per_length"]
    possible = (length > 0.0) & ((weight > 0.0) | (chord > length))
    warp_setup.load(hanging_kernels, device)
    solvable = {k: v[possible] for k, v in values.items()}
    size = int(possible.sum())
    inputs = [wp.array(v, dtype=wp.float64, device=device) for v in solvable.values()]
    numbers = [wp.zeros(size, dtype=wp.float64, device=device) for _ in range(3)]
    jacobian = wp.zeros(size, dtype=wp.mat22d, device=device)
    iterations = wp.zeros(size, dtype=int, device=device)
    wp.launch(
        hanging_kernels.solve_catenary,
        size,
        inputs=[*inputs, *numbers, jacobian, iterations],
        device=device,
    )
    horizontal, lower, closure = (a.numpy() for a in numbers)
    scale = solvable["unstrained_length"] + chord[possible]
    good = np.zeros(len(length), dtype=bool)
    good[possible] = (
        np.isfinite(closure)
        & (closure <= CATENARY_CLOSURE_MAX * scale)
        & np.isfinite(horizontal + lower)
    )

    def spread(solved: NDArray[np.float64]) -> Array:
        out = np.full((len(length), *solved.shape[1:]), np.nan)
        out[possible] = solved
        out[~good] = np.nan
        return out

    steps = np.zeros(len(length), dtype=np.int32)
    steps[possible] = iterations.numpy()
    return Catenary(
        horizontal=spread(horizontal),
        vertical_lower=spread(lower),
        vertical_upper=spread(
            lower + solvable["weight_per_length"] * solvable["unstrained_length"]
        ),
        closure=spread(closure),
        converged=good,
        jacobian=spread(jacobian.numpy().reshape(size, 2, 2)),
        iterations=steps,
    )
