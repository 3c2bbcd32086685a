from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.motion.winch import (
    Encoders,
    PaidOutLengths,
    WinchBatch,
    WinchSettings,
    inner_steps,
    lagging_lengths,
    winch_records,
)
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.robot.similar import similar_robot, similarity
from tests.robots import simple_robot

START = 8.0  # [m]
INNER_STEP_MAX_S = 2e-3  # [s] of winches with a lag of 50 ms
RADIUS, BUILDUP = np.array([0.05, 0.075, 0.1, 0.06]), np.array([3e-5, 7e-5, 0.0, 8e-5])  # [m]


def winches(settings=None, size=1, **changes):
    return WinchBatch(simple_robot(**changes), np.full((size, 4), START), settings)


def with_drums(settings=None, length=START, radius=RADIUS, buildup=BUILDUP, **changes):
    robot = simple_robot(drum_radius=radius, drum_buildup=buildup, **changes)
    return WinchBatch(robot, np.full((1, 4), length), settings)


def quick(**changes):
    """Winches without lag, speed or acceleration to speak of: they go where they are told."""
    free = {"winch_lag": [0.0] * 4, "speed_max": [1e9] * 4, "acceleration_max": [1e15] * 4}
    return with_drums(**changes, **free)


def follow(batch, commands, period=INNER_STEP_MAX_S):
    """Lengths and rates after each command, shapes (K, n)."""
    lengths, rates = [], []
    for command in commands:
        batch.advance(np.broadcast_to(command, batch.length.shape), period)
        lengths.append(batch.length[0])
        rates.append(batch.rate[0])
    return np.array(lengths), np.array(rates)


def paid_out_by_integration(radius, buildup, angle):
    """The build-up law itself: a turn pays out the radius, whose square falls by the length."""
    return solve_ivp(
        lambda _, length: np.sqrt(radius**2 - buildup * length), (0.0, angle), [0.0],
        rtol=1e-12, atol=1e-12, method="DOP853",
    ).y[0, -1]  # fmt: skip


def test_a_small_step_is_followed_with_the_lag_of_the_winch():
    lag = np.array([0.05, 0.1, 0.2, 0.0])
    batch = winches(winch_lag=lag, acceleration_max=[1e3] * 4)
    batch.advance(np.full((1, 4), START + 0.01), 0.1)
    missing = (START + 0.01 - batch.length[0]) / 0.01
    # (1 - h / lag)^(t / h) of the inner steps is below the exponential by h t / (2 lag^2) of it
    exact = np.exp([-2.0, -1.0, -0.5, -np.inf])
    step = inner_steps(simple_robot(winch_lag=lag))[:3]
    below = step * 0.1 / 2.0 / lag[:3] ** 2 * exact[:3]
    assert (np.abs(missing[:3] - exact[:3]) < 1.2 * below).all()
    assert missing[3] == pytest.approx(0.0, abs=1e-9)


def test_an_integral_answers_a_small_step_as_linear_control_says():
    lag, integral_time = 0.2, 0.4
    settings = WinchSettings(integral_time=integral_time)
    batch = winches(settings, winch_lag=[lag] * 4, acceleration_max=[1e3] * 4)
    lengths, _ = follow(batch, np.full(1000, START + 0.01))
    system = np.array([[-1.0 / lag, 1.0 / (lag * integral_time)], [-1.0, 0.0]])  # of (x, integral)
    drive = np.array([1.0 / lag, 1.0])
    for k in (50, 200, 1000):
        now = np.linalg.solve(system, (expm(system * INNER_STEP_MAX_S * k) - np.eye(2)) @ drive)
        assert (lengths[k - 1] - START) / 0.01 == pytest.approx(
            now[0], abs=2.0 * INNER_STEP_MAX_S / lag
        )
    assert lengths[-1] == pytest.approx(START + 0.01, abs=1e-4)


