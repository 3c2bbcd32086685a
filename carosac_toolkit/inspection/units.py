"""Values of a robot that no robot of its size can have: most likely in another unit.

Nothing is compared with a size of ours: lengths are compared with each other and with what the
winches pay out, weights with what the cables may carry, cables with the materials they are made of.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.numbers import plain
from carosac_toolkit.inspection.home import RobotAtHome
from carosac_toolkit.robot.robot import Robot

FAR_DISTANCE_RATIO = 20.0  # of a distance to the usual one, or to all cable that a winch pays out
OUTSIDE_RATIO = 5.0  # of anchor points to exit points: a platform round its frame is smaller
OVERWEIGHT_RATIO = 5.0  # of the weight to what all cables may carry: not just a weak robot
CABLE_STRAIN_MAX = 0.05  # at rest, of nylon at a tenth of its strength, the most elastic fibre
WATER_DENSITY_KG_PER_M3 = 1000.0
CABLE_DENSITY_RANGE = (0.5, 20.0)  # of water: braided polyethylene with voids, to tungsten
UNITS_M = {"mm": 1e-3, "cm": 1e-2}  # [m] of units that points may be in by mistake
BARE_LENGTH = "A bare number is in metres"


def doubtful_units(report: RobotAtHome) -> list[str]:
    """Return a question about the unit of each value that is physically implausible.

    Args:
        report: The robot and its equilibrium at home.
    """
    return [
        *_far_exits(report.robot),
        *_far_anchors(report.robot),
        *_cable_materials(report.robot),
        *_strains(report),
        *_weight(report.robot),
    ]


def _far_exits(robot: Robot) -> Iterator[str]:
    """Find exit points from which no cable reaches home, by far."""
    size = float(np.linalg.norm(robot.anchor_points, axis=1).max())
    distance = np.linalg.norm(robot.exit_points - robot.home_position, axis=1)
    reach = robot.length_max + size
    far = distance > FAR_DISTANCE_RATIO * np.minimum(float(np.median(distance)), reach)
    if far.all():
        nearest, longest = float(distance.min()), float(robot.length_max.max())
        yield (
            f"all exit points are {plain(nearest, 4)} m or more from home, the longest cable is "
            f"{plain(longest, 4)} m: {_exits_or_home(robot, reach)} {BARE_LENGTH}"
        )
        return
    for i in np.flatnonzero(far):
        others = f"the others about {plain(float(np.median(distance[~far])), 3)} m"
        yield (
            f"the exit point of cable {robot.cable_names[i]} is {plain(distance[i], 4)} m from "
            f"home, {others}: {_single_question(distance[i], distance[~far])} {BARE_LENGTH}"
        )


def _exits_or_home(robot: Robot, reach: Array) -> str:
    """Ask for the unit of all exit points, or of home, whichever would bring them together."""
    for of_exits, question in ((True, "are they in"), (False, "is home in")):
        fitting, between = [], []
        for unit, size in UNITS_M.items():
            exits = robot.exit_points * (size if of_exits else 1.0)
            home = robot.home_position * (1.0 if of_exits else size)
            apart = np.linalg.norm(exits - home, axis=1)
            if (apart <= reach).all() and (apart >= robot.length_min).all():
                fitting.append(unit)
                if ((exits.min(axis=0) <= home) & (home <= exits.max(axis=0)))[:2].all():
                    between.append(unit)
        if fitting:
            return f"{question} {' or '.join(between or fitting)}?"
    return "are their units right?"


def _far_anchors(robot: Robot) -> Iterator[str]:
    """Find anchor points far from the others, or far outside the exit points."""
    distance = np.linalg.norm(robot.anchor_points, axis=1)
    frame = float(np.linalg.norm(robot.exit_points - robot.home_position, axis=1).max())
    usual = float(np.median(distance))
    far = (distance > FAR_DISTANCE_RATIO * usual) & (usual > 0.0)
    far |= distance > OUTSIDE_RATIO * frame
    if far.all():
        fitting = [unit for unit, size in UNITS_M.items() if size * distance.max() <= frame]
        question = f"are they in {' or '.join(fitting)}?" if fitting else "are their units right?"
        yield (
            f"all anchor points are {plain(float(distance.min()), 4)} m or more from the "
            f"platform's origin, no exit point is farther than {plain(frame, 3)} m from home: "
            f"{question} {BARE_LENGTH}"
        )
        return
    for i in np.flatnonzero(far):
        others = f"the others about {plain(float(np.median(distance[~far])), 3)} m"
        yield (
            f"the anchor point of cable {robot.cable_names[i]} is {plain(distance[i], 4)} m from "
            f"the platform's origin, {others}: {_single_question(distance[i], distance[~far])} "
            f"{BARE_LENGTH}"
        )


def _single_question(distance: float, others: Array) -> str:
    """Ask for the unit of a distance that makes it most like the others."""
    usual = float(others.mean())
    if usual == 0.0:
        return "is its unit right?"
    unit = min(UNITS_M, key=lambda name: abs(np.log(UNITS_M[name] * distance / usual)))
    length = UNITS_M[unit] * distance
    within = others.min() / FAR_DISTANCE_RATIO < length < FAR_DISTANCE_RATIO * others.max()
    return f"is it in {unit}?" if within else "is its unit right?"


def _cable_materials(robot: Robot) -> Iterator[str]:
    """Find cables of a density that no material has."""
    density = robot.linear_density / (0.25 * np.pi * robot.cable_diameter**2)  # (n,) [kg/m^3]
    ratio = density / WATER_DENSITY_KG_PER_M3
    low, high = CABLE_DENSITY_RANGE
    for names, (i, *_) in _cables(robot, (ratio < low) | (ratio > high), ratio).items():
        yield (
            f"{names}: diameter {plain(robot.cable_diameter[i] * 1e3, 4)} mm and linear_density "
            f"{plain(robot.linear_density[i] * 1e3, 4)} g/m make {plain(ratio[i], 3)} times the "
            f"density of water; cables have {low:g} to {high:g} times: {_cable_question(ratio[i])}"
        )


def _cable_question(ratio: float) -> str:
    """Ask for the unit that would make a density that of a cable."""
    low, high = CABLE_DENSITY_RANGE
    for factor, question in (
        (1e6, "is diameter in mm? A bare number is in metres"),
        (1e4, "is diameter in cm? A bare number is in metres"),
        (1e-3, "is linear_density in g/m? A bare number is in kg/m"),
    ):
        if low <= factor * ratio <= high:
            return question
    return "are their units right? Bare numbers are in m and kg/m"


def _strains(report: RobotAtHome) -> Iterator[str]:
    """Find cables that would stretch more at home than ropes do."""
    robot, home = report.robot, report.equilibrium
    known = bool(home.converged[0])
    tension = home.tension[0] if known else robot.tension_min
    strain = tension / robot.axial_stiffness
    for names, each in _cables(robot, strain > CABLE_STRAIN_MAX, robot.axial_stiffness).items():
        i = max(each, key=lambda k: float(strain[k]))
        at_most = "up to " if len(each) > 1 else ""
        yield (
            f"{names}: axial_stiffness {plain(robot.axial_stiffness[i], 4)} N stretches by "
            f"{at_most}{plain(1e2 * strain[i], 3)} % under {plain(tension[i], 3)} N"
            f"{' at home' if known else ''}; cables of robots stretch by less than "
            f"{1e2 * CABLE_STRAIN_MAX:g} %, even of nylon: is it in kN? A bare number is in newtons"
        )


def _weight(robot: Robot) -> Iterator[str]:
    """Find a platform far heavier than what all cables together may carry."""
    carried = float(robot.tension_max.sum())
    ratio = robot.weight / carried
    if ratio > OVERWEIGHT_RATIO:
        yield (
            f"the platform of {plain(robot.mass, 4)} kg weighs {plain(ratio, 3)} times what all "
            f"cables may carry together, {plain(carried, 4)} N: is mass in g, or tension_max in "
            "kN? Bare numbers are in kg and N"
        )


def _cables(robot: Robot, bad: NDArray[np.bool_], value: Array) -> Mapping[str, list[int]]:
    """Name bad cables of the same value together, and return those of each group."""
    groups: dict[float, list[int]] = {}
    for i in np.flatnonzero(bad):
        groups.setdefault(float(value[i]), []).append(int(i))
    words = {}
    for each in groups.values():
        names = ", ".join(robot.cable_names[i] for i in each)
        count = "cables" if len(each) > 1 else "cable"
        words["all cables" if len(each) == robot.n else f"{count} {names}"] = each
    return words
