import numpy as np
import pytest

from carosac_toolkit.validation.time_shift import Signal, UnknownShift, find_shift

TIME = np.arange(0.0, 40.0, 0.02)


def motion(time):
    """Moves that do not repeat themselves."""
    waves = ((0.13, 0.0), (0.31, 1.0), (0.57, 2.0))
    return np.column_stack([
        sum(np.sin(2.0 * np.pi * f * time + phase * k) for f, phase in waves) for k in (1, 2, 3)
    ])  # fmt: skip


def signal(time, value, noise=0.01, seed=0):
    rng = np.random.default_rng(seed)
    return Signal(time=time, value=value + noise * rng.standard_normal(value.shape))


PREDICTED = signal(TIME, motion(TIME), noise=0.0)


def test_the_error_of_a_shift_is_chi_squared_by_its_sigma():
    squares = []
    for seed in range(20):
        late = signal(TIME + 1.237, motion(TIME), noise=0.05, seed=seed)
        found = find_shift(late, PREDICTED)
        squares.append(((found.seconds - 1.237) / found.sigma) ** 2)
    assert 0.4 < np.mean(squares) < 2.0


@pytest.mark.parametrize(
    ("scaling", "value"),
    [
        ("each", motion(TIME) * [1.2, 0.8, 3.0] + [5.0, -1.0, 0.0]),
        ("mixed", motion(TIME) @ np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])),
    ],
)
def test_constants_scales_and_mountings_need_not_be_known(scaling, value):
    found = find_shift(signal(TIME - 2.5, value), PREDICTED, scaling=scaling)
    assert found.seconds == pytest.approx(-2.5, abs=5.0 * found.sigma)
    assert found.sigma < 1e-3 and found.explained > 0.99


def test_clocks_of_other_days_are_compared_from_their_first_stamps():
    found = find_shift(signal(TIME + 1.7e5 + 0.8, motion(TIME)), PREDICTED)
    assert found.seconds == pytest.approx(1.7e5 + 0.8, abs=1e-3)


@pytest.mark.parametrize("start", [12.0, 22.0])
def test_a_channel_that_starts_late_by_the_same_clock_is_not_shifted(start):
    after = TIME >= start
    found = find_shift(signal(TIME[after], motion(TIME[after])), PREDICTED)
    assert found.seconds == pytest.approx(0.0, abs=1e-3)


def test_a_late_start_and_a_wrong_clock_that_fit_alike_are_refused():
    time = np.arange(0.0, 90.0, 0.05)
    circle = np.column_stack([np.sin(time * np.pi / 9.0), np.cos(time * np.pi / 9.0)])
    after = time > 15.0
    with pytest.raises(UnknownShift, match="the motion repeats itself"):
        find_shift(signal(time[after], circle[after]), signal(time, circle, noise=0.0))


@pytest.mark.parametrize("jitter", [0.0, 0.005])
def test_jitter_of_single_stamps_is_told_from_noise(jitter):
    rng = np.random.default_rng(3)
    wrong = TIME + jitter * rng.standard_normal(len(TIME))
    found = find_shift(signal(TIME, motion(wrong), noise=0.01), PREDICTED)
    assert found.jitter == pytest.approx(jitter, abs=max(4.0 * found.jitter_sigma, 2e-4))
    assert found.jitter_sigma < 1e-3


def test_values_without_any_noise_have_no_jitter():
    wave = np.where(TIME > 25.0, 0.0, np.sin(0.7 * TIME) + np.sin(0.31 * TIME))
    exact = Signal(time=TIME, value=np.column_stack([wave, 0.0 * wave, 0.0 * wave]))
    assert find_shift(exact, exact).jitter == 0.0


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        (np.zeros((len(TIME), 3)), "explain only"),
        (motion(TIME[::-1] ** 2), "explain only"),
    ],
)
def test_signals_that_share_no_motion_are_refused(value, reason):
    with pytest.raises(UnknownShift, match=reason):
        find_shift(signal(TIME, value), PREDICTED)


def test_a_motion_that_repeats_itself_is_refused():
    circle = np.column_stack([np.sin(np.pi * TIME), np.cos(np.pi * TIME), np.sin(np.pi * TIME)])
    with pytest.raises(UnknownShift, match="the motion repeats itself"):
        find_shift(signal(TIME, circle), signal(TIME, circle, noise=0.0))


def test_runs_that_hardly_overlap_are_refused():
    short = signal(TIME[:500] + 35.0, motion(TIME[:500] + 35.0))
    with pytest.raises(UnknownShift):
        find_shift(short, PREDICTED)