def test_a_moving_command_is_trailed_without_an_integral_and_not_with_one():
    period, speed, lag = 0.02, 0.5, 0.08
    asked = START + speed * period * np.arange(1, 400)
    drive = {"winch_lag": [lag] * 4, "acceleration_max": [50.0] * 4}
    # A command that is held is half a period old on the average; a step of the drive is as exact.
    half = 0.5 * speed * period
    plain, _ = follow(winches(**drive), asked, period)
    assert asked[-1] - plain[-1] == pytest.approx(speed * lag - half, abs=speed * INNER_STEP_MAX_S)
    better, _ = follow(winches(WinchSettings(integral_time=0.3), **drive), asked, period)
    assert asked[-1] - better[-1] == pytest.approx(-half, abs=speed * INNER_STEP_MAX_S)


def test_a_derivative_acts_as_a_longer_lag_while_a_command_is_held():
    damped = winches(WinchSettings(derivative_time=0.05), winch_lag=[0.05] * 4)
    slower = winches(winch_lag=[0.1] * 4)
    commands = START + 0.3 * np.sin(0.02 * np.arange(300))
    assert follow(damped, commands)[0] == pytest.approx(follow(slower, commands)[0], abs=1e-12)


@pytest.mark.parametrize(
    "settings", [WinchSettings(), WinchSettings(integral_time=0.1, derivative_time=0.01)]
)
def test_winches_keep_their_speed_and_acceleration(settings):
    speed_max, acceleration_max = [0.5, 1.0, 2.0, 2.5], [1.0, 2.0, 5.0, 50.0]
    batch = winches(settings, speed_max=speed_max, acceleration_max=acceleration_max)
    jumps = np.repeat([[10.0, 6.0, 10.0, 6.0], [6.0, 10.0, 8.0, 20.0]], 400, axis=0)
    lengths, rates = follow(batch, jumps)
    speed = np.abs(np.diff(lengths, axis=0)).max(axis=0) / INNER_STEP_MAX_S
    acceleration = np.abs(np.diff(rates, axis=0)).max(axis=0) / INNER_STEP_MAX_S
    assert (speed <= np.array(speed_max) * (1 + 1e-9)).all()
    assert (acceleration <= np.array(acceleration_max) * (1 + 1e-9)).all()
    assert speed[:2] == pytest.approx(speed_max[:2])  # and they reach it
    assert acceleration == pytest.approx(acceleration_max)


def test_an_integral_does_not_wind_up_while_a_limit_acts():
    lag, speed_max = 0.2, 2.5
    overshoot = {}
    for jump in (0.01, 1.0, 4.0):  # the first breaks no limit, the last is at one for 1.4 s
        batch = winches(
            WinchSettings(integral_time=0.4), winch_lag=[lag] * 4, acceleration_max=[50.0] * 4
        )
        lengths, _ = follow(batch, np.full(4000, START + jump))
        overshoot[jump] = lengths.max() - (START + jump)
        assert lengths[-1] == pytest.approx(START + jump, abs=1e-6)
    # When the limit lets go, speed_max * lag is missing, as if that had been the jump.
    free = overshoot[0.01] / 0.01 * speed_max * lag
    assert overshoot[1.0] == pytest.approx(overshoot[4.0], rel=1e-2)
    assert overshoot[4.0] == pytest.approx(free, rel=2e-2)


def test_no_time_changes_nothing_and_two_halves_are_a_whole():
    batch = winches()
    batch.advance(np.full((1, 4), 9.0), 0.1)
    before = batch.length, batch.rate
    batch.advance(np.full((1, 4), 5.0), 0.0)
    assert np.array_equal(before, (batch.length, batch.rate))
    halves = winches()
    for _ in range(2):
        halves.advance(np.full((1, 4), 9.0), 0.05)
    assert halves.length == pytest.approx(before[0], abs=1e-14)


