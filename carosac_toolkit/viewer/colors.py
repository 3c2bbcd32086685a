"""Colours of tensions between the limits of a robot, and their legend."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.robot.robot import Robot

Rgb = tuple[int, int, int]
# Blue over green to orange, in equal steps of lightness; readable with a red-green weakness.
TENSION_COLOR_SCALE = np.array(
    [[43, 63, 140], [35, 113, 165], [38, 153, 150], [112, 184, 98], [219, 190, 60], [237, 130, 36]]
)
SLACK_COLOR: Rgb = (150, 160, 175)
OVERLOAD_COLOR: Rgb = (200, 20, 70)
UNKNOWN_COLOR: Rgb = (120, 120, 120)
CABLE_COLORS: tuple[Rgb, ...] = (
    (31, 111, 139), (209, 98, 43), (123, 79, 163), (76, 140, 43), (184, 51, 106), (138, 109, 31),
    (90, 107, 123), (199, 154, 0),
)  # fmt: skip


def share_of_range(robot: Robot, tension: Array) -> Array:
    """Return tensions on a scale from ``tension_min`` (0) to ``tension_max`` (1), shape (n,).

    The scale is logarithmic where every least tension is above zero, as sagging robots work near
    it; else it is linear.
    """
    low, high = robot.tension_min, robot.tension_max
    if (low > 0.0).all():
        safe = np.maximum(tension, 1e-3 * low)
        return np.asarray(np.log(safe / low) / np.log(high / low))
    return np.asarray((tension - low) / (high - low))


def tension_colors(robot: Robot, tension: Array) -> NDArray[np.uint8]:
    """Return the colour of each cable, shape (n, 3); slack, overload, unknown have their own."""
    share = share_of_range(robot, np.nan_to_num(tension))
    place = np.clip(share, 0.0, 1.0) * (len(TENSION_COLOR_SCALE) - 1)
    colors = np.stack(
        [
            np.interp(place, np.arange(len(TENSION_COLOR_SCALE)), TENSION_COLOR_SCALE[:, k])
            for k in range(3)
        ],
        -1,
    )
    colors[share < -1e-9] = SLACK_COLOR
    colors[share > 1.0 + 1e-9] = OVERLOAD_COLOR
    colors[~np.isfinite(tension)] = UNKNOWN_COLOR
    return np.asarray(colors.round(), dtype=np.uint8)


def vertex_colors(colors: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return colours as three.js expects at vertices: light intensities, not sRGB."""
    share = colors / 255.0
    light = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return np.asarray((255.0 * light).round(), dtype=np.uint8)


def hex_of(color: Rgb) -> str:
    """Return a colour as a hexadecimal web colour."""
    return "#{:02x}{:02x}{:02x}".format(*color)


def legend_html(robot: Robot) -> str:
    """Return the tension scale with its limits, as HTML."""
    low, high = robot.tension_min, robot.tension_max
    stops = ",".join(hex_of((int(r), int(g), int(b))) for r, g, b in TENSION_COLOR_SCALE)
    if np.ptp(low) == 0.0 and np.ptp(high) == 0.0:
        middle = np.sqrt(low[0] * high[0]) if low[0] > 0.0 else 0.5 * (low[0] + high[0])
        marks = [f"{float(f'{x:.3g}'):g} N" for x in (low[0], middle, high[0])]
    else:
        marks = ["least", "of each cable", "most"]
    spans = "".join(f"<span>{mark}</span>" for mark in marks)
    keys = "".join(
        f'<span style="white-space:nowrap;margin-right:0.9em"><span style="display:inline-block;'
        f'width:1.3em;height:0.28em;vertical-align:middle;background:{hex_of(color)}"></span> '
        f"{text}</span>"
        for color, text in (
            (SLACK_COLOR, "slack"),
            (OVERLOAD_COLOR, "overloaded"),
            (UNKNOWN_COLOR, "unknown"),
        )
    )
    scale = "logarithmic" if (low > 0.0).all() else "linear"
    return (
        f'<div style="font-size:0.8em;padding:0.2em 0.8em"><b>Cable tension</b> ({scale})'
        f'<div style="height:0.8em;border-radius:2px;background:linear-gradient(90deg,{stops})">'
        f'</div><div style="display:flex;justify-content:space-between">{spans}</div>{keys}</div>'
    )
