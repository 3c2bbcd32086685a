"""Robots in the formats of CASPR, WireX and cdpyr, written for these tests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from carosac_toolkit.robot.file import load_robot

IPANEMA_LENGTH = 2.6148040079516472  # [m] of all cables at (0, 0, 1), upright
COGIRO_LENGTHS = (9.743148, 9.183277, 9.425611, 9.473757, 9.768421, 9.197350, 9.500900, 9.561887)
UP = np.array([0.0, 0.0, 1.0])

# What none of the formats holds.
REST = """
licence: Apache-2.0
gravity: 9.81 m/s^2
platform: {air_drag: {linear: 0.1, angular: 0.005}}
cable_types:
  cable: {linear_density: 3.7 g/m, axial_stiffness: 120 kN, axial_damping: 60 N*s, diameter: 2.5 mm}
winches:
  winch: {speed_max: 5, acceleration_max: 20, lag: 20 ms, length_min: 0.3, length_max: 30,
          run_length: 1 m}
tension_limits: {min: 10 N, max: 720 N}
workspace: {center: [0, 0, 2], size: [3, 2, 4]}
home: {position: [0, 0, 1], rpy_deg: [0, 0, 0]}
provenance: {platform.air_drag: assumed, cable_types: data sheet}
"""


def geometry(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Exit points and anchor points of a bundled robot."""
    robot = load_robot(name)
    return robot.exit_points.copy(), robot.anchor_points.copy()


def row(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)


def caspr_body(
    *, mass: float = 25.0, centre: Sequence[float] = (0, 0, 0), inertia: Any = None,
    ref: str = "com", joint: str = "", location: Sequence[float] = (0, 0, 0), more: str = "",
) -> str:  # fmt: skip
    matrix = np.diag([14.0, 14.0, 14.0]) if inertia is None else inertia
    entries = "".join(
        f"<I{'xyz'[i]}{'xyz'[j]}>{float(matrix[i, j])!r}</I{'xyz'[i]}{'xyz'[j]}>"
        for i in range(3)
        for j in range(i, 3)
    )
    return f"""<?xml version="1.0" encoding="utf-8"?>
<!DOCTYPE bodies_system SYSTEM "../../../../templates/bodies.dtd">
<bodies_system><links display_range="-5 5 -4 4 0 4" view_angle="-37 32">
  <link_rigid num="1" name="box"><joint type="SPATIAL_EULER_XYZ" {joint}/>
    <physical><mass>{mass!r}</mass><com_location>{row(centre)}</com_location>
      <end_location>0 0 0</end_location><inertia ref="{ref}">{entries}</inertia></physical>
    <parent><num>0</num><location>{row(location)}</location></parent>
  </link_rigid>{more}
</links></bodies_system>"""


def caspr_cable(
    name: str, base: str, anchor: str, *, ref: str = "joint", kind: str = "cable_ideal",
    properties: str = "<force_min>5</force_min><force_max>720</force_max>",
) -> str:  # fmt: skip
    return (
        f'<{kind} name="{name}" attachment_reference="{ref}"><properties>{properties}</properties>'
        f"<attachments>{base}{anchor}</attachments></{kind}>"
    )


def attachment(link: int, location: Any) -> str:
    where = location if isinstance(location, str) else row(location)
    return f"<attachment><link>{link}</link><location>{where}</location></attachment>"


def rotating_pulley(location: Any, radius: float, entry: Any) -> str:
    return (
        f"<base_rotating_pulley><fixed_location>{row(location)}</fixed_location>"
        f"<pulley_radius>{radius!r}</pulley_radius><cable_entry_vector>{row(entry)}"
        "</cable_entry_vector></base_rotating_pulley>"
    )


def caspr_cables(sets: dict[str, list[str]], default: str = "original") -> str:
    inside = "".join(
        f'<cable_set id="{name}">{"".join(cables)}</cable_set>' for name, cables in sets.items()
    )
    return (
        '<?xml version="1.0" encoding="utf-8"?>\n'
        "<!DOCTYPE cables [\n<!ATTLIST cable_set id ID #REQUIRED>\n]>\n"
        f'<cables default_cable_set="{default}">{inside}</cables>'
    )