def test_a_drum_pays_out_what_the_build_up_law_says():
    believed = 2e-5
    batch = quick(settings=WinchSettings(believed_drum_buildup=believed))
    for asked in (12.0, 0.5, 39.0):
        batch.advance(np.full((1, 4), asked), INNER_STEP_MAX_S)
        for i in range(4):
            # the drive turns by its belief ...
            left = np.sqrt(RADIUS[i] ** 2 - believed * asked)
            angle = 2.0 / believed * (RADIUS[i] - left)
            truth = paid_out_by_integration(RADIUS[i], BUILDUP[i], angle)  # ... and so the drum
            assert batch.length[0, i] == pytest.approx(truth, abs=1e-9)
        assert batch.read() == pytest.approx(asked, abs=1e-12)
        assert (batch.length[0] < asked - 1e-4).tolist() == [True, True, False, True]


@pytest.mark.parametrize("buildup", [0.0, 1e-18, 1e-12, 1e-7, 6e-5])
@pytest.mark.parametrize("length", [1e-6, 0.3, 17.0, 40.0])
def test_a_drum_that_is_known_changes_nothing(buildup, length):
    batch = quick(length=1.0, buildup=np.full(4, buildup))
    batch.advance(np.full((1, 4), length), INNER_STEP_MAX_S)
    assert batch.length == pytest.approx(length, rel=4e-16 * 8)
    assert batch.read() == pytest.approx(length, rel=4e-16 * 8)


def test_an_encoder_on_a_misjudged_drum_inverts_what_the_drive_does():
    for belief in (0.0, 1e-12, 5e-5):
        batch = quick(settings=WinchSettings(believed_drum_buildup=belief))
        start = batch.read()
        assert np.abs(start - START)[0, [0, 1, 3]].min() > 1e-3 or belief == 5e-5
        batch.advance(start, INNER_STEP_MAX_S)  # asked for what is read, nothing moves
        assert batch.length == pytest.approx(START, abs=1e-12)


def test_an_integral_cannot_see_the_error_of_a_drum():
    settings = WinchSettings(integral_time=0.2, believed_drum_buildup=0.0)
    batch = with_drums(settings)
    follow(batch, np.full(3000, 9.0))
    assert batch.read() == pytest.approx(9.0, abs=1e-9)
    # with r = command / angle the true length is short by buildup * angle^2 / 4
    assert batch.length[0] == pytest.approx(9.0 - BUILDUP * (9.0 / RADIUS) ** 2 / 4.0, abs=1e-9)


def test_a_batch_is_the_same_as_a_loop():
    rng = np.random.default_rng(2)
    settings = WinchSettings(integral_time=0.3, derivative_time=0.01, believed_drum_buildup=2e-5)
    robot = simple_robot(drum_radius=RADIUS, drum_buildup=BUILDUP)
    start = START + rng.random((5, 4))
    together = WinchBatch(robot, start, settings)
    each = [WinchBatch(robot, row[None], settings) for row in start]
    for duration in (0.005, 0.02, 0.0033):
        command = start + rng.normal(0.0, 0.3, start.shape)
        together.advance(command, duration)
        for batch, row in zip(each, command, strict=True):
            batch.advance(row[None], duration)
    for name in ("length", "rate"):
        rows = np.concatenate([getattr(batch, name) for batch in each])
        assert np.array_equal(getattr(together, name), rows)
    assert np.array_equal(together.read(), np.concatenate([batch.read() for batch in each]))


