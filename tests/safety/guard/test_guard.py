from __future__ import annotations

import asyncio
import errno
import signal
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from carosac_toolkit import trajectories
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.conformance.drivers import DRIVER_CHECKS
from carosac_toolkit.drivers.quasi_static import QuasiStaticSettings
from carosac_toolkit.loop.drive_state import DriveState, Fault
from carosac_toolkit.loop.loop import BadPlugin, run
from carosac_toolkit.loop.values import Belief, Command, Stamped
from carosac_toolkit.plc.guarded import GuardedAds, GuardedAdsSettings
from carosac_toolkit.safety.guard import GuardedDriver, GuardSettings, IllegalTransition, NotReady
from tests.safety.guard.guards import (
    PERIOD,
    ROBOT,
    FailingDriver,
    Notes,
    ask,
    connected,
    drive,
    guarded,
    home_state,
    lengths_at,
    standing,
    to_the_end,
    within_limits,
)


class Holding:
    """An estimator that believes home, and a controller that asks for the lengths of a place."""

    period, horizon = PERIOD, 0.0

    def __init__(self, fails_at=None, error=None, drift=0.0):
        self.calls, self.fails_at, self.error, self.drift = 0, fails_at, error, drift

    def _belief(self, measurement):
        place = ROBOT.home_position + np.array([self.drift * self.calls, 0.0, 0.0])
        return Belief(
            time=measurement.time, position=place[None], rotation=ROBOT.home_rotation[None]
        )

    def reset(self, thing):
        return self._belief(thing) if hasattr(thing, "unstrained_length") else None

    def update(self, belief, command, measurement):
        return self._belief(measurement)

    def command(self, belief, reference):
        self.calls += 1
        if self.calls == self.fails_at and self.error is not None:
            raise self.error
        factor = np.nan if self.calls == self.fails_at else 1.0
        lengths = lengths_at(reference.position[0, 0])
        return Command(time=belief.time, unstrained_length=factor * lengths)


def path():
    end = ROBOT.home_position + np.array([0.4, 0.0, 0.0])
    return trajectories.line(ROBOT.home_position, end, speed_max=0.4, acceleration_max=0.8)


# --- Lifecycle ------------------------------------------------------------------------------------


def test_without_motion_a_run_is_dry_and_the_drives_see_no_command():
    guard = connected(motion=False)
    start = standing(guard)
    for _ in range(5):
        alive, sent = ask(guard, start + 0.05)
        assert alive
        assert "not_enabled" in {hit.limit for hit in sent.limited}
        assert sent.unstrained_length == pytest.approx(start, abs=2e-3)
    assert guard.inner.seen == []
    would = [sent for _, sent, really in guard.journal.commands if not really]
    assert len(would) == 5
    assert abs(would[-1].unstrained_length - start).max() < 0.05  # within the limits, on its way
    guard.close()


def test_a_dry_run_says_what_would_be_a_fault():
    guard = connected(motion=False)
    ask(guard, standing(guard) + 0.5)
    assert guard.refused == {"command": 1}
    assert guard.fault is None
    guard.close()


def test_each_step_is_refused_where_it_is_not_legal():
    guard = guarded(at_once=False)
    for step in (guard.enable, guard.disable, guard.reset_fault, lambda: guard.home(home_state())):
        with pytest.raises(IllegalTransition, match="the drive system is disconnected"):
            step()
    guard.connect()
    with pytest.raises(IllegalTransition, match=r"enable: .* is connected; allowed: when homed"):
        guard.enable()
    guard.home(home_state())
    guard.enable()
    with pytest.raises(IllegalTransition, match="home: the drive system is enabled"):
        guard.home(home_state())
    guard.close()
    assert guard.state is DriveState.DISCONNECTED


def test_enabling_needs_the_purpose_to_move():
    guard = connected(motion=False)
    guard.home(home_state())
    with pytest.raises(NotReady, match="read only; set motion=True"):
        guard.enable()
    guard.close()


def test_homing_takes_the_constant_error_of_each_encoder_away():
    guard = connected(at_once=False)
    truth = guard.truth().unstrained_length
    assert abs(standing(guard) - truth).max() > 2e-3  # the bias that was drawn
    guard.home(home_state())
    assert standing(guard) == pytest.approx(truth, abs=1e-3)  # noise of the encoders
    guard.close()


def test_homing_and_enabling_need_winches_that_stand_still():
    guard = connected(at_once=False)
    original = guard.inner.measure
    moved = iter(np.arange(0.0, 1.0, 0.002))

    def moving():
        found = original()
        return replace(found, unstrained_length=found.unstrained_length + next(moved))

    guard.inner.measure = moving
    with pytest.raises(NotReady, match=r"do not stand still: 0\.01.* m of change"):
        guard.home(home_state())
    guard.close()


