"""The sag of a cable whose tension changes, against the string integrated finely."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from baselines.ks_ekf.cable_swing import CableStrings, CableSwing

STEP = 0.02  # [s] between two readings
LONG = 1e9  # [s]: no damping
CABLE = CableStrings(
    length=np.array([6.0]), tension=np.array([15.0]), density=np.array([6e-3]),
    weight=np.array([0.058]),
)  # fmt: skip


def under(tension: float) -> CableStrings:
    return replace(CABLE, tension=np.array([tension]))


def ramp(time: float, low: float, high: float, rise: float) -> float:
    """Tension that rises from one to the other [N], smoothly, within a time [s]."""
    share = np.clip(time / rise, 0.0, 1.0)
    return float(low + (high - low) * 0.5 * (1.0 - np.cos(np.pi * share)))


def amplitude(swing: CableSwing, tension: float) -> float:
    now = under(tension)
    return float(np.hypot(swing.sag - now.sag, swing.speed / now.pace)[0])


def followed(low: float, high: float, rise: float) -> CableSwing:
    """Swing after a rise of the tension, heard of in every reading."""
    swing = CableSwing().later(0.0, under(low), LONG)
    for time in np.arange(STEP, rise + STEP, STEP):
        swing = swing.later(time, under(ramp(time - 0.5 * STEP, low, high, rise)), LONG)
    return swing


def amplitude_of_string(low: float, high: float, rise: float) -> float:
    """Of the same string after the same rise, integrated finely [m]."""

    def slope(time: float, state: np.ndarray) -> list[float]:
        now = under(ramp(time, low, high, rise))
        return [state[1], now.pace[0] ** 2 * (now.sag[0] - state[0])]

    end = rise + 2.0
    start = [float(under(low).sag[0]), 0.0]
    found = solve_ivp(slope, (0.0, end), start, rtol=1e-8, atol=1e-10, dense_output=True)
    return 0.5 * float(np.ptp(found.sol(np.linspace(rise, end, 4000))[0]))


@pytest.mark.parametrize("rise", [0.1, 0.3, 1.0])
@pytest.mark.parametrize("low", [1.0, 3.0])
def test_what_a_rise_leaves_is_what_the_string_does(low, rise):
    found = amplitude(followed(low, 20.0, rise), 20.0)
    assert found == pytest.approx(amplitude_of_string(low, 20.0, rise), rel=0.15)


def test_a_slow_rise_leaves_hardly_any_swing():
    quick, slow = (amplitude(followed(5.0, 20.0, rise), 20.0) for rise in (0.1, 5.0))
    assert slow < 0.05 * quick


def test_a_slowly_changing_tension_keeps_the_action():
    """Energy over frequency, a^2 f / l over sqrt(f): the amplitude goes with f^(-1/4)."""
    swing = followed(2.0, 15.0, 0.1)
    more = swing
    for k, tension in enumerate(np.linspace(15.0, 60.0, 500)):
        more = more.later(swing.time + STEP * (k + 1), under(tension), LONG)
    expected = amplitude(swing, 15.0) * (60.0 / 15.0) ** -0.25
    assert amplitude(more, 60.0) == pytest.approx(expected, rel=0.1)


def test_one_wrong_reading_leaves_little_of_what_a_second_leaves():
    def after(held: float) -> float:
        swing = CableSwing().later(0.0, under(15.0), 2.0)
        for time in np.arange(STEP, held + 0.5 * STEP, STEP):
            swing = swing.later(time, under(0.35), 2.0)
        return float(swing.later(held + STEP, under(15.0), 2.0).taken(under(15.0))[0])

    assert after(STEP) < 0.02 * after(0.5)


def test_a_swing_fades_and_rest_takes_nothing():
    swing = followed(1.0, 15.0, 0.1)
    taken = [swing.later(swing.time + t, under(15.0), 2.0).taken(under(15.0))[0] for t in (0, 20)]
    assert taken[0] > 1e-3
    assert taken[1] < 1e-3 * taken[0]
    assert CableSwing().later(0.0, CABLE, 2.0).taken(CABLE) == pytest.approx(0.0)


def test_a_tension_that_shakes_at_twice_the_pace_does_not_pump_without_end():
    """A linear string would swing by metres after some seconds."""
    length, density = 9.0, 0.01
    pace = np.pi / length * np.sqrt(80.0 / density)
    swing, most = CableSwing(), 0.0
    for k in range(2000):
        time = 0.01 * k
        tension = 80.0 * (1.0 + 0.9 * np.sin(2.0 * pace * time))
        strings = CableStrings(
            length=np.array([length]),
            tension=np.array([tension]),
            density=np.array([density]),
            weight=np.array([9.81 * density]),
        )
        swing = swing.later(time, strings, 2.0)
        most = max(most, float(np.hypot(swing.sag - strings.sag, swing.speed / strings.pace)[0]))
    slackest = 9.81 * density * length**2 / (8.0 * 8.0)
    assert 0.2 * slackest < most <= slackest
