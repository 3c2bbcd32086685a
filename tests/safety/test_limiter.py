"""Nothing leaves that breaks a limit, and a full stop stays possible from everything that does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.values import Command
from carosac_toolkit.physics.cable.straight_line import forward_kinematics, inverse_kinematics
from carosac_toolkit.physics.motion.braking import most_steps
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.robot.similar import similar_robot, similarity
from carosac_toolkit.safety.limiter import Limiter, LimitSettings
from tests.robots import eight_cable_robot, simple_robot, with_pulleys

ROBOT = simple_robot()
BOX_TOLERANCE = 1e-8  # [m]; positions are found to 1e-9 m


def home(robot: Robot, size: int = 1) -> np.ndarray:
    return np.repeat(inverse_kinematics(robot, robot.home_position[None]), size, axis=0)


def limiter_at_home(
    robot: Robot = ROBOT, size: int = 1, period: float = 0.01, **changes
) -> Limiter:
    limiter = Limiter(robot, LimitSettings(**changes), period=period)
    limiter.reset(home(robot, size))
    return limiter


def asked(length: np.ndarray, **more) -> Command:
    return Command(time=np.zeros(len(length)), unstrained_length=length, **more)


def check_limits(robot: Robot, limiter: Limiter, sent: np.ndarray) -> None:
    """Finite differences of what was sent, (T, B, n), from rest at its first entry.

    Tolerance: 1e-9 of the limit, and what the rounding of a length (4 ulp) comes to in it.
    """
    h, grain = limiter.period, 16 * np.spacing(robot.length_max.max())
    rest = np.repeat(sent[:1], 3, axis=0)
    values = np.concatenate([rest, sent])
    limits = (robot.speed_max, robot.acceleration_max, limiter.jerk_max)
    for order, limit in enumerate(limits, start=1):
        values = np.diff(values, axis=0) / h
        allowed = limit * (1 + 1e-9) + 2**order * grain / h**order
        assert (np.abs(values) <= allowed).all(), (order, np.abs(values).max(axis=(0, 1)), limit)
    assert (sent >= robot.length_min * (1 - 1e-9)).all()
    assert (sent <= robot.length_max * (1 + 1e-9)).all()
    if limiter.box:
        check_box(robot, sent)


def check_box(robot: Robot, sent: np.ndarray) -> None:
    """Follow the straight-line position from step to step with the toolkit's own solver."""
    guess = forward_kinematics(robot, sent[0]).position
    for length in sent:
        fit = forward_kinematics(robot, length, guess=guess)
        assert fit.converged.all()
        guess = fit.position
        assert (guess >= robot.workspace_min - BOX_TOLERANCE).all()
        assert (guess <= robot.workspace_max + BOX_TOLERANCE).all()


def brake_to_rest(limiter: Limiter) -> np.ndarray:
    """The lengths of the whole controlled stop, (T, B, n)."""
    lengths = [limiter.motion.length]
    while not limiter.stopped:
        lengths.append(limiter.brake().unstrained_length)
        assert len(lengths) < most_steps(limiter.robot, limiter.jerk_max, limiter.period)
    return np.array(lengths)


def paths(robot: Robot, rng: np.random.Generator, steps: int, size: int, h: float) -> np.ndarray:
    """Command sequences (steps, size, n): rows from wild to smooth, in turn."""
    time = np.arange(1, steps + 1) * h
    rows = [path(KINDS[b % len(KINDS)], robot, rng, time) for b in range(size)]
    return np.stack(rows, axis=1)


KINDS = ("jumps", "chatter", "walk", "drift", "corner", "noisy corner", "swing", "held jumps")