def test_enabling_moves_nothing_and_the_first_command_must_be_near():
    guard = connected()
    start = standing(guard)
    assert guard.state is DriveState.ENABLED
    for _ in range(5):
        assert guard.wait(PERIOD)
    assert np.array(guard.inner.seen) == pytest.approx(
        np.tile(guard.inner.seen[0], (5, 1)), abs=1e-12
    )
    alive, sent = ask(guard, start + np.array([[0.0, 0.2, 0.0, 0.0]]))
    assert not alive
    assert guard.fault.fault is Fault.COMMAND
    assert guard.fault.cable == ROBOT.cable_names[1]
    assert "the first command is 0.2" in guard.fault.text
    assert sent.unstrained_length == pytest.approx(start, abs=2e-3)
    guard.close()


def test_disabling_brakes_and_it_can_be_enabled_again():
    guard = connected()
    drive(guard, 40)
    guard.disable()
    assert guard.state is DriveState.HOMED
    assert within_limits(guard.inner.seen)
    guard.enable()
    drive(guard, 10)
    guard.stop("done")
    guard.close()


# --- Commands -------------------------------------------------------------------------------------


def test_a_command_within_the_limits_passes_and_the_others_are_named():
    guard = connected()
    start = standing(guard)
    ask(guard, start)
    _, sent = ask(guard, start + 0.05)
    assert {hit.limit for hit in sent.limited} & {"acceleration", "jerk"}
    assert within_limits(guard.inner.seen)
    guard.close()


def test_a_slow_run_bounds_the_winches_and_how_far_a_command_may_be():
    guard = connected(speed_max=0.1)
    start = standing(guard)
    home = ROBOT.home_position
    away = lengths_at(home + np.array([0.04, 0.06, 0.04])) - lengths_at(home)
    for _ in range(80):
        assert ask(guard, start + away)[0], guard.fault
    rate = np.abs(np.diff(guard.inner.seen, axis=0)) / PERIOD
    assert 0.099 < rate.max() < 0.1 * (1 + 1e-6)  # never faster, and as fast as allowed
    assert standing(guard) == pytest.approx(start + away, abs=3e-3)
    assert guard.fault is None
    assert not ask(guard, start + away + 0.12)[0]  # 0.1 m, and 0.1 s behind
    assert guard.fault.fault is Fault.COMMAND
    assert "allowed: 0.11 m" in guard.fault.text
    guard.close()
    assert within_limits(guard.inner.seen, robot=replace(ROBOT, speed_max=np.full(4, 0.1)))


@pytest.mark.parametrize(
    "lengths, said",
    [
        (lambda start: start + 1.5, "is 1.5"),
        (lambda start: 0.0 * start + 45.0, "45.000 m asked; allowed: 0.1 m to 40 m"),
    ],
)
def test_a_command_out_of_range_never_reaches_the_drives(lengths, said):
    guard = connected()
    asked = drive(guard, 20)
    alive, sent = ask(guard, lengths(asked))
    assert not alive
    assert guard.fault.fault is Fault.COMMAND
    assert said in guard.fault.text
    assert "command" in {hit.limit for hit in sent.limited}
    guard.stop("fault")
    assert within_limits(guard.inner.seen)
    assert abs(np.array(guard.inner.seen) - asked).max() < 0.2
    guard.close()


def test_numbers_that_are_none_are_refused_even_past_the_check_of_values():
    guard = connected()
    asked = drive(guard, 20)
    command = Command(time=np.zeros(1), unstrained_length=asked)
    object.__setattr__(command, "unstrained_length", np.full((1, 4), np.nan))
    guard.measure()
    sent = guard.command(command)
    assert guard.fault.fault is Fault.COMMAND
    assert np.isfinite(sent.unstrained_length).all()
    assert np.isfinite(guard.inner.seen).all()
    guard.close()


def test_another_number_of_cables_is_refused():
    guard = connected()
    with pytest.raises(InvalidField, match=r"unstrained_length: got shape \(1, 3\)"):
        ask(guard, np.ones((1, 3)))
    guard.close()


# --- Faults ---------------------------------------------------------------------------------------


def jump(inner):
    inner.jump = 0.05


def freeze(inner):
    inner.freeze()


def trip(inner):
    inner.trip = True


def lose(inner):
    inner.lost = True


def slip(inner):
    """A reading that drifts too slowly for a jump, with a drive that sees nothing of it."""
    original, steps = inner.measure, iter(np.arange(0.0, 5.0, 0.005))

    def slipping():
        found = original()
        wrong = np.array([[next(steps), 0.0, 0.0, 0.0]])
        return replace(found, unstrained_length=found.unstrained_length + wrong)

    inner.measure = slipping


