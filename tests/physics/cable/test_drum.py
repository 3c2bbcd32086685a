from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import carosac_toolkit as ct
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.cable.drum import Drums, drums_of
from carosac_toolkit.physics.motion.winch import Encoders, WinchSettings
from tests.robots import simple_robot

DRUMS = Drums(
    radius=np.array([0.076, 0.05, 0.1]),
    buildup=np.array([6.9e-5, 3e-5, 0.0]),
    gear=np.array([12.75, 1.0, 20.0]),
    advantage=np.array([2.0, 1.0, 4.0]),
)
LENGTHS = np.linspace(-0.5, 8.0, 18)[:, None] * np.ones(3)  # [m]


def test_angle_and_length_undo_each_other():
    assert DRUMS.length(DRUMS.motor_angle(LENGTHS)) == pytest.approx(LENGTHS, abs=1e-13)
    assert DRUMS.motor_angle(np.zeros(3)) == pytest.approx(np.zeros(3))


@pytest.mark.parametrize("k", range(3))
def test_a_drum_pays_out_its_radius_whose_square_falls_by_the_line_paid_out(k):
    """Integral of the law itself, with the line of a tackle and the turns of a gear."""
    radius, buildup = DRUMS.radius[k], DRUMS.buildup[k]
    turns = 100.0  # [rad] of the drum
    line = solve_ivp(
        lambda _, paid: np.sqrt(radius**2 - buildup * paid), (0.0, turns), [0.0],
        rtol=1e-12, atol=1e-12, method="DOP853",
    ).y[0, -1]  # fmt: skip
    angle = np.full(3, np.nan)
    angle[k] = turns * DRUMS.gear[k]
    assert DRUMS.length(angle)[k] == pytest.approx(line / DRUMS.advantage[k], rel=1e-10)


def test_the_encoders_of_simulated_winches_obey_the_same_law():
    robot = simple_robot(
        drum_radius=[0.08] * 4, drum_buildup=[7e-5] * 4, drum_gear=[12.75] * 4,
        drum_advantage=[2.0] * 4, length_max=[20.0] * 4,
    )  # fmt: skip
    lengths = np.array([[0.5, 3.0, 9.0, 20.0]])
    belief = WinchSettings(believed_drum_buildup=2e-5)
    reading = Encoders([robot], 1, belief).read(lengths)
    believed = drums_of(replace(robot, drum_buildup=[2e-5] * 4))
    assert reading == pytest.approx(believed.length(drums_of(robot).motor_angle(lengths)))
    assert np.abs(reading - lengths).max() > 1e-3


def test_without_build_up_it_is_a_drum_of_constant_radius():
    drums = replace(DRUMS, buildup=np.zeros(3))
    expected = DRUMS.radius * 50.0 / DRUMS.gear / DRUMS.advantage
    assert drums.length(np.full(3, 50.0)) == pytest.approx(expected, rel=1e-15)


def test_an_empty_drum_is_named_with_what_it_holds():
    lengths = np.array([[1.0, 80.0, 5.0], [1.0, 90.0, 1e6]])  # the last has no build-up
    most = 0.05**2 / 3e-5
    message = rf"unstrained_length\[1\]: got 90 m; allowed: less than the drum holds, {most:.6g} m"
    with pytest.raises(InvalidField, match=message):
        DRUMS.motor_angle(lengths)


@pytest.mark.parametrize("missing", ["drum_radius", "drum_buildup", "drum_gear"])
def test_a_robot_without_drums_is_named(missing):
    robot = replace(ct.load_robot("hangprinter"), **{missing: None})
    message = f"{missing}: got unknown for robot 'hangprinter'; allowed: a drum with radius"
    with pytest.raises(InvalidField, match=message):
        drums_of(robot)


def test_a_drum_without_a_tackle_pays_out_cable_as_line():
    robot = replace(ct.load_robot("hangprinter"), drum_advantage=None)
    assert drums_of(robot).advantage.tolist() == [1.0] * 4