def path(kind: str, robot: Robot, rng: np.random.Generator, time: np.ndarray) -> np.ndarray:
    """One command sequence (T, n)."""
    strength = 10.0 ** rng.uniform(-4, 1)
    noise = rng.standard_normal((len(time), robot.n))
    if "corner" in kind:
        return corner_path(robot, rng, time) + 1e-4 * strength * noise * (kind != "corner")
    return (
        home(robot)
        + {
            "jumps": noise * 10.0 ** rng.uniform(-6, 6, (len(time), 1)),
            "chatter": strength * np.sign(noise[:, :1]) * noise[0],
            "walk": 0.01 * strength * np.cumsum(noise, axis=0),
            "drift": rng.uniform(-3, 3, robot.n) * time[:, None],
            "swing": swing(rng, time[:, None], robot.n),
            "held jumps": np.repeat(noise[::25], 25, axis=0)[: len(time)] * strength,
        }[kind]
    )


def corner_path(robot: Robot, rng: np.random.Generator, time: np.ndarray) -> np.ndarray:
    """Smoothly from home to a point at or beyond a corner of the box."""
    corner = np.where(rng.random(3) < 0.5, robot.workspace_min, robot.workspace_max)
    center = 0.5 * (robot.workspace_min + robot.workspace_max)
    goal = center + (corner - center) * rng.uniform(0.8, 1.15)
    duration = np.linalg.norm(goal - robot.home_position) / rng.uniform(0.3, 4.0) + 0.3
    s = np.clip(time / duration, 0.0, 1.0)
    s = s**3 * (10 - 15 * s + 6 * s**2)
    return inverse_kinematics(
        robot, robot.home_position + s[:, None] * (goal - robot.home_position)
    )


def swing(rng: np.random.Generator, time: np.ndarray, n: int) -> np.ndarray:
    """A sway of all cables that starts softly."""
    frequency = rng.uniform(0.2, 5.0)
    soft = np.minimum(time / 0.3, 1.0) ** 3
    return rng.uniform(0.0, 0.3) * soft * np.sin(2 * np.pi * frequency * time + np.arange(n))


def drive(limiter: Limiter, commands: np.ndarray) -> np.ndarray:
    """Send all; what needed no change is bit-identical; return the lengths with the start."""
    lengths = [limiter.motion.length]
    for length in commands:
        command = asked(length)
        got = limiter.apply(command)
        same = (got.unstrained_length == length).all()
        assert same == (got.limited == ())
        assert not same or got is command
        lengths.append(got.unstrained_length)
    return np.array(lengths)


tight = simple_robot(length_min=np.full(4, 6.5), length_max=np.full(4, 9.5))
uneven = simple_robot(
    speed_max=[2.5, 1.0, 0.3, 2.0],
    acceleration_max=[5.0, 20.0, 1.0, 3.0],
    length_max=np.full(4, 9.4),
)
ROBOTS = {
    "simple": ROBOT,
    "tight": tight,
    "uneven": uneven,
    "eight": eight_cable_robot(),
    "pulleys": with_pulleys(ROBOT),
}
STEPS, SIZE, EXAMPLES = 100, 48, 10  # 48 000 command steps; benchmarks.limits_bar makes more


@settings(
    max_examples=EXAMPLES, deadline=None, derandomize=True,
    suppress_health_check=[HealthCheck.too_slow], phases=[Phase.explicit, Phase.generate],
)  # fmt: skip
@given(
    name=st.sampled_from(sorted(ROBOTS)),
    seed=st.integers(0, 2**32 - 1),
    period=st.sampled_from([0.004, 0.01, 0.02]),
    jerk_max=st.sampled_from([30.0, 200.0, 5000.0]),
    box=st.booleans(),
)
def test_nothing_that_leaves_breaks_a_limit_and_stopping_stays_possible(
    name, seed, period, jerk_max, box
):
    robot, rng = ROBOTS[name], np.random.default_rng(seed)
    limiter = limiter_at_home(robot, SIZE, period, jerk_max=jerk_max, box=box)
    commands = paths(robot, rng, STEPS, SIZE, period)
    cut = int(rng.integers(1, STEPS))
    first = drive(limiter, commands[:cut])
    stop = brake_to_rest(limiter)
    check_limits(robot, limiter, np.concatenate([first, stop[1:]]))
    assert limiter.stopped
    held = limiter.brake().unstrained_length
    assert (held == stop[-1]).all()
    limiter.reset(home(robot, SIZE))
    whole = drive(limiter, commands)
    assert (whole[: cut + 1] == first).all()  # the same commands give the same bits
    check_limits(robot, limiter, np.concatenate([whole, brake_to_rest(limiter)[1:]]))