@pytest.mark.parametrize(
    "cause, fault, changes",
    [
        (jump, Fault.ENCODER_JUMP, {}),
        (freeze, Fault.STALE_DATA, {}),
        (trip, Fault.DRIVE_TRIP, {}),
        (slip, Fault.FOLLOWING_ERROR, {}),
        (slip, Fault.CLOSURE, {"following_max": 9.0}),
    ],
)
def test_a_fault_is_named_and_all_cables_come_to_rest_within_the_limits(cause, fault, changes):
    guard = connected(**changes)
    drive(guard, 40)
    cause(guard.inner)
    cycles = to_the_end(guard)
    assert guard.fault.fault is fault
    assert guard.state is DriveState.FAULT
    guard.stop("fault")
    assert within_limits(guard.inner.seen)
    seen = np.array(guard.inner.seen)
    assert seen[-1] == pytest.approx(seen[-2], abs=1e-12)  # at rest
    assert cycles * PERIOD < 1.0
    with pytest.raises(IllegalTransition, match=f"fault \\({fault}\\); allowed: when homed"):
        guard.enable()
    guard.close()


def test_samples_that_come_late_while_it_brakes_are_no_jump():
    """The motion since the newest sample is that of faster cycles than the present one."""
    guard = connected(following_max=9.0, direction_max=9.0, closure_max=9.0)
    drive(guard, 40, speed=1.5)
    original, kept = guard.inner.measure, []

    def late():
        kept.append(original())
        shown = kept[1] if 2 < len(kept) <= 6 else kept[-1]  # four periods without a sample
        return replace(shown, time=kept[-1].time)

    guard.inner.measure = late
    guard.stop("SIGINT")
    assert len(kept) > 8
    assert guard.fault is None, guard.fault
    guard.close()


class SilentDriver(FailingDriver):
    """A robot behind a link: once `since` is set no sample comes, while the clock goes on."""

    lost_after, since = 0.5, None  # [s]

    def measure(self):
        if self.since is None:
            return super().measure()
        return replace(self.since, time=FailingDriver.measure(self).time)

    @property
    def silent(self):
        return self.since is not None and (
            FailingDriver.measure(self).time[0] - self.since.time[0] > self.lost_after
        )

    def status(self):
        return str(DriveState.FAULT) if self.silent else super().status()

    @property
    def fault(self):
        return Fault.LOST_CONNECTION if self.silent else super().fault


def test_a_silent_link_is_a_lost_connection_once_its_patience_ends_and_no_fault_of_the_controller():
    """Also where the platform is so fast that its winches have left their last samples far."""
    inner = SilentDriver.build(ROBOT, QuasiStaticSettings(period=PERIOD), seed=1)
    settings = GuardSettings(driver="quasi_static", period=PERIOD, motion=True, step_max=0.08)
    guard = GuardedDriver(inner, ROBOT, settings, real_time=False)
    guard.journal = Notes()
    guard.connect()
    drive(guard, 10, speed=1.0)
    inner.since = FailingDriver.measure(inner)
    begin, asked = float(inner.since.time[0]), standing(guard)
    lead = lengths_at(ROBOT.home_position) - lengths_at(
        ROBOT.home_position + np.array([PERIOD, 0.0, 0.0])
    )
    while guard.wait(PERIOD):
        asked = asked - lead  # 1 m/s
        guard.command(Command(time=guard.measure().time, unstrained_length=asked))
    assert guard.fault.fault is Fault.LOST_CONNECTION, guard.fault
    assert guard.fault.time - begin == pytest.approx(inner.lost_after, abs=2.0 * PERIOD)
    assert np.abs(asked - standing(guard)).max() > settings.step_max + 0.02


def test_lost_measurements_are_a_lost_connection():
    guard = connected()
    drive(guard, 40)
    guard.inner.lost = True
    with pytest.raises(CarosacError, match="the cable is out"):
        guard.measure()
    assert guard.fault.fault is Fault.LOST_CONNECTION
    guard.close()


def test_tension_outside_its_limits_is_a_fault():
    guard = connected()
    drive(guard, 5)
    guard.monitor.checks.robot = replace(ROBOT, tension_max=np.full(4, 30.0))
    to_the_end(guard)
    assert guard.fault.fault is Fault.TENSION
    assert "N estimated; allowed: 5 N to 30 N" in guard.fault.text
    guard.close()


def test_leaving_the_workspace_is_a_fault():
    small = replace(ROBOT, workspace_max=ROBOT.home_position + 0.01)
    guard = connected(robot=small, workspace_margin=0.05)
    start, down = standing(guard), np.array([[1.0, 1.0, -1.0, -1.0]])
    for k in range(200):
        if not ask(guard, start + 0.1 * PERIOD * k * down)[0]:
            break
    assert guard.fault.fault is Fault.WORKSPACE
    assert "outside the workspace box" in guard.fault.text
    guard.close()


