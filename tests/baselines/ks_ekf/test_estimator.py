"""The filter on a swaying robot: accuracy, consistency, latency, lever arm, faults."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio
import pytest

import carosac_toolkit as ct
from baselines.ks_ekf import KsEkf, KsEkfSettings
from carosac_toolkit import conformance
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.loop.consistency import band
from carosac_toolkit.loop.values import Belief, Command, Imu, Measurement, Stamped
from carosac_toolkit.physics.rest import statics
from tests.baselines.ks_ekf.scenes import (
    STEPS,
    Run,
    beliefs,
    errors,
    nominal,
    rms,
    squares,
    swaying,
)

SEEDS = (0, 1, 2)
LOST = slice(60, 150)


def position_error(scene: Run, found: Sequence[Belief]) -> float:
    return rms(errors(scene, found)[:, :3])


@pytest.mark.parametrize("check", conformance.ESTIMATOR_CHECKS.values(), ids=lambda c: c.__name__)
@pytest.mark.parametrize("robot", ["carosac", "cogiro"])
def test_conformance(check, robot):
    check(KsEkf.build, ct.load_robot(robot))


@pytest.mark.parametrize("seed", SEEDS)
def test_sway_is_seen_that_the_solver_cannot_see(seed):
    scene = swaying(seed)
    tight = position_error(scene, nominal(scene))
    assert tight < 0.2 * scene.solver_error
    assert tight < 0.01
    if seed == 0:
        loose = position_error(scene, beliefs(scene, KsEkfSettings(coupling="loose")))
        assert tight < loose < 0.5 * scene.solver_error


def test_errors_are_as_large_as_the_covariance_says():
    matched = KsEkfSettings(length_walk=0.0)  # the plant is the model, its biases are constant
    scenes = [swaying(seed) for seed in SEEDS]
    found = [squares(scene, beliefs(scene, matched))[25:].mean() for scene in scenes]
    # Errors of a run go together, as biases are constant: hardly more than one sample each.
    low, high = band(12, len(SEEDS), level=0.95)
    assert low < np.mean(found) < high


def test_imu_off_the_origin_and_turned_gives_the_same_pose():
    whole = swaying(1, perfect=True)
    scene = whole.until(STEPS // 2)
    lever = np.array([0.15, -0.1, 0.2])
    turn = pinocchio.exp3(np.array([0.5, -1.0, 2.0]))
    samples = [m.imu for m, _, _ in scene.steps]
    rate = np.concatenate([s.angular_rate[0] for s in samples])
    spin = np.gradient(rate, 0.005, axis=0, edge_order=2)
    extra = np.cross(spin, lever) + np.cross(rate, np.cross(rate, lever))
    ends = np.cumsum([s.time.shape[1] for s in samples])

    def moved(k: int, measurement: Measurement) -> Measurement:
        imu = measurement.imu
        part = extra[ends[k] - imu.time.shape[1] : ends[k]]
        there = Imu(
            time=imu.time,
            angular_rate=imu.angular_rate @ turn,
            specific_force=(imu.specific_force + part) @ turn,
        )
        return replace(measurement, imu=there)

    mounted = KsEkfSettings(imu_position=lever, imu_rotation=turn)
    there = errors(scene, beliefs(scene, mounted, moved))
    here = errors(scene, nominal(whole)[: len(scene.steps)])
    assert rms((there - here)[:, :3]) < 1e-3
    assert rms((there - here)[:, 6:9]) < 5e-3


def test_late_lengths_count_for_their_own_time():
    whole = swaying(1, perfect=True)
    scene = whole.until(STEPS // 2)
    behind = 4

    def late(k: int, measurement: Measurement) -> Measurement:
        then = scene.steps[max(k - behind, 0)][0]
        lengths = then.unstrained_length
        return replace(measurement, unstrained_length=lengths, length_rate=then.length_rate)

    def unstamped(k: int, measurement: Measurement) -> Measurement:
        return replace(late(k, measurement), length_rate=None)

    prompt = position_error(scene, nominal(whole)[: len(scene.steps)])
    assert position_error(scene, beliefs(scene, edit=late)) < prompt + 2e-3
    assert position_error(scene, beliefs(scene, edit=unstamped)) > 5.0 * prompt

    delayed = replace(scene, robot=replace(scene.robot, length_delay=-0.08))

    def said_by_the_robot(k: int, measurement: Measurement) -> Measurement:
        then = late(k, measurement)
        stamp = Stamped(time=then.length_rate.time + 0.08, value=then.length_rate.value)
        return replace(then, length_rate=stamp)

    assert position_error(delayed, beliefs(delayed, edit=said_by_the_robot)) < prompt + 2e-3


@pytest.mark.parametrize(("lead", "cycles"), [(0.034, 2), (0.1, 5)])
def test_lengths_that_lead_the_platform_wait_for_it(lead, cycles):
    whole = swaying(0)
    scene = whole.leading(lead, cycles)
    prompt = position_error(scene, nominal(whole)[: len(scene.steps)])
    found = beliefs(scene)
    assert position_error(scene, found) < 1.2 * prompt
    assert all(belief.memory.state.time <= belief.time[0] + 1e-9 for belief in found)
    assert found[-1].memory.late == found[-1].memory.restarts == 0
    # The first counts at once, the others at the first measurement after their time, all in turn.
    used = [belief.innovations.dof[0] > 0 for belief in found]
    assert not any(used[: cycles + 1]) and all(used[cycles + 1 :])
    assert len(found[-1].memory.waiting) == cycles


def test_pose_of_rest_is_that_of_lengths_whose_time_has_come():
    whole = swaying(0).until(100)
    scene = whole.leading(0.1, 5)
    waiting, prompt = (
        beliefs(run, edit=lambda k, m: replace(m, imu=None)) for run in (scene, whole)
    )
    for k in range(5, len(scene.steps)):
        assert waiting[k].position == pytest.approx(prompt[k].position, abs=1e-6)
        assert waiting[k].twist == pytest.approx(prompt[k].twist, abs=1e-6)


def test_without_imu_it_is_the_pose_of_rest_and_comes_back():
    scene = swaying(1)

    def blind(k: int, measurement: Measurement) -> Measurement:
        return replace(measurement, imu=None) if LOST.start <= k < LOST.stop else measurement

    found = beliefs(scene, edit=blind, start=nominal(scene)[: LOST.start])
    memory = found[-1].memory
    assert memory.coasted == LOST.stop - LOST.start - 2  # up to 0.05 s are bridged
    assert memory.restarts == 1
    coasting = found[LOST.stop - 1]
    known = coasting.memory.state
    lengths = scene.steps[LOST.stop - 1][0].unstrained_length - known.length_bias
    rest = statics.forward_kinematics(scene.robot, lengths)
    assert coasting.position == pytest.approx(rest.position, abs=0.02)
    assert squares(scene, found)[LOST].mean() < 3.0
    usual = position_error(scene, nominal(scene))
    assert rms(errors(scene, found)[LOST.stop + 100 :, :3]) < 1.5 * usual


@pytest.mark.parametrize(
    ("cables", "duration"),
    [((0.5, -0.3, 0.4, -0.2), 1), ((0.5, -0.3, 0.4, -0.2), 50), ((0.5, 0.0, 0.0, 0.0), 50)],
)
def test_wrong_lengths_are_rejected_and_got_over(cables, duration):
    whole = swaying(2)
    end = LOST.start + duration
    scene = whole.until(end + 150)

    def corrupt(k: int, measurement: Measurement) -> Measurement:
        if not LOST.start <= k < end:
            return measurement
        return replace(
            measurement, unstrained_length=measurement.unstrained_length + np.array(cables)
        )

    found = beliefs(scene, edit=corrupt, start=nominal(whole)[: LOST.start])
    memory, error = found[-1].memory, errors(scene, found)
    usual = position_error(whole, nominal(whole))
    assert rms(error[end + 100 :, :3]) < 1.5 * usual
    assert memory.rejected >= duration and memory.restarts == 0
    assert np.all(memory.slid == 0.0)  # they came back
    assert rms(error[LOST.start : end, :3]) < 0.03  # the IMU goes on


@pytest.mark.parametrize("coupling", ["tight", "loose"])
def test_encoders_that_slip_move_nothing(coupling):
    """All four at once: a pose half a metre away fits them as well, and no gate tells it."""
    scene, slip = swaying(2), np.array([0.3, -0.25, 0.35, 0.03])
    settings = KsEkfSettings(coupling=coupling)

    def slipped(k: int, measurement: Measurement) -> Measurement:
        if k < LOST.start:
            return measurement
        return replace(measurement, unstrained_length=measurement.unstrained_length + slip)

    whole = beliefs(scene, settings)
    found = beliefs(scene, settings, edit=slipped, start=whole[: LOST.start])
    memory = found[-1].memory
    assert memory.slid == pytest.approx(slip, abs=5e-3) and memory.restarts == 0
    usual = position_error(scene, whole)
    assert rms(errors(scene, found)[LOST.start :, :3]) < 2.0 * usual
    known = memory.state.length_bias - whole[-1].memory.state.length_bias
    assert known == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("length", [7, 25])
def test_nonsense_that_ends_is_got_over(length):
    scene = swaying(2)
    rng = np.random.default_rng(length)

    def wrong(k: int, measurement: Measurement) -> Measurement:
        off = rng.uniform(-1.0, 1.0, 4) * (LOST.start <= k < LOST.start + length)
        return replace(measurement, unstrained_length=measurement.unstrained_length + off)

    found = beliefs(scene, edit=wrong)
    assert not found[-1].memory.slid.any()
    assert rms(errors(scene, found)[LOST.stop :, :3]) < 1.5 * position_error(scene, nominal(scene))


def test_a_wrong_first_measurement_is_got_over():
    scene = swaying(2)

    def wrong(k: int, measurement: Measurement) -> Measurement:
        off = 0.3 * (k == 0)
        return replace(measurement, unstrained_length=measurement.unstrained_length + off)

    found = beliefs(scene, edit=wrong)
    assert not found[-1].memory.slid.any()
    assert rms(errors(scene, found)[200:, :3]) < 3.0 * position_error(scene, nominal(scene))


@pytest.mark.parametrize("lost", [110, 125])
def test_encoders_that_slip_before_the_imu_is_lost_move_nothing_either(lost):
    """The slip is still in doubt then, and the last lengths that were used are old."""
    scene = swaying(2)

    def wrong(k: int, measurement: Measurement) -> Measurement:
        lengths = measurement.unstrained_length + 0.3 * (k >= LOST.start)
        imu = None if lost <= k < lost + 3 else measurement.imu
        return replace(measurement, unstrained_length=lengths, imu=imu)

    found = beliefs(scene, edit=wrong)
    error = np.linalg.norm(errors(scene, found)[:, :3], axis=1)
    blind = beliefs(scene, edit=lambda k, m: replace(m, imu=None) if lost <= k < lost + 3 else m)
    usual = np.linalg.norm(errors(scene, blind)[:, :3], axis=1)
    assert found[-1].memory.slid == pytest.approx(0.3, abs=5e-3)
    assert error.max() < 2.0 * usual.max() + 0.02


def test_lengths_that_never_fit_still_hold_the_state():
    """Centimetres of model error for 3 s, and an IMU whose bias has changed: no drift."""
    scene = swaying(2)

    def wrong(k: int, measurement: Measurement) -> Measurement:
        lean = 0.1 * np.clip((k - LOST.start) / 10.0, 0.0, 1.0)  # [m/s^2]
        off = np.array([0.03, -0.02, 0.03, 0.04]) * np.sin(0.9 * k) ** 2 * (k >= LOST.start)
        force = measurement.imu.specific_force + np.array([lean, -lean, 0.0])
        return replace(
            measurement, unstrained_length=measurement.unstrained_length + off,
            imu=replace(measurement.imu, specific_force=force),
        )  # fmt: skip

    seen = scene.until(LOST.stop + 60)
    found = beliefs(seen, edit=wrong)
    assert found[-1].memory.rejected > 100 and found[-1].memory.restarts == 0
    assert np.linalg.norm(errors(seen, found)[:, :3], axis=1).max() < 0.1  # 0.23 where rejected


def test_one_cable_that_creeps_away_is_left_out():
    """No reading is one that its winch could not have wound, but the other cables contradict."""
    scene = swaying(2)

    def creeping(k: int, measurement: Measurement) -> Measurement:
        off = np.array([0.5 * np.clip((k - LOST.start) / 50.0, 0.0, 1.0), 0.0, 0.0, 0.0])
        return replace(measurement, unstrained_length=measurement.unstrained_length + off)

    found = beliefs(scene, edit=creeping)
    assert found[-1].memory.excluded >= 50 and np.all(found[-1].memory.slid == 0.0)
    assert rms(errors(scene, found)[LOST.start : LOST.stop, :3]) < 0.05


def test_lengths_alone_give_the_solver_and_an_honest_covariance():
    scene = swaying(0)
    found = beliefs(scene, edit=lambda k, m: replace(m, imu=None))
    assert found[-1].memory.coasted == STEPS - 1
    assert position_error(scene, found) == pytest.approx(scene.solver_error, rel=0.1)
    assert 0.1 < squares(scene, found)[25:].mean() < 3.0


def test_rest_is_found_and_gives_the_biases():
    scene = swaying(0)
    measurement = scene.steps[0][0]
    estimator = KsEkf.build(scene.robot)
    bias, time = np.array([0.01, -0.008, 0.005]), np.arange(1, 151) * 0.02
    belief = estimator.reset(measurement)
    rest = statics.forward_kinematics(scene.robot, measurement.unstrained_length)
    force = rest.rotation[0].T @ [0.0, 0.0, 9.81]
    rng = np.random.default_rng(0)
    for now in time:
        when = now - 0.015 + 0.005 * np.arange(4)
        imu = Imu(
            time=when[None],
            angular_rate=(bias + 3.5e-3 * rng.standard_normal((4, 3)))[None],
            specific_force=(force + 0.017 * rng.standard_normal((4, 3)))[None],
        )
        lengths = measurement.unstrained_length
        rate = Stamped(time=[now - 0.01] * np.ones(1), value=0.0 * lengths)
        new = replace(measurement, time=now * np.ones(1), imu=imu, length_rate=rate)
        belief = estimator.update(belief, Command(time=new.time, unstrained_length=lengths), new)
    assert belief.memory.resting
    assert belief.memory.state.rate_bias == pytest.approx(bias, abs=3e-3)  # prior 5e-3
    assert np.linalg.norm(belief.twist[0]) < 0.01
    assert belief.position == pytest.approx(rest.position, abs=0.01)


@pytest.mark.parametrize(("gap", "coasted"), [(0.05, True), (0.2, False)])
def test_the_last_inertial_sample_bridges_a_gap_of_the_length_that_is_set(gap, coasted):
    scene = swaying(1).until(STEPS // 4)
    blind = range(40, 45)  # 0.1 s

    def edit(k: int, measurement: Measurement) -> Measurement:
        return replace(measurement, imu=None) if k in blind else measurement

    memory = beliefs(scene, KsEkfSettings(imu_gap=gap), edit)[-1].memory
    assert (memory.coasted > 0) == coasted


@pytest.mark.parametrize(("jump", "rejected"), [(0.05, 0), (0.02, 1)])
def test_lengths_that_jump_farther_than_is_set_are_held_back(jump, rejected):
    scene = swaying(1).until(STEPS // 4)

    def edit(k: int, measurement: Measurement) -> Measurement:
        lengths = measurement.unstrained_length
        step = scene.robot.speed_max[0] * 0.02 + 0.03
        before = scene.steps[k - 1][0].unstrained_length[0, 0]
        jumped = np.where(np.arange(len(lengths[0])) == 0, before + step, lengths)
        return replace(measurement, unstrained_length=jumped) if k == 50 else measurement

    found = beliefs(scene, KsEkfSettings(reading_jump=jump, gate=1.0 - 1e-12), edit)
    assert found[52].memory.encoders.rejected == rejected


def test_innovations_are_as_large_as_expected_and_counted():
    still = KsEkfSettings(tension_change=0.0)  # these cables have no motion of their own
    scene = swaying(1).until(STEPS // 2)
    found = [belief.innovations for belief in beliefs(scene, still)]
    share = sum(i.squares[0] for i in found) / sum(i.dof[0] for i in found)
    assert 0.2 < share < 1.5


def test_a_belief_can_be_updated_again():
    scene = swaying(0)
    estimator = KsEkf.build(scene.robot)
    first, second = scene.steps[0][0], scene.steps[1][0]
    start = estimator.reset(first)
    command = Command(time=second.time, unstrained_length=second.unstrained_length)
    one, two = (estimator.update(start, command, second) for _ in range(2))
    assert (one.position == two.position).all()
    assert (one.covariance == two.covariance).all()


def test_other_beliefs_and_earlier_measurements_are_refused():
    scene = swaying(0)
    estimator = KsEkf.build(scene.robot)
    first, _, solver = scene.steps[0]
    later = scene.steps[5][0]
    command = Command(time=first.time, unstrained_length=first.unstrained_length)
    with pytest.raises(CarosacError, match="not from this estimator"):
        estimator.update(solver, command, later)
    belief = estimator.update(estimator.reset(first), command, later)
    with pytest.raises(InvalidField, match=r"measurement\.time"):
        estimator.update(belief, command, first)
    both = np.concatenate([first.unstrained_length] * 2)
    with pytest.raises(InvalidField, match="one robot at a time"):
        estimator.reset(Measurement(time=np.zeros(2), unstrained_length=both))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("coupling", "medium"),
        ("length_noise", 0.0),
        ("gate", 1.0),
        ("misfit_time", 0.0),
        ("imu_rotation", 2.0 * np.eye(3)),
        ("imu_position", np.zeros(2)),
        ("sway", np.nan),
    ],
)
def test_settings_out_of_range_are_refused(name, value):
    with pytest.raises(InvalidField, match=name):
        KsEkfSettings(**{name: value})