def test_a_limit_hit_names_limit_cable_asked_and_sent():
    limiter = limiter_at_home(jerk_max=200.0)
    start = home(ROBOT)
    sent = limiter.apply(asked(start + np.array([[0.0, 0.0, 0.02, 0.0]])))
    hits = {(hit.limit, hit.cable): hit for hit in sent.limited}
    assert set(hits) == {("acceleration", 2), ("jerk", 2)}
    step = sent.unstrained_length[0, 2] - start[0, 2]
    assert hits["jerk", 2].asked == pytest.approx(0.02 / 1e-6)
    assert hits["jerk", 2].sent == pytest.approx(step / 1e-6)
    assert hits["jerk", 2].sent == pytest.approx(200.0, rel=1e-5)
    assert hits["acceleration", 2].asked == pytest.approx(200.0)
    sent = limiter.apply(asked(start + np.array([[0.0, 0.1, 0.02, 0.0]])))
    assert {"speed", "acceleration", "jerk"} == {h.limit for h in sent.limited if h.cable == 1}
    assert {h.cable for h in sent.limited} <= {1, 2}  # cables 0 and 3 stay where they are asked to


def test_every_changed_cable_is_in_the_report():
    rng = np.random.default_rng(3)
    limiter = limiter_at_home(ROBOT, 1)
    for length in paths(ROBOT, rng, 60, 4, 0.01).swapaxes(0, 1).reshape(-1, 1, 4)[:120]:
        sent = limiter.apply(asked(length))
        changed = set(np.flatnonzero(sent.unstrained_length[0] != length[0]))
        assert changed <= {hit.cable for hit in sent.limited}


def test_cables_in_proportion_stay_in_proportion_until_they_arrive_together():
    limiter = limiter_at_home()
    start = home(ROBOT)
    goal = inverse_kinematics(ROBOT, ROBOT.home_position[None] + [0.8, 0.5, 0.6])
    lengths = [start]
    while not (lengths[-1] == goal).all():
        lengths.append(limiter.apply(asked(goal)).unstrained_length)
        assert len(lengths) < 200
    progress = (np.array(lengths[:-1]) - start) / (goal - start)
    assert np.ptp(progress, axis=2).max() < 1e-4
    assert (np.diff(progress, axis=0) >= -1e-12).all()
    assert progress.max() < 1.0 + 1e-8  # no overshoot
    assert limiter.apply(asked(goal)).limited == ()
    for _ in range(30):  # it arrives with a rest of speed, as what may pass is passed at once
        sent = limiter.apply(asked(goal)).unstrained_length
        assert np.abs(sent - goal).max() < 2 * 200.0 * 0.01**3
    assert limiter.stopped
    # time-optimal but for jerk: sqrt(d / a) up and down, and a few ramps of 25 ms
    assert len(lengths) * 0.01 < 2 * np.sqrt(np.abs(goal - start).max() / 5.0) + 0.1


@pytest.mark.parametrize("size", [1e-4, 3e-4, 1e-3, 1e-2, 5e-2])  # [m]
def test_a_target_at_rest_is_reached_without_swinging(size):
    start = home(ROBOT, 200)
    goal = start + size * np.random.default_rng(0).standard_normal(start.shape)
    limiter = limiter_at_home(ROBOT, 200)
    lengths = [start]
    for _ in range(60):  # the time-optimal motion over the largest distance takes 0.42 s
        lengths.append(limiter.apply(asked(goal)).unstrained_length)
    beyond = (np.array(lengths) - goal) * np.sign(goal - start)
    assert beyond.max() < 200.0 * 0.01**3  # what jerk allows in one period
    assert (lengths[-1] == goal).all()
    assert limiter.stopped