def test_the_emergency_stop_is_a_status():
    guard = connected()
    drive(guard, 10)
    guard.inner.estop = True
    to_the_end(guard)
    assert guard.status() == "estop"
    assert "emergency stop" in guard.fault.text
    with pytest.raises(CarosacError, match="still there"):
        guard.reset_fault()
    guard.inner.estop = False
    guard.reset_fault()
    assert guard.status() == "homed"
    guard.close()


def test_a_fault_stays_until_it_is_reset_and_its_cause_is_gone():
    guard = connected()
    drive(guard, 20)
    guard.inner.trip = True
    to_the_end(guard)
    with pytest.raises(CarosacError, match="still there"):
        guard.reset_fault()
    assert guard.fault.fault is Fault.DRIVE_TRIP
    guard.inner.trip = False
    guard.reset_fault()
    assert guard.state is DriveState.HOMED
    assert guard.fault is None
    guard.enable()
    drive(guard, 10)
    guard.close()


def test_after_an_encoder_jump_the_robot_must_be_homed_anew():
    guard = connected()
    drive(guard, 20)
    guard.inner.jump = 0.05
    to_the_end(guard)
    guard.reset_fault()
    assert guard.state is DriveState.CONNECTED
    guard.home(home_state())
    assert guard.state is DriveState.HOMED
    guard.close()


def test_a_jump_after_another_fault_takes_the_homing_too():
    for seen in (True, False):  # between the fault and its reset, or just before the reset
        guard = connected()
        drive(guard, 20)
        guard.inner.trip = True
        to_the_end(guard)
        assert guard.fault.fault is Fault.DRIVE_TRIP
        guard.stop("fault")
        for _ in range(2):
            guard.measure()
        guard.inner.jump = 0.05
        if seen:
            guard.measure()
        guard.inner.trip = False
        guard.reset_fault()
        assert guard.state is DriveState.CONNECTED
        with pytest.raises(IllegalTransition, match="allowed: when homed"):
            guard.enable()
        guard.close()


def test_drives_that_no_longer_follow_are_a_fault():
    guard = connected()
    drive(guard, 20)
    guard.inner.told = DriveState.CONNECTED
    to_the_end(guard)
    assert guard.fault.fault is Fault.DRIVE_TRIP
    assert "no longer follow: they are connected" in guard.fault.text
    guard.close()


@pytest.mark.parametrize(
    "error, fault",
    [
        (InvalidField("unstrained_length[0]", "nan", "finite"), Fault.ENCODER_JUMP),
        (InvalidField("tension[0]", "nan", "finite"), Fault.TENSION),
        (RuntimeError("a kernel failed"), Fault.LOST_CONNECTION),
    ],
)
def test_whatever_measuring_raises_is_latched_and_the_winches_brake_blind(error, fault):
    guard = connected()
    drive(guard, 40)
    inner = guard.inner
    inner.told = error
    with pytest.raises(type(error)):
        guard.measure()
    assert guard.fault.fault is fault
    guard.stop("fault")
    seen = np.array(inner.seen)
    assert seen[-1] == pytest.approx(seen[-2], abs=1e-12)  # at rest
    assert within_limits(seen)
    assert inner.disables == 1
    assert "cycles unseen" in dict(x[1:] for x in guard.journal.events)["at_rest"]
    guard.close()
    assert inner.closes == 1


def test_an_error_of_any_kind_in_a_stop_leaves_nothing_enabled_or_open():
    guard = connected(real_time=True, overrun_share=1.0, hang_time=60.0, warm_up=1)
    drive(guard, 5)
    inner = guard.inner

    def broken(*_):
        raise KeyboardInterrupt

    guard.brake.to_rest = broken
    with pytest.raises(KeyboardInterrupt):
        guard.close()
    assert (inner.disables, inner.closes) == (1, 1)
    assert guard.state is DriveState.DISCONNECTED
    guard.close()
    guard = connected()
    drive(guard, 5)
    guard.inner.disable = guard.commander.brake = lambda *_: 1 / 0
    guard.stop("done")
    guard.close()
    assert guard.inner.closes == 1


def test_a_journal_that_raises_anything_keeps_no_command_from_being_sent():
    guard = connected()
    drive(guard, 40)
    told = []

    def closed(*_, **__):
        told.append(len(guard.inner.seen))
        raise ValueError("I/O operation on closed file")

    guard.journal.event = guard.journal.sent = guard.journal.measured = closed
    before = len(guard.inner.seen)
    guard.stop("done")
    assert told == [before]  # the row of the first command of the stop comes before it
    seen = np.array(guard.inner.seen)
    assert seen[-1] == pytest.approx(seen[-2], abs=1e-12)
    assert within_limits(seen)
    assert "the recording failed: ValueError" in guard.fault.text
    guard.close()


