"""Robots of any size: whole runs of a similar robot, and numbers that belong to one size.

The first test says that something is wrong; the second one names the module.
"""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from benchmarks import similarity
from carosac_toolkit.base.scaled import Scaled

ROOT = Path(__file__).parents[1]
BAR = 0.02
ROWS = ("kinematic_solver/truth", "input_shaping/truth", "mpc/truth")
PACKAGES = (
    "baselines", "sim_warp", "carosac_toolkit/physics", "carosac_toolkit/safety",
    "carosac_toolkit/drivers", "carosac_toolkit/trajectories", "carosac_toolkit/studies/run",
    "carosac_toolkit/loop", "calibration/self_calibration",
)  # fmt: skip
UNIT = re.compile(r"_(M|S|N|KG|HZ|NM|(M|RAD|M2|1)_PER_(SQRT_)?S2?|PER_S)$")
NOT_OF_A_ROBOT = {
    "rounding": {
        "READING_INTERVAL_MIN_S", "TIME_TOLERANCE_S", "HANGING_CLOSURE_MAX_M",
        "TENSIONED_CLOSURE_MAX_M", "STEP_DIFFERENCE_MAX_S", "PIECE_DURATION_MIN_S", "BOX_MARGIN_M",
        "POSITION_STEP_MIN_M", "LINE_SIGMA_MIN_M",
    },
    "a unit, or all time": {"MINUTE_S", "WHOLE_RECORDING_S"},
    "the robot on which defaults are stated": {
        "CAROSAC_CABLE_M", "CAROSAC_MASS_KG", "CAROSAC_WORKSPACE_M", "CAROSAC_GRAVITY_M_PER_S2",
        "CAROSAC_CABLE_DRAG_PER_S",
    },
    "the computer's time, or its network's": {
        "COMPILE_TIMEOUT_S", "DELAY_S", "NOTICE_DELAY_S", "SENSED_TIME_S", "LOST_AT_REST_S",
        "STOP_TIME_MAX_S", "HANG_TIME_AT_REST_S", "END_TIMEOUT_S", "STALE_TIME_S", "SAMPLE_AGE_S",
        "FAULT_DURATION_S", "POLL_INTERVAL_S", "CONNECT_TIMEOUT_S", "TERMINAL_INTERVAL_S",
        "PLAIN_INTERVAL_S", "INTERVAL_MAX_S", "STOP_GRACE_S", "FLUSH_INTERVAL_S",
        "DEFAULT_TIMEOUT_S",
        "EXCEPTION_WAIT_S", "LOST_AFTER_S", "CLUSTER_PATIENCE_S", "NOTICE_AFTER_S",
        "QUERY_INTERVAL_S", "ANSWER_TIMEOUT_S",
    },
    "a sensor": {"STANDING_CHANGE_MAX_M"},
    "not worth a number beyond": {"DETECTABLE_MAX_M"},
    "a weight that statics do not see": {"STRAIGHT_DENSITY_KG_PER_M"},
}  # fmt: skip


@pytest.fixture(scope="module")
def first():
    """Scores at factor 1, by row."""
    world = similarity.world_of("carosac", 1.0)
    return {row: similarity.dimensionless(similarity.run(world, row), world) for row in ROWS}


@pytest.mark.parametrize("row", ROWS)
@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_a_similar_robot_gets_the_same_dimensionless_scores(row, factor, first):
    world = similarity.world_of("carosac", factor)
    found, before = similarity.dimensionless(similarity.run(world, row), world), first[row]
    for name in similarity.SCALES_WITH_LENGTH:
        assert found[name] == pytest.approx(before[name], rel=BAR, abs=1e-12), name
    assert found["tension_min_N"] == pytest.approx(before["tension_min_N"], abs=BAR)
    assert found["limited"] == before["limited"]


@pytest.mark.slow
def test_feedback_on_estimates_is_the_same_in_another_size_but_for_encoder_counts():
    row = similarity.FEEDBACK_ROW
    first, other = (
        similarity.dimensionless(similarity.run(world, row, counts=False), world)
        for world in (similarity.world_of("carosac", factor) for factor in (1.0, 0.1))
    )
    for name in (*similarity.SCALES_WITH_LENGTH, "nees", "tension_min_N"):
        assert other[name] == pytest.approx(first[name], rel=2e-3), name


def test_no_module_states_a_size_of_one_robot():
    known = set().union(*NOT_OF_A_ROBOT.values())
    found = {
        (name, str(path.relative_to(ROOT)))
        for package in PACKAGES
        for path in sorted((ROOT / package).rglob("*.py"))
        for name in _constants(path)
    }
    wrong = sorted(f"{path}: {name}" for name, path in found if name not in known)
    assert wrong == [], f"sizes that do not scale: {wrong}"
    assert known <= {name for name, _ in found}, "constants that are no more"


def _constants(path: Path) -> list[str]:
    """Names of plain numbers with a unit at the top of a module."""
    names = []
    for node in ast.parse(path.read_text()).body:
        target = node.targets[0] if isinstance(node, ast.Assign) else None
        if isinstance(node, ast.AnnAssign):
            target = node.target
        scales = isinstance(getattr(node, "value", None), ast.Call) and (
            getattr(node.value.func, "id", "") == Scaled.__name__
        )
        if isinstance(target, ast.Name) and UNIT.search(target.id) and not scales:
            names.append(target.id)
    return names