def test_a_moving_target_is_caught_up_with():
    limiter = limiter_at_home(box=False)
    start, rate = home(ROBOT), np.array([[0.5, -0.2, -0.5, 0.3]])
    for k in range(150):
        length = start + 0.02 * np.sign(rate) + rate * 0.01 * k
        sent = limiter.apply(asked(length))
    assert sent.limited == ()
    assert (sent.unstrained_length == length).all()


def test_the_braking_distance_counts_at_a_length_limit():
    robot = simple_robot(length_max=np.full(4, 9.5))
    limiter = limiter_at_home(robot, box=False)
    length, k = home(robot), 0
    while True:  # within speed, acceleration and jerk, straight at the limit
        k += 1
        length = length + np.array([[0.0, 0.0, min(1.5 * k * 0.01, 0.6) * 0.01, 0.0]])
        sent = limiter.apply(asked(length))
        if sent.limited:
            break
    assert length[0, 2] < 9.5  # the length itself would be allowed
    (hit,) = [hit for hit in sent.limited if hit.limit == "length"]
    assert hit.cable == 2
    assert hit.asked > 9.5
    assert 9.45 < hit.sent <= 9.5 + 1e-9
    for _ in range(200):
        length = length + np.array([[0.0, 0.0, 0.01, 0.0]])
        sent = limiter.apply(asked(length))
    assert sent.unstrained_length[0, 2] == pytest.approx(9.5, abs=1e-4)
    assert limiter.motion.length.max() <= 9.5 + 1e-9


def test_the_braking_distance_counts_at_the_box():
    limiter = limiter_at_home()
    position = ROBOT.home_position[None].copy()
    hit_at = None
    for k in range(1, 400):
        position = position + np.array([[min(2.0 * k * 0.01, 1.0) * 0.01, 0.0, 0.0]])
        sent = limiter.apply(asked(inverse_kinematics(ROBOT, position)))
        boxes = [hit for hit in sent.limited if hit.limit == "box"]
        if boxes and hit_at is None:
            hit_at = position[0, 0]
            assert boxes[0].cable is None
            assert boxes[0].asked > 0.0
            assert boxes[0].sent <= BOX_TOLERANCE
    assert ROBOT.workspace_max[0] - 0.5 < hit_at < ROBOT.workspace_max[0]
    end = forward_kinematics(ROBOT, limiter.motion.length).position[0]
    assert end[0] <= ROBOT.workspace_max[0] + BOX_TOLERANCE


def test_the_box_can_be_switched_off():
    limiter = limiter_at_home(box=False)
    below = ROBOT.home_position[None] * [1, 1, 0] + [0, 0, 0.8]
    for _ in range(300):
        sent = limiter.apply(asked(inverse_kinematics(ROBOT, below)))
    assert sent.limited == ()


def test_a_command_stays_near_the_measured_length():
    limiter = limiter_at_home(jump_max=0.13)
    stuck = home(ROBOT)
    for k in range(1, 200):
        sent = limiter.apply(asked(stuck + 0.5 * min(k * 0.01, 1.0) ** 3), stuck)
    jumps = [hit for hit in sent.limited if hit.limit == "jump"]
    assert [hit.cable for hit in jumps] == [0, 1, 2, 3]
    assert limiter.stopped  # a winch that is stuck: brake, and report
    gap = np.abs(sent.unstrained_length - stuck)
    assert gap.max() < 0.13 + 0.2  # by no more than a braking distance
    assert jumps[0].sent == pytest.approx(gap[0, 0])
    for _ in range(300):  # back towards where the winches are: allowed, and reported till there
        sent = limiter.apply(asked(stuck), stuck)
    assert sent.limited == ()
    assert (sent.unstrained_length == stuck).all()


def test_the_jump_limit_holds_while_the_winches_follow():
    rng = np.random.default_rng(5)
    limiter = limiter_at_home(ROBOT, 8, jump_max=0.2)
    actual = home(ROBOT, 8)
    for length in paths(ROBOT, rng, 150, 8, 0.01):
        sent = limiter.apply(asked(length), actual)
        gap = np.abs(sent.unstrained_length - actual)
        reported = [hit.sent for hit in sent.limited if hit.limit == "jump"]
        assert (gap[gap > 0.2] <= max(reported, default=0.0)).all()  # never without a word
        actual = actual + (sent.unstrained_length - actual) * (0.01 / (0.05 + 0.01))
    assert gap.max() <= 0.2