def test_a_watchdog_that_cannot_brake_tells_the_driver_and_goes_on():
    guard = guarded(real_time=True, hang_time=60.0, overrun_share=1.0, warm_up=1)
    guard.connect()
    drive(guard, 20)
    missed, twice = [], threading.Event()

    def broken():
        missed.append(guard.inner.stops)
        if len(missed) > 1:
            twice.set()
        raise RuntimeError("a bug")

    guard.watchdog.miss = broken
    assert twice.wait(10.0)
    assert missed[:2] == [0, 1]
    assert guard.fault.fault is Fault.LOST_CONNECTION
    guard.close()
    assert not [x for x in threading.enumerate() if x.name == "guard watchdog"]


def test_homing_far_from_the_present_offsets_must_be_meant():
    guard = connected(at_once=False)
    wrong = replace(home_state(), position=ROBOT.home_position[None] + np.array([0.5, 0.0, 0.0]))
    before = standing(guard)
    with pytest.raises(NotReady, match=r"cable '\w+' would change by [+-]0\.\d+ m; allowed: 0.1 m"):
        guard.home(wrong)
    assert guard.state is DriveState.CONNECTED
    assert standing(guard) == pytest.approx(before, abs=2e-3)
    with pytest.raises(NotReady, match=r"encoders alone do not show .* --home-confirmed"):
        guard.home(wrong, anew=True)
    assert guard.state is DriveState.CONNECTED
    guard.home(wrong, anew=True, confirmed=True)
    assert guard.state is DriveState.HOMED
    assert guard.home_change == pytest.approx((lengths_at(wrong.position[0]) - before)[0], abs=2e-3)
    guard.close()
    with pytest.raises(NotReady, match="home anew"):
        at_once = guarded(start_position=tuple(wrong.position[0]))
        at_once.connect()
    assert at_once.state is DriveState.DISCONNECTED
    with pytest.raises(NotReady, match="encoders alone"):
        connected(start_position=tuple(wrong.position[0]), home_anew=True)
    connected(start_position=tuple(wrong.position[0]), home_anew=True, home_confirmed=True).close()


@pytest.mark.parametrize("reset", [False, True], ids=["at once", "after a fault"])
def test_the_first_way_from_a_new_home_is_gone_slowly_whatever_is_asked_for(reset):
    guard = connected(at_once=False)
    guard.monitor.offset = np.full(4, 0.5)
    guard.monitor.restart_checks()
    guard.home(home_state(), anew=True, confirmed=True)
    guard.enable()
    if reset:
        guard.inner.trip = True
        to_the_end(guard)
        guard.inner.trip = False
        guard.reset_fault()
        guard.home(home_state())  # no new home, but nobody has seen the last one prove right
        guard.enable()
    since = len(guard.inner.seen)
    for _ in range(150):
        asked = lengths_at(guard.truth().position[0] + np.array([0.02, 0.0, 0.0]))
        alive, sent = ask(guard, asked)
        assert alive, guard.fault
        assert guard.monitor.checks.first_way == ("first_way" in {h.limit for h in sent.limited})
        if not guard.monitor.checks.first_way:
            break
    assert np.linalg.norm(guard.truth().position[0] - ROBOT.home_position) > 0.09
    rates = np.abs(np.diff(guard.inner.seen[since:-1], axis=0)) / PERIOD
    assert 0.07 < rates.max() < 0.0751
    drive(guard, 40, speed=0.5)
    assert within_limits(guard.inner.seen[since:])
    assert (np.abs(np.diff(guard.inner.seen[since:], axis=0)) / PERIOD).max() > 0.15
    guard.close()


def test_a_dry_run_rehearses_homing_and_what_enabling_checks_and_sends_nothing():
    guard = connected(motion=False, rehearse=True)
    assert guard.state is DriveState.HOMED
    truth = guard.truth().unstrained_length
    assert standing(guard) == pytest.approx(truth, abs=1e-3)  # the offsets are found
    assert np.abs(guard.home_change).max() > 2e-3
    guard.inner.jump = 0.5  # a cable that slips shows in the pose
    to_the_end(guard)
    assert guard.fault.fault is Fault.ENCODER_JUMP
    guard.close()
    wrong = tuple(ROBOT.home_position + np.array([0.5, 0.0, 0.0]))
    with pytest.raises(NotReady, match="home: the offset of cable"):
        connected(motion=False, rehearse=True, start_position=wrong)
    guard = guarded(motion=False, rehearse=True)
    original = guard.inner.measure

    def overloaded():
        found = original()
        return replace(found, tension=Stamped(time=found.time, value=np.full((1, 4), 900.0)))

    guard.inner.measure = overloaded
    with pytest.raises(NotReady, match=r"enable: tension: 900\.0 N measured; allowed: 5 N to 500"):
        guard.connect()
    assert guard.inner.seen == []


