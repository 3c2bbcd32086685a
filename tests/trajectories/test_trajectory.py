from __future__ import annotations

import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField
from tests.robots import simple_robot
from tests.trajectories.samples import FACTORIES, make

KINDS = list(FACTORIES)


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_agree_with_finite_differences(kind):
    trajectory = make(kind)
    h = 1e-4
    time = np.random.default_rng(0).uniform(2 * h, trajectory.duration - 2 * h, 400)
    # away from the breaks of the cubic spline, where its jerk steps
    breaks = trajectory.curve.breaks * trajectory.time_scale
    time = time[np.abs(time[:, None] - breaks).min(axis=1) > 2 * h]
    before, now, after = (trajectory.sample(time + s) for s in (-h, 0.0, h))
    pairs = (("position", "velocity"), ("velocity", "acceleration"), ("acceleration", "jerk"))
    for lower, higher in pairs:
        difference = (getattr(after, lower) - getattr(before, lower)) / (2 * h)
        exact = getattr(now, higher)
        # truncation h^2 / 6 times two derivatives more, which can be large on short arcs
        assert np.abs(difference - exact).max() < 2e-6 * max(1.0, 1 / trajectory.duration) ** 3


@pytest.mark.parametrize("kind", KINDS)
def test_it_starts_and_ends_at_rest_and_stays_there(kind):
    trajectory = make(kind)
    end = trajectory.duration
    s = trajectory.sample([0.0, end])
    assert np.abs(s.velocity).max() < 1e-9
    assert np.abs(s.acceleration).max() < 1e-9
    outside = trajectory.sample([-5.0, end + 1e-3, end + 100.0])
    np.testing.assert_allclose(outside.position, s.position[[0, 1, 1]], atol=1e-12)
    assert not outside.velocity.any()
    assert not outside.acceleration.any()
    assert not outside.jerk.any()


@pytest.mark.parametrize("kind", KINDS)
def test_position_velocity_and_acceleration_never_jump(kind):
    trajectory = make(kind)
    breaks = trajectory.curve.breaks * trajectory.time_scale
    left, right = trajectory.sample(breaks - 1e-9), trajectory.sample(breaks + 1e-9)
    for part in ("position", "velocity", "acceleration"):
        assert np.abs(getattr(left, part) - getattr(right, part)).max() < 1e-7


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("speed", "acceleration"), [(1.0, 1.0), (0.2, 50.0), (50.0, 0.3)])
def test_limits_hold_and_one_is_reached(kind, speed, acceleration):
    trajectory = make(kind, speed_max=speed, acceleration_max=acceleration)
    s = trajectory.sample(np.linspace(0.0, trajectory.duration, 100_001))
    fastest = np.linalg.norm(s.velocity, axis=1).max() / speed
    hardest = np.linalg.norm(s.acceleration, axis=1).max() / acceleration
    assert fastest <= 1.0
    assert hardest <= 1.0
    assert max(fastest, hardest) > 0.99
    assert trajectory.peak_speed == pytest.approx(fastest * speed, rel=1e-4)
    assert trajectory.peak_acceleration == pytest.approx(hardest * acceleration, rel=1e-3)


@pytest.mark.parametrize("kind", [k for k in KINDS if not k.startswith("random")])
def test_a_duration_is_kept_or_refused(kind):
    fastest = make(kind).duration
    slow = make(kind, duration=1.7 * fastest)
    assert slow.duration == pytest.approx(1.7 * fastest, rel=1e-14)
    assert slow.peak_speed < make(kind).peak_speed
    np.testing.assert_allclose(
        slow.sample([slow.duration]).position, make(kind).sample([fastest]).position, atol=1e-9
    )
    assert make(kind, duration=fastest).duration == pytest.approx(fastest, rel=1e-14)
    with pytest.raises(InvalidField, match=r"duration: got .* s; allowed: >= .* s with 1 m/s and"):
        make(kind, duration=0.99 * fastest)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"speed_max": 0.0}, r"speed_max: got 0.0 m/s; allowed: a finite speed_max > 0"),
        ({"speed_max": np.nan}, r"speed_max: got nan m/s"),
        ({"acceleration_max": -1.0}, r"acceleration_max: got -1.0 m/s\^2"),
        ({"acceleration_max": np.inf}, r"acceleration_max: got inf m/s\^2"),
    ],
)
@pytest.mark.parametrize("kind", KINDS)
def test_bad_limits_are_refused(kind, changes, message):
    with pytest.raises(InvalidField, match=message):
        make(kind, **changes)


def test_a_window_starts_now_and_goes_on_past_the_end():
    trajectory = make("minimum_snap")
    reference = trajectory.window(trajectory.duration - 0.25, 0.5, 0.1)
    assert reference.time.shape == (1, 6)
    assert reference.position.shape == (1, 6, 3)
    np.testing.assert_allclose(np.diff(reference.time[0]), 0.1)
    s = trajectory.sample(reference.time[0])
    for part in ("position", "velocity", "acceleration"):
        np.testing.assert_array_equal(getattr(reference, part)[0], getattr(s, part))
    assert reference.rotation is None
    assert not reference.velocity[0, 3:].any()
    assert trajectory.window(0.0, 0.0, 0.1).time.shape == (1, 1)


@pytest.mark.parametrize(("horizon", "period"), [(1.0, 0.0), (-1.0, 0.1), (np.inf, 0.1)])
def test_a_window_without_rows_is_refused(horizon, period):
    with pytest.raises(InvalidField, match=r"(horizon|period): got"):
        make("line").window(0.0, horizon, period)


def test_times_that_are_no_batch_are_refused():
    with pytest.raises(InvalidField, match=r"time: got shape \(1, 2\); allowed: shape \(B,\)"):
        make("line").sample([[0.5, 0.6]])
    with pytest.raises(InvalidField, match=r"time\[1\]: got nan; allowed: a finite number"):
        make("line").sample([0.5, np.nan])


def test_leaving_the_workspace_box_is_refused_with_place_and_time():
    robot = simple_robot(workspace_max=[2.4, 1.2, 5.0])
    inside = make("line")
    assert inside.within(robot) is inside
    low = simple_robot(workspace_max=[2.4, 1.2, 2.4])
    with pytest.raises(InvalidField, match=r"line: z at 3.* s: got 2.5.* m; allowed: 1 m to 2.4 m"):
        inside.within(low)
    narrow = simple_robot(workspace_min=[-0.3, -3.8, 1.0])
    with pytest.raises(InvalidField, match=r"spiral: x at .* s: got -0.* m; allowed: -0.3 m to"):
        make("spiral").within(narrow)