def test_rates_follow_changed_lengths_and_keep_the_speed_limit():
    limiter = limiter_at_home()
    start = home(ROBOT)
    fast = np.array([[0.0, 3.0, -9.0, 1.0]])
    sent = limiter.apply(asked(start, length_rate=fast))
    assert sent.length_rate.tolist() == [[0.0, 2.5, -2.5, 1.0]]
    assert [(h.limit, h.cable, h.asked, h.sent) for h in sent.limited] == [
        ("length_rate", 1, 3.0, 2.5),
        ("length_rate", 2, -9.0, -2.5),
    ]
    sent = limiter.apply(asked(start + 1.0, length_rate=fast))
    assert sent.length_rate == pytest.approx((sent.unstrained_length - start) / 0.01, rel=1e-9)


def test_a_batch_is_its_rows():
    rng = np.random.default_rng(11)
    commands = paths(ROBOT, rng, 60, 8, 0.01)
    together, alone = limiter_at_home(ROBOT, 8), [limiter_at_home() for _ in range(8)]
    for length in commands:
        sent = together.apply(asked(length))
        rows = [one.apply(asked(length[b : b + 1])) for b, one in enumerate(alone)]
        assert (sent.unstrained_length == np.vstack([r.unstrained_length for r in rows])).all()
        assert sent.limited == tuple(
            replace(hit, row=b) for b, row in enumerate(rows) for hit in row.limited
        )


def test_the_controlled_stop_is_quick_and_ends_exactly_at_rest():
    limiter = limiter_at_home(box=False)
    for _ in range(60):
        limiter.apply(asked(home(ROBOT) + 3.0))
    assert not limiter.stopped
    speed = np.abs(limiter.motion.speed).max()
    stop = brake_to_rest(limiter)
    assert len(stop) * 0.01 < speed / 5.0 + 2 * 5.0 / 200.0 + 0.05
    assert (limiter.motion.speed == 0.0).all()
    assert (limiter.motion.acceleration == 0.0).all()
    assert limiter.brake().time[0] == pytest.approx((len(stop)) * 0.01)


def test_numbers_beyond_all_bounds_are_taken_for_a_jump():
    limiter = limiter_at_home()
    for value in (1e300, -1e300, 1.7e308):
        sent = limiter.apply(asked(np.full((1, 4), value)))
        assert np.isfinite(sent.unstrained_length).all()
        assert sent.limited


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda x: x.apply(asked(np.ones((1, 3)))), r"unstrained_length: got shape \(1, 3\)"),
        (lambda x: x.apply(asked(home(ROBOT, 2))), r"got shape \(2, 4\); allowed: shape \(1, 4\)"),
        (lambda x: x.apply(asked(home(ROBOT)), [[1, 2, np.nan, 4]]), r"actual\[0, 2\]: got nan"),
        (lambda x: x.apply(asked(home(ROBOT)), np.ones((2, 4))), r"actual: got shape \(2, 4\)"),
        (lambda x: x.reset(np.full((1, 4), 99.0)), r"unstrained_length\[0, 0\]: got 99.0 m"),
        (lambda x: x.reset([[5.0, 5, 5, 5]]), r"unstrained_length\[0\]: got .*workspace box"),
        (lambda x: x.reset(home(ROBOT), time=[0.0, 1.0]), r"time: got shape \(2,\)"),
    ],
)
def test_bad_numbers_are_refused_and_change_nothing(call, message):
    limiter, other = limiter_at_home(), limiter_at_home()
    for one in (limiter, other):
        one.apply(asked(home(ROBOT) + 0.1))
    with pytest.raises(InvalidField, match=message):
        call(limiter)
    assert (limiter.motion.length == other.motion.length).all()
    assert (limiter.brake().unstrained_length == other.brake().unstrained_length).all()


