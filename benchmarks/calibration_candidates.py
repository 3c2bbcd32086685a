"""Candidates of an identification: kept where a robot has them, left where it has not.

Run it from the project's root: ``python -m benchmarks.calibration_candidates [--seeds N]``. It
takes some minutes a robot.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from time import process_time

import numpy as np

from benchmarks.calibration_oscillations import SURVEYED, draw_plant, robot_with_pulleys
from benchmarks.results import table, write_section
from calibration import identify_runs
from calibration.identification.settings import CANDIDATE_SIGMAS
from calibration.identification.synthetic_oscillations import (
    OscillationSettings,
    simulate_oscillations,
)
from carosac_toolkit.physics.motion.cable_drag import cable_drag_of
from carosac_toolkit.robot.parameters import values_of
from carosac_toolkit.robot.robot import Robot

TITLE = "Candidates of an identification"
CABLES = 4
RECORDINGS = 20
AXES = np.array([2.0, 0.5, 1.0])  # factors of the angular drag
CABLE_FACTOR = 4.0  # of the usual drag of cables
CAPSTAN = 0.15  # coefficient of friction of cables on their pulleys
PRODUCT_SHARES = {(0, 1): 0.25, (0, 2): -0.2, (1, 2): 0.15}  # of the spreads of mass


@dataclass(frozen=True, kw_only=True)
class Tried:
    """A robot that was identified with all candidates.

    Attributes:
        has: Those that it has.
        kept: Those that were kept.
        words: What cross-validation said.
        worst: Largest error of a parameter of a candidate that was kept, in its sigmas.
        seconds: Time of processors [s].
    """

    has: frozenset[str]
    kept: frozenset[str]
    words: str
    worst: float
    seconds: float


def with_effects(plant: Robot, names: frozenset[str]) -> Robot:
    """Return a robot that has the effects of some candidates."""
    if "angular_drag_axes" in names:
        plant = replace(plant, angular_drag_axes=AXES)
    if "cable_drag" in names:
        plant = replace(plant, cable_drag=CABLE_FACTOR * cable_drag_of(plant))
    if "capstan_friction" in names:
        plant = replace(plant, capstan_friction=np.full(plant.n, CAPSTAN))
    if "inertia_products" in names:
        moments = 0.5 * np.trace(plant.inertia) - np.diag(plant.inertia)
        inertia = plant.inertia.copy()
        for (row, column), share in PRODUCT_SHARES.items():
            inertia[row, column] += share * np.sqrt(moments[row] * moments[column])
            inertia[column, row] = inertia[row, column]
        plant = replace(plant, inertia=inertia)
    return plant


def tried(seed: int, has: frozenset[str]) -> Tried:
    """Identify a drawn robot that has some of the effects, with all of them as candidates."""
    robot = robot_with_pulleys(CABLES)
    plant = with_effects(draw_plant(robot, SURVEYED, seed), has)
    runs = simulate_oscillations(plant, seed, OscillationSettings(count=RECORDINGS))
    used = process_time()
    found = identify_runs(runs, robot, SURVEYED, candidates=tuple(CANDIDATE_SIGMAS))
    used = process_time() - used
    kept = frozenset(one.name for one in found.candidates if one.kept)
    estimate = found.estimate
    true = values_of(replace(plant, cable_drag=cable_drag_of(plant)), estimate.names)
    shares = np.abs(estimate.value - true) / estimate.sigma
    fields = (
        "angular_drag_axes", "cable_drag", "capstan_friction", "inertia.xy", "inertia.xz",
        "inertia.yz",
    )  # fmt: skip
    worst = [
        share
        for name, share in zip(estimate.names, shares, strict=True)
        if name.startswith(fields)
    ]  # fmt: skip
    return Tried(
        has=has, kept=kept, words="; ".join(one.words for one in found.candidates),
        worst=max(worst, default=0.0), seconds=used,
    )  # fmt: skip


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=2)
    seeds = parser.parse_args().seeds
    rows = []
    for has in (frozenset(CANDIDATE_SIGMAS), frozenset[str]()):
        for seed in range(seeds):
            one = tried(seed, has)
            print(one, flush=True)
            rows.append([
                str(seed), "all" if has else "none", one.words, f"{one.worst:.1f}",
                f"{one.seconds:.0f}",
            ])  # fmt: skip
    header = (
        "seed", "the robot has", "squared errors of what is held out",
        "worst parameter of candidates kept, in its sigmas", "s",
    )  # fmt: skip
    text = (
        f"{RECORDINGS} free oscillations of robots with {CABLES} cables, all of "
        f"{', '.join(CANDIDATE_SIGMAS)} as candidates. Robots that have them have factors of the "
        f"angular drag of {', '.join(f'{x:g}' for x in AXES)}, {CABLE_FACTOR:g} times the usual "
        f"drag of cables, a friction of {CAPSTAN:g} on their pulleys, and products of inertia of "
        f"{', '.join(map(str, PRODUCT_SHARES.values()))} of the spreads.\n\n{table(header, rows)}"
    )
    command = "python -m benchmarks.calibration_candidates"
    write_section("calibration-candidates", TITLE, command, text)


if __name__ == "__main__":
    main()