def straight_cables(exits: Any, anchors: Any, **options: Any) -> list[str]:
    return [
        caspr_cable(f"cable {i + 1}", attachment(0, a), attachment(1, b), **options)
        for i, (a, b) in enumerate(zip(exits, anchors, strict=True))
    ]


def write_caspr(folder: Path, bodies: str, cables: str) -> tuple[Path, Path]:
    paths = folder / "box_bodies.xml", folder / "box_cables.xml"
    for path, text in zip(paths, (bodies, cables), strict=True):
        path.write_text(text, encoding="utf-8")
    return paths


def wirex(
    exits: Any, anchors: Any, *, frames: Any = None, radius: float = 0.0, platform: str = "",
    pattern: str = "3R3T", cable: str = "", winch: str = "", ids: Sequence[str] = (),
) -> str:  # fmt: skip
    chains = ""
    for i, (a, b) in enumerate(zip(exits, anchors, strict=True)):
        frame = np.eye(3) if frames is None else frames[i]
        entries = " ".join(
            f'a{r + 1}{c + 1}="{float(frame[r, c])!r}"' for c in range(3) for r in range(3)
        )
        at, to = (
            " ".join(f'{k}="{float(v)!r}"' for k, v in zip("xyz", p, strict=True)) for p in (a, b)
        )
        name = ids[i] if ids else str(i + 1)
        chains += f'<chain id="{name}" winchtype="Winde"><base {at} {entries} radius="{radius!r}"/>'
        chains += f"<platform {to}/></chain>"
    return (
        f'<models version="0.31"><robot name="IPAnema" motionpattern="{pattern}">'
        f"<geometry>{chains}</geometry>{platform}</robot>{cable}{winch}</models>"
    )


WIREX_PLATFORM = (
    '<platform mass="25.0"><inertiatensor Ixx="14"/>'
    '<centerofgravity x="0.0" y="1.0" z="0.2"/></platform>'
)
WIREX_CABLE = (
    '<cable name="c" elasticity="110000000000.0" radius="0.003" breaking_load="40000.0" '
    'damping="1.0" weight="0.023" minimum_load="0.0"/>'
)
WIREX_WINCH = (
    '<winch name="Winde"><cable f_max="720.0" l_min="0.0" max_velocity="2.0" '
    'max_acceleration="0.0"/></winch>'
)


def cdpyr(exits: Any, anchors: Any, *, pulleys: Any = None) -> dict[str, Any]:
    """What cdpyr's schema dumps; chains use the cables in reverse order, by number."""
    count = len(exits)
    frame: list[dict[str, Any]] = [{"position": [float(x) for x in p]} for p in exits]
    for anchor, found in zip(frame, pulleys or [None] * count, strict=True):
        if found is not None:
            frame_dcm, pulley_dcm, radius = found
            anchor["dcm"] = frame_dcm.tolist()
            anchor["pulley"] = {"radius": radius, "dcm": pulley_dcm.tolist()}
    return {
        "name": "box",
        "frame": {"anchors": frame},
        "platforms": [
            {
                "anchors": [{"position": [float(x) for x in p]} for p in anchors[::-1]],
                "motion_pattern": "3R3T",
                "center_of_gravity": [0.0, 0.0, 0.0],
                "inertia": {
                    "linear": (25.0 * np.eye(3)).tolist(),
                    "angular": [[2.0, 0.1, 0.0], [0.1, 3.0, 0.0], [0.0, 0.0, 4.0]],
                },
            }
        ],
        "cables": [{"name": "cable", "material": "PE", "diameter": 0.0025} for _ in range(count)],
        "kinematic_chains": [
            {"frame_anchor": i, "platform": 0, "platform_anchor": count - 1 - i, "cable": i}
            for i in range(count)
        ],
    }