def test_bad_settings_are_refused():
    with pytest.raises(InvalidField, match=r"jerk_max: got 0.0 m/s\^3; allowed: jerk_max > 0"):
        LimitSettings(jerk_max=0.0)
    with pytest.raises(InvalidField, match=r"jump_max: got nan m; allowed"):
        LimitSettings(jump_max=float("nan"))
    with pytest.raises(InvalidField, match=r"period: got -0.01 s; allowed: period > 0"):
        Limiter(ROBOT, period=-0.01)
    with pytest.raises(InvalidField, match=r"period: got 1e-05 s; allowed: .* rounding"):
        Limiter(ROBOT, period=1e-5)
    with pytest.raises(InvalidField, match=r"limiter: got no lengths .* a call of reset\(\) first"):
        Limiter(ROBOT, period=0.01).apply(asked(home(ROBOT)))


@pytest.mark.parametrize("period", [0.01, 0.02])
def test_limits_of_carosac_are_derived_from_its_winches(period):
    limiter = Limiter(load_robot("carosac"), period=period)
    assert limiter.jump_max == pytest.approx(0.3, rel=1e-15)
    assert limiter.jerk_max == 200.0


def test_winches_without_lag_may_be_two_periods_behind():
    limiter = Limiter(replace(ROBOT, winch_lag=np.zeros(4)), period=0.01)
    assert limiter.jump_max == pytest.approx(2 * 0.02 * ROBOT.speed_max.max())
    assert limiter.jerk_max == pytest.approx(ROBOT.acceleration_max.min() / 0.01)


def test_a_jump_limit_within_the_lag_of_the_winches_is_refused():
    message = r"jump_max: got 0.12 m for robot .* allowed: more than 0.125 m, the lag of its winc"
    with pytest.raises(InvalidField, match=message):
        LimitSettings(jump_max=0.12).of(ROBOT, period=0.01)
    with pytest.raises(InvalidField, match=r"jump_max: got 0\.06 m"):
        Limiter(ROBOT, LimitSettings(jump_max=0.06), period=0.01)


def test_a_plant_of_slower_winches_takes_limits_that_its_nominal_robot_took():
    limits = LimitSettings(jump_max=0.13).of(ROBOT, period=0.01)
    slower = replace(ROBOT, winch_lag=1.5 * ROBOT.winch_lag)
    assert Limiter(slower, limits, period=0.01).jump_max == 0.13


def test_settled_limits_are_those_of_the_nominal_robot():
    limits = LimitSettings(jump_max=0.5).of(ROBOT, period=0.01)
    slower = replace(ROBOT, winch_lag=2.0 * ROBOT.winch_lag)
    assert Limiter(slower, limits, period=0.01).jerk_max == Limiter(ROBOT, period=0.01).jerk_max
    assert limits.jump_max == 0.5


@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_a_scaled_stream_of_commands_is_limited_alike(factor):
    base, period = load_robot("carosac"), 0.02

    def stream(robot: Robot, time: float, length: float) -> tuple[np.ndarray, list]:
        limiter = Limiter(robot, period=period * time)
        start = inverse_kinematics(robot, robot.home_position[None])
        limiter.reset(start)
        rng, asked_for, sent, hits = np.random.default_rng(3), np.zeros((1, 4)), [], []
        actual = start
        for k in range(200):
            asked_for = asked_for + rng.normal(0.0, 0.04, (1, 4)) + 0.03 * np.sin(0.1 * k)
            command = limiter.apply(asked(start + length * asked_for), actual)
            actual = actual + 0.3 * (command.unstrained_length - actual)
            sent.append((command.unstrained_length - start)[0] / length)
            hits.append(sorted({hit.limit for hit in command.limited}))
        return np.array(sent), hits

    ratios = similarity(factor)
    sent, hits = stream(similar_robot(base, factor), ratios.time, ratios.length)
    at_one, hits_at_one = stream(base, 1.0, 1.0)
    assert np.abs(sent - at_one).max() < 1e-6
    assert hits == hits_at_one
    assert {"jerk", "acceleration"} <= {limit for row in hits for limit in row}