def test_only_a_simulated_robot_is_set_down_where_it_is_homed():
    place = (0.5, -1.5, 2.4)
    ads = GuardedAds.build(ROBOT, GuardedAdsSettings(start_position=place, motion=True))
    assert ads.inner._settings.start_position is None
    asked = GuardedAdsSettings(inner={"start_position": place})
    assert GuardedAds.build(ROBOT, asked).inner._settings.start_position == place
    settings = GuardSettings(driver="quasi_static", start_position=place)
    assert GuardedDriver.build(ROBOT, settings).inner._settings.start_position == place


def test_a_recording_that_fails_is_a_fault():
    guard = connected()
    drive(guard, 5)

    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    guard.journal.measured = full
    assert not ask(guard, standing(guard))[0]
    assert "the recording failed: No space left" in guard.fault.text
    assert guard.fault.fault is Fault.RECORDING
    guard.close()


class Stuck(Notes):
    """A journal on a disk that hangs from now on, until it is let go."""

    def __init__(self):
        super().__init__()
        self.free = threading.Event()
        self.free.set()

    def measured(self, measurement):
        self.free.wait()
        super().measured(measurement)


def stuck(**changes):
    guard = guarded(real_time=True, overrun_share=1.0, warm_up=1, **changes)
    guard.journal = Stuck()
    guard.connect()
    drive(guard, 30)
    guard.journal.free.clear()
    return guard


def test_a_recording_that_blocks_holds_nobody_up_and_ends_the_run_by_its_name():
    guard = stuck(record_lag=0.3, hang_time=60.0)
    asked = standing(guard)
    for _ in range(1000):
        if not ask(guard, asked)[0]:
            break
    assert guard.fault.fault is Fault.RECORDING
    assert "behind; allowed: 0.3 s" in guard.fault.text
    assert guard.monitor.unwritten > 3  # a stop waits for no row
    guard.stop("fault")
    seen = np.array(guard.inner.seen)
    assert seen[-1] == pytest.approx(seen[-2], abs=1e-12)
    assert within_limits(seen)
    with pytest.raises(NotReady, match="the recording failed"):
        guard.reset_fault()
    guard.journal.free.set()
    guard.close()
    assert guard.unrecorded == 0
    lengths = [x for x in guard.journal.lengths]
    assert (np.diff([float(x.time[0]) for x in lengths]) >= 0.0).all()  # in order, none lost
    assert "at_rest" in guard.journal.names()