def test_records_carry_what_the_robot_and_the_settings_say():
    robot = simple_robot(drum_radius=RADIUS, drum_buildup=BUILDUP)
    plain, other = (winch_records(r) for r in (robot, replace(robot, drum_buildup=None)))
    assert np.array_equal(plain["believed_buildup"], BUILDUP)
    assert np.array_equal(plain["drum_radius"], RADIUS)
    assert not plain["integral_rate"].any()
    assert not other["drum_radius"].any()  # half a drum is none
    told = winch_records(robot, WinchSettings(integral_time=0.5, believed_drum_buildup=1e-5))
    assert told["integral_rate"] == pytest.approx(2.0)
    assert told["believed_buildup"] == pytest.approx(1e-5)
    assert np.array_equal(told["drum_buildup"], BUILDUP)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("integral_time", 0.0),
        ("derivative_time", -0.1),
        ("derivative_time", None),
        ("believed_drum_buildup", -1e-6),
        ("believed_drum_buildup", np.nan),
        ("integral_time", "slow"),
        ("integral_time", True),
    ],
)
def test_impossible_drives_are_refused(name, value):
    with pytest.raises(InvalidField, match=f"{name}: got .*; allowed: {name} >"):
        WinchSettings(**{name: value})


def test_drums_that_cannot_be_are_refused():
    robot = simple_robot(drum_radius=RADIUS, drum_buildup=BUILDUP)
    with pytest.raises(InvalidField, match=r"drum_buildup\[0\]: got 0.0001 m; .*pays out 40 m"):
        winch_records(replace(robot, drum_buildup=np.full(4, 1e-4)))
    belief = WinchSettings(believed_drum_buildup=1e-4)
    with pytest.raises(InvalidField, match=r"^believed_drum_buildup\[0\]: got 0.0001 m"):
        winch_records(robot, belief)
    with pytest.raises(InvalidField, match=r"believed_drum_buildup: .*None: robot .* has no drum"):
        winch_records(simple_robot(), belief)


def test_encoders_of_several_robots_read_each_its_own_drums():
    radii = [RADIUS, RADIUS + 0.01]
    robots = [simple_robot(drum_radius=radius, drum_buildup=BUILDUP) for radius in radii]
    settings = WinchSettings(believed_drum_buildup=2e-5)
    lengths = START + np.arange(8.0).reshape(2, 4)
    together = Encoders(robots, 2, settings).read(lengths)
    for b, robot in enumerate(robots):
        alone = WinchBatch(robot, lengths[b : b + 1], settings).read()
        assert np.array_equal(together[b], alone[0])
    assert not np.array_equal(together[0], WinchBatch(robots[1], lengths[:1], settings).read()[0])


def test_the_inner_steps_do_not_depend_on_the_rounding_of_the_time():
    """5 ms are two and a half steps of 2 ms: a bit more or less must not be another number."""
    lengths = []
    for duration in (np.nextafter(0.005, 0.0), 0.005, np.nextafter(0.005, 1.0), 0.02 - 0.015):
        batch = winches()
        batch.advance(np.full((1, 4), START + 0.01), duration)
        lengths.append(batch.length[0])
    assert np.ptp(lengths, axis=0).max() < 1e-12


def test_inner_steps_resolve_the_lag_of_each_winch():
    assert inner_steps(load_robot("carosac")) == pytest.approx(2e-3, rel=1e-12)
    mixed = inner_steps(simple_robot(winch_lag=[0.05, 0.05, 0.05, 0.01]))
    assert mixed == pytest.approx([1.6e-3, 1.6e-3, 1.6e-3, 0.5e-3])
    without = inner_steps(simple_robot(winch_lag=[0.0] * 4))
    assert without == pytest.approx(2e-3, rel=0.2)  # of a robot about as large


def test_an_integral_that_the_inner_steps_do_not_resolve_is_refused():
    message = r"integral_time: got 0.003 s; allowed: integral_time >= 0.004 s for robot 'carosac'"
    with pytest.raises(InvalidField, match=message):
        winch_records(load_robot("carosac"), WinchSettings(integral_time=3e-3))
    winch_records(load_robot("carosac"), WinchSettings(integral_time=4e-3))