@pytest.mark.parametrize("real_time", [False, True])
def test_no_length_reaches_the_drives_before_its_row_is_written(real_time):
    """So that it is on the disk whatever then kills the process; late rows are counted."""
    guard = guarded(real_time=real_time, overrun_share=1.0, hang_time=60.0)
    guard.connect()
    original, missing = guard.inner.command, []

    def command(sent):
        length = sent.unstrained_length + guard.monitor.offset
        rows = [row.unstrained_length for _, row, _ in guard.journal.commands[-1:]]
        missing.append(not any(np.allclose(row, length, atol=1e-12) for row in rows))
        return original(sent)

    guard.inner.command = command
    drive(guard, 40)
    guard.stop("done")
    assert len(missing) > 40
    assert sum(missing) <= guard.monitor.unwritten
    assert guard.monitor.unwritten < (len(missing) // 2 if real_time else 1)
    guard.close()


def test_the_watchdog_brakes_while_a_recording_blocks():
    guard = stuck(record_lag=60.0, hang_time=0.6)
    hung = threading.Event()
    guard.on_hang = hung.set
    guard.measure()  # the journal has it, and does not come back
    assert hung.wait(20.0)  # nobody calls the guard meanwhile
    assert guard.fault.fault is Fault.CONTROLLER
    seen = np.array(guard.inner.seen)
    assert seen[-1] == pytest.approx(seen[-2], abs=1e-12)
    assert within_limits(seen)
    guard.monitor.rows.end(0.1)
    guard.close()
    assert guard.unrecorded > 0  # counted, not silently lost
    guard.journal.free.set()


# --- In the loop ----------------------------------------------------------------------------------


def test_the_loop_runs_to_the_end_and_leaves_the_robot_at_rest():
    guard = guarded()
    controller = Holding()
    log = run(guard, controller, controller, path(), duration=1.5)
    assert log.completed
    assert within_limits(guard.inner.seen)
    assert guard.journal.names()[-4:] == ["stopping", "at_rest", "homed", "disconnected"]
    assert log.position[-1, 0, 0] > ROBOT.home_position[0] + 0.3


@pytest.mark.parametrize(
    "broken, fault, kind",
    [
        ({"fails_at": 40, "error": ZeroDivisionError("oops")}, Fault.CONTROLLER, ZeroDivisionError),
        ({"fails_at": 40, "error": BadPlugin("no")}, Fault.CONTROLLER, BadPlugin),
        ({"fails_at": 40, "error": SystemExit(0)}, Fault.CONTROLLER, BadPlugin),
        ({"fails_at": 40, "error": GeneratorExit()}, Fault.CONTROLLER, GeneratorExit),
        (
            {"fails_at": 40, "error": asyncio.CancelledError()},
            Fault.CONTROLLER,
            asyncio.CancelledError,
        ),
        ({"fails_at": 40}, Fault.COMMAND, InvalidField),
    ],
)
def test_a_controller_that_fails_is_named_and_the_robot_stops(broken, fault, kind):
    guard = guarded()
    controller = Holding(**broken)
    with pytest.raises(kind):
        run(guard, controller, controller, path())
    assert guard.fault.fault is fault
    assert guard.fault.text.startswith("the controller raised")
    assert within_limits(guard.inner.seen)
    assert "at_rest" in guard.journal.names()
    assert guard.state is DriveState.DISCONNECTED


@pytest.mark.parametrize("error", [SystemExit, GeneratorExit, ZeroDivisionError])
def test_a_program_that_fails_while_the_winches_follow_is_a_fault(error):
    guard, cycles = guarded(), []

    def watch(step):
        cycles.append(step)
        if len(cycles) == 40:
            raise error

    with pytest.raises(error):
        run(guard, Holding(), Holding(), path(), watch=watch)
    assert guard.fault is not None
    assert "at_rest" in guard.journal.names()


@pytest.mark.parametrize("operator", [True, False])
def test_an_interrupt_is_a_fault_of_the_plug_in_unless_an_end_was_asked_for(operator, monkeypatch):
    """As in `carosac run`, whose own handler takes Ctrl-C: only a second one interrupts."""
    monkeypatch.setattr(signal, "getsignal", lambda number: "a handler of the program")
    guard = guarded()
    controller = Holding(fails_at=40, error=KeyboardInterrupt())
    if operator:
        controller.reset = lambda _: guard.end("SIGINT")
        controller.fails_at = 1
    with pytest.raises(KeyboardInterrupt):
        run(guard, Holding(), controller, path())
    assert (guard.fault is None) == operator
    assert "at_rest" in guard.journal.names()


def test_a_belief_that_runs_away_is_a_fault_of_the_estimator():
    guard = guarded(belief_max=0.5)
    controller = Holding(drift=0.02)
    log = run(guard, controller, controller, path())
    assert not log.completed
    assert guard.fault.fault is Fault.ESTIMATOR
    assert "the estimated position is 0.5" in guard.fault.text
    assert within_limits(guard.inner.seen)


def test_the_watchdog_brakes_for_a_controller_that_hangs():
    """The main thread sleeps; meanwhile the winches come to rest."""
    guard = guarded(real_time=True, hang_time=0.5, overrun_share=1.0, warm_up=1)
    guard.connect()
    hung = threading.Event()
    guard.on_hang = hung.set
    drive(guard, 30)
    moving = guard.inner.seen[-1] - guard.inner.seen[-2]
    assert abs(moving).max() > 1e-3
    assert hung.wait(10.0)
    assert guard.fault.fault is Fault.CONTROLLER
    assert "gave no command for" in guard.fault.text
    assert within_limits(guard.inner.seen)
    seen = np.array(guard.inner.seen)
    assert seen[-1] == pytest.approx(seen[-2], abs=1e-12)
    assert not guard.wait(PERIOD)
    guard.close()
    assert not [x for x in threading.enumerate() if x.name == "guard watchdog"]


def test_a_controller_that_comes_back_in_time_goes_on():
    guard = guarded(real_time=True, hang_time=60.0, overrun_share=1.0, warm_up=1)
    guard.connect()
    asked = drive(guard, 30)
    time.sleep(10 * PERIOD)
    slowed = np.array(guard.inner.seen)
    assert ask(guard, asked)[0]
    assert len(slowed) > 31  # the watchdog has sent some
    assert guard.state is DriveState.FOLLOWING
    guard.close()
    assert within_limits(guard.inner.seen)


# --- All of it ------------------------------------------------------------------------------------


class Conforming(GuardedDriver):
    """For the checks that every driver passes."""

    @classmethod
    def build(cls, robot, settings=None, *, seed=0):
        chosen = GuardSettings(
            driver="quasi_static", period=0.02, motion=True, first_max=4.0, step_max=5.0,
            workspace_margin=9.0, closure_max=9.0,
        )  # fmt: skip
        return super().build(robot, chosen, seed=seed)


@pytest.mark.parametrize("name", sorted(set(DRIVER_CHECKS) - {"stop_comes_to_rest"}))
def test_a_guarded_driver_passes_what_every_driver_must(name):
    """But for the stop that goes on while cycles do: `stop` of the guard ends at rest."""
    DRIVER_CHECKS[name](Conforming.build, ROBOT)


def test_settings_are_checked_and_a_recording_needs_no_guard():
    with pytest.raises(InvalidField, match="hang_time"):
        GuardSettings(hang_time=-1.0)
    with pytest.raises(InvalidField, match="a driver that moves"):
        GuardedDriver.build(ROBOT, GuardSettings(driver="replay"))
    with pytest.raises(InvalidField, match=r"inner\.segment"):
        GuardedDriver.build(ROBOT, GuardSettings(driver="quasi_static", inner={"segment": 3}))


def test_no_guard_stands_behind_a_guard():
    for name in ("guarded", "ads"):
        with pytest.raises(InvalidField, match="a driver that moves, and no guard"):
            GuardedDriver.build(ROBOT, GuardSettings(driver=name))


def test_the_driver_behind_gets_of_a_scene_what_it_has():
    scene = {"set_down": True, "wind_force": 2.0, "wind_time": 3.0}
    simulated = GuardedDriver.build(ROBOT, GuardSettings(driver="simulator", scene=scene)).inner
    assert (simulated._settings.wind_force, simulated._settings.wind_time) == (2.0, 3.0)
    assert GuardedAds.build(ROBOT, GuardedAdsSettings(scene=scene)).inner._settings.set_down
    GuardedDriver.build(ROBOT, GuardSettings(driver="quasi_static", scene=scene))
    asked = GuardSettings(driver="simulator", scene=scene, inner={"wind_force": 1.0})
    assert GuardedDriver.build(ROBOT, asked).inner._settings.wind_force == 1.0
    with pytest.raises(InvalidField, match="scene: got 3; allowed: settings by name"):
        GuardSettings(scene=3)


# --- Settings that other tests leave alone --------------------------------------------------------


@pytest.mark.parametrize(("margin", "fault"), [(0.05, None), (0.01, Fault.COMMAND)])
def test_the_limits_hold_back_a_command_out_of_range_up_to_the_margin(margin, fault):
    start = lengths_at(ROBOT.home_position)[0]
    guard = connected(robot=replace(ROBOT, length_max=start + 0.02), range_margin=margin)
    alive, sent = ask(guard, start[None] + 0.05)
    assert alive == (fault is None)
    assert (guard.fault and guard.fault.fault) == fault
    assert (sent.unstrained_length <= start + 0.02).all()
    guard.close()


@pytest.mark.parametrize(("most", "said"), [(0.004, "the other way"), (1.0, "winch should be")])
def test_a_winch_that_turns_the_other_way_is_found_before_it_is_far(most, said):
    guard = connected(direction_max=most, jump_max=1.0, closure_max=9.0)
    start, original = standing(guard), guard.inner.measure

    def reversed_drive():
        measurement = original()
        mirrored = 2.0 * (start - guard.monitor.offset) - measurement.unstrained_length
        return replace(measurement, unstrained_length=mirrored)

    guard.inner.measure = reversed_drive
    for k in range(50):
        if not ask(guard, start + 0.004 * k)[0]:
            break
    assert guard.fault.fault is Fault.FOLLOWING_ERROR
    assert said in guard.fault.text
    guard.close()


def test_homing_may_change_offsets_by_the_largest_change_of_every_day():
    guard = connected(at_once=False, home_change_max=1.0)
    moved = replace(home_state(), position=ROBOT.home_position[None] + np.array([0.5, 0.0, 0.0]))
    guard.home(moved)
    assert 0.1 < np.abs(guard.home_change).max() < 1.0
    guard.close()


@pytest.mark.parametrize("slack_time", [0.1, 0.4])
def test_a_slack_cable_is_a_fault_once_it_lasts(slack_time):
    guard = connected(slack_time=slack_time)
    original = guard.inner.measure

    def slack():
        measurement = original()
        tension = Stamped(time=measurement.time, value=np.array([[1.0, 90.0, 90.0, 90.0]]))
        return replace(measurement, tension=tension)

    guard.inner.measure = slack
    cycles = to_the_end(guard)
    assert guard.fault.fault is Fault.TENSION
    assert cycles * PERIOD == pytest.approx(slack_time, abs=1.5 * PERIOD)
    guard.close()


@pytest.mark.parametrize("asked", [False, True])
def test_a_fault_of_an_earlier_run_is_cleared_where_that_is_asked_for_only(asked):
    class Held(FailingDriver):
        resets = 0

        def connect(self):
            super().connect()
            self.trip = True

        def reset_fault(self):
            Held.resets += 1
            self.trip = False

    inner = Held.build(ROBOT, QuasiStaticSettings(period=PERIOD))
    settings = GuardSettings(period=PERIOD, motion=True, reset_at_once=asked)
    guard = GuardedDriver(inner, ROBOT, settings, real_time=False)
    if asked:
        guard.connect()
        assert guard.state is DriveState.ENABLED
    else:
        with pytest.raises(NotReady, match=r"hold a fault of before: drive_trip: .*--reset"):
            guard.connect()
        assert guard.state is DriveState.DISCONNECTED
    assert Held.resets == int(asked)
    guard.close()