@pytest.mark.parametrize("factor", [0.1, 10.0])
@pytest.mark.parametrize("lag", [0.05, 0.0])
def test_winches_of_a_scaled_robot_answer_alike(factor, lag):
    base, scale = replace(load_robot("carosac"), winch_lag=np.full(4, lag)), similarity(factor)

    def motion(robot, length, time):
        batch = WinchBatch(robot, np.full((1, 4), START * length))
        commands = START + np.cumsum(np.random.default_rng(1).normal(0.0, 0.02, (60, 4)), axis=0)
        return follow(batch, commands[:, None] * length, 0.02 * time)[0] / length

    other = motion(similar_robot(base, factor), scale.length, scale.time)
    assert other == pytest.approx(motion(base, 1.0, 1.0), abs=1e-9)


def test_a_lag_that_is_next_to_none_takes_no_more_steps_than_none():
    robot = simple_robot()
    for lag in (1e-12, 1e-9, 1e-6):
        tiny = replace(robot, winch_lag=np.full(robot.n, lag))
        none = replace(robot, winch_lag=np.zeros(robot.n))
        assert inner_steps(tiny) == pytest.approx(inner_steps(none))


def test_a_hysteresis_holds_the_length_back_at_reversals_and_has_the_stated_width():
    """Wound out and in over many times its width: 2 h between both ways, at every speed."""
    wide = np.array([2e-3, 0.0, 1e-3, 0.5e-3])
    fast = {"winch_lag": [0.0] * 4, "speed_max": [1e9] * 4, "acceleration_max": [1e15] * 4}
    way = 0.06 * np.concatenate([np.linspace(0.0, 1.0, 400), np.linspace(1.0, -1.0, 800)])
    loops = []
    for period in (INNER_STEP_MAX_S, 10.0 * INNER_STEP_MAX_S):
        batch = winches(length_hysteresis=wide, **fast)
        lengths, _ = follow(batch, START + way[:, None], period)
        assert batch.read()[0] == pytest.approx(np.full(4, START + way[-1]))  # the drum's turns
        loops.append(lengths)
    assert loops[0] == pytest.approx(loops[1], abs=1e-12)
    lengths = loops[0]
    out = np.array([np.interp(0.03, way[:400], one[:400]) for one in lengths.T])
    back = np.array([np.interp(-0.03, -way[400:], one[400:]) for one in lengths.T])
    assert back - out == pytest.approx(2.0 * wide, rel=1e-3)
    assert (np.diff(lengths[400:], axis=0) <= 1e-15).all()  # never the wrong way
    turn = np.diff(lengths[398:404], axis=0)
    assert np.abs(turn[2, 0]) < 0.2 * np.abs(turn[2, 1])  # held back just after the reversal


def test_recorded_lengths_lag_as_those_of_a_winch():
    wide = np.array([2e-3, 0.0, 1e-3, 0.5e-3])
    fast = {"winch_lag": [0.0] * 4, "speed_max": [1e9] * 4, "acceleration_max": [1e15] * 4}
    wound = START + 0.02 * np.sin(np.linspace(0.0, 9.0, 300))[:, None] * np.ones(4)
    lengths, _ = follow(winches(length_hysteresis=wide, **fast), wound)
    start = np.full((1, 4), START)
    lagged = lagging_lengths(np.concatenate([start, wound])[:, None], wide[None])[1:, 0]
    assert lagged == pytest.approx(lengths, abs=1e-12)


def test_lengths_paid_out_reading_by_reading_are_those_of_all_readings():
    wide = np.array([1e-3, 2e-3, 0.0, 5e-3])
    wound = START + 0.02 * np.sin(np.linspace(0.0, 9.0, 60))[:, None, None] * np.ones((1, 3, 4))
    wound[:, 1] += 0.01 * np.cos(np.linspace(0.0, 20.0, 60))[:, None]
    one_by_one = PaidOutLengths.of(simple_robot(length_hysteresis=wide))
    found = np.array([one_by_one(each) for each in wound])
    assert np.array_equal(found, lagging_lengths(wound, np.tile(wide, (3, 1))))
    assert PaidOutLengths.of(simple_robot()) is None
