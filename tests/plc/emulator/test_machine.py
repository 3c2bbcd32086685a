"""The program of the PLC cycle by cycle, without any clock."""

import numpy as np
import pytest

from carosac_toolkit.loop.drive_state import DriveState, Fault
from carosac_toolkit.loop.values import Command
from carosac_toolkit.plc.blocks import BLOCK_LAYOUT, Answer, Request
from carosac_toolkit.plc.emulator.machine import Inputs, Machine
from carosac_toolkit.plc.emulator.winches import BRAKE_RATIO, BRAKING_SHARE, Winches, WinchLimits
from carosac_toolkit.safety.limiter import Limiter, LimitSettings
from carosac_toolkit.safety.stop import CoordinatedStop
from tests.robots import simple_robot

CYCLE, PERIOD, WATCHDOG = 0.005, 0.01, 0.1
IDENTITY = 2**63 + 5  # hash of the robot; ULINT, not LINT
START = np.array([9.0, 8.0, 9.0, 8.5])
ROBOT = simple_robot()
PEAK_MAX = ROBOT.acceleration_max + 1e-9
LIMITS = WinchLimits(
    length_min=ROBOT.length_min, length_max=ROBOT.length_max, speed=ROBOT.speed_max,
    acceleration=ROBOT.acceleration_max, jerk=np.full(4, 200.0), step=np.full(4, 0.03),
    following=np.full(4, 0.25),
)  # fmt: skip


class Rig:
    """A machine whose winches stand exactly where they are told, and a host that writes."""

    def __init__(self, watchdog=WATCHDOG):
        self.machine = Machine(LIMITS, cycle=CYCLE, watchdog=watchdog, identity=IDENTITY)
        self.machine.place(START)
        self.offset = np.zeros(4)  # what the encoders say too much
        self.machine.reference = np.zeros(4)
        self.host = {
            "layout": BLOCK_LAYOUT, "cables": 4, "sequence": 0, "session": 7, "host_number": 70,
            "machine": IDENTITY, "request": 0, "request_number": 0, "follow": 0,
            "command": 0, "period": PERIOD, "length": START, "rate": np.zeros(4),
            "sequence_end": 0, "fault": 0,
        }  # fmt: skip
        self.positions = []
        self.cycles()

    @property
    def inputs(self):
        machine = self.machine
        length = machine.winches.position - machine.reference + self.offset
        return Inputs(length=length, rate=np.zeros(4))

    @property
    def out(self):
        return self.machine.output(self.inputs)

    def cycles(self, count=1, *, beat=True):
        for _ in range(count):
            if beat:
                self.host = self.host | {
                    "sequence": self.host["sequence"] + 1,
                    "sequence_end": self.host["sequence"] + 1,
                }  # fmt: skip
            self.machine.cycle(self.host, self.inputs)
            self.positions.append(self.machine.winches.position.copy())

    def ask(self, request):
        number = self.host["request_number"] + 1
        self.host = self.host | {
            "request": int(request), "request_number": number, "follow": 0,
        }  # fmt: skip
        self.cycles()
        assert self.out["answered"] == number
        return Answer(self.out["answer"])

    def send(self, length, cycles=2):
        self.host = self.host | {
            "length": np.asarray(length), "follow": 1, "command": self.host["command"] + 1,
        }  # fmt: skip
        self.cycles(cycles)

    def move(self, seconds, amplitude=0.2, frequency=0.5):
        """Follow a wave that the limiter lets pass; the commands, shape (T, 4)."""
        limiter = Limiter(ROBOT, LimitSettings(box=False), period=PERIOD)
        start = self.machine.winches.position
        limiter.reset(start[None])
        sent = []
        for k in range(round(seconds / PERIOD)):
            wave = amplitude * np.sin(2 * np.pi * frequency * k * PERIOD) * np.array([1, -1, 1, 0])
            asked = Command(time=np.zeros(1), unstrained_length=(start + wave)[None])
            sent.append(limiter.apply(asked).unstrained_length[0])
            self.send(sent[-1])
        return np.array(sent)


@pytest.fixture
def rig():
    return Rig()


def test_the_drives_are_off_until_a_host_enables(rig):
    assert rig.machine.state is DriveState.CONNECTED
    rig.send(START + 0.01)
    assert rig.machine.state is DriveState.CONNECTED
    assert rig.machine.winches.position == pytest.approx(START)
    assert rig.ask(Request.STOP) is Answer.NOT_OWNER
    assert rig.ask(Request.ENABLE) is Answer.DONE
    assert rig.machine.state is DriveState.ENABLED
    rig.cycles(50)
    assert rig.machine.winches.position == pytest.approx(START)  # an old command is not followed


@pytest.mark.parametrize(("amplitude", "frequency"), [(0.2, 0.5), (1.0, 0.9), (0.05, 3.0)])
def test_commands_within_limits_give_motion_within_the_same_limits(rig, amplitude, frequency):
    rig.ask(Request.ENABLE)
    sent = rig.move(3.0, amplitude, frequency)
    counters, winches = rig.machine.counters, rig.machine.winches
    assert counters.over_speed == counters.over_acceleration == counters.over_jerk == 0
    assert counters.commands == len(sent) and counters.lost == 0
    assert (winches.speed_peak <= ROBOT.speed_max * (1 + 1e-9)).all()
    assert (winches.acceleration_peak <= PEAK_MAX).all()
    # The motion is the commands some 1.5 periods later: compare with them a whole number later.
    asked = np.repeat(sent, 2, axis=0)
    got = np.array(rig.positions[-len(asked) :])
    lag = [np.abs(got[k:] - asked[: len(asked) - k]).max() for k in range(8)]
    speed = float(np.abs(np.diff(sent, axis=0)).max() / PERIOD)
    assert min(lag) < speed * PERIOD + 1e-3


def test_all_winches_ramp_by_one_factor_and_in_the_time_of_the_slowest(rig):
    rig.ask(Request.ENABLE)
    rig.move(0.4, amplitude=1.0)
    before = rig.machine.winches.speed.copy()
    assert np.abs(before).max() > 0.5
    rig.ask(Request.STOP)
    speeds = [rig.machine.winches.speed.copy()]
    while rig.machine.state is DriveState.STOPPING:
        rig.cycles()
        speeds.append(rig.machine.winches.speed.copy())
    for speed in speeds:
        factor = speed @ before / (before @ before)
        assert speed == pytest.approx(factor * before, abs=1e-9)
    needed = (np.abs(before) / ROBOT.acceleration_max).max()
    assert len(speeds) * CYCLE == pytest.approx(needed, abs=2 * CYCLE)
    assert rig.machine.state is DriveState.ENABLED


def test_a_host_that_falls_silent_is_heard_of_after_the_watchdog(rig):
    rig.ask(Request.ENABLE)
    rig.move(0.4, amplitude=1.0)
    speed = np.abs(rig.machine.winches.speed).max()
    rig.cycles(round(WATCHDOG / CYCLE) - 2, beat=False)
    assert rig.machine.state is DriveState.FOLLOWING
    rig.cycles(2, beat=False)
    assert (rig.machine.state, rig.machine.fault) == (DriveState.FAULT, Fault.HEARTBEAT_LOST)
    rig.cycles(round(speed / ROBOT.acceleration_max[0] / CYCLE) + 2, beat=False)
    assert rig.machine.winches.at_rest
    rig.cycles(2, beat=False)
    assert rig.out["owner"] == 0
    assert rig.ask(Request.ENABLE) is Answer.WRONG_STATE  # latched
    assert rig.ask(Request.RESET) is Answer.DONE
    assert rig.machine.state is DriveState.CONNECTED
    assert rig.ask(Request.ENABLE) is Answer.DONE


@pytest.mark.parametrize("moving", [False, True])
def test_a_fault_of_the_host_is_held_until_it_is_reset(rig, moving):
    rig.host = rig.host | {"fault": Fault.CONTROLLER.number}
    rig.ask(Request.ENABLE)
    if moving:
        rig.move(0.4, amplitude=1.0)
    assert rig.ask(Request.HOLD) is Answer.DONE
    assert rig.machine.winches.at_rest is not moving
    rig.cycles(200)
    assert rig.machine.winches.at_rest
    assert (rig.out["state"], rig.out["fault"]) == (
        DriveState.FAULT.number, Fault.CONTROLLER.number,
    )  # fmt: skip
    assert rig.ask(Request.ENABLE) is Answer.WRONG_STATE
    assert rig.ask(Request.RESET) is Answer.DONE
    assert rig.ask(Request.ENABLE) is Answer.DONE


def test_a_fault_is_held_for_a_host_that_nobody_obeys_and_not_against_the_one_obeyed(rig):
    rig.host = rig.host | {"fault": Fault.LOST_CONNECTION.number}
    assert rig.ask(Request.HOLD) is Answer.DONE  # as after a start of the PLC program
    assert rig.machine.fault is Fault.LOST_CONNECTION
    assert rig.ask(Request.RESET) is Answer.DONE
    rig.ask(Request.ENABLE)
    other = {"session": 8, "request": int(Request.HOLD), "request_number": 1}
    mine, rig.host = rig.host, rig.host | other
    rig.cycles()
    assert rig.out["answer"] == Answer.NOT_OWNER
    assert rig.machine.fault is Fault.NONE
    rig.host = mine


def test_the_first_fault_stays_and_a_number_without_a_name_is_still_one(rig):
    rig.ask(Request.ENABLE)
    rig.machine.stop(Fault.DRIVE_TRIP, 2)
    rig.host = rig.host | {"fault": Fault.STALE_DATA.number}
    assert rig.ask(Request.HOLD) is Answer.DONE
    assert (rig.machine.fault, rig.machine.fault_axis) == (Fault.DRIVE_TRIP, 2)
    rig.ask(Request.RESET)
    for number in (0, 99):
        rig.ask(Request.ENABLE)
        rig.host = rig.host | {"fault": number}
        rig.ask(Request.HOLD)
        assert rig.machine.fault is Fault.UNKNOWN
        assert rig.ask(Request.RESET) is Answer.DONE


@pytest.mark.parametrize(
    ("length", "rate", "fault", "counter"),
    [
        (START + np.array([np.nan, 0, 0, 0]), np.zeros(4), Fault.COMMAND, "not_finite"),
        (START, np.array([0, np.inf, 0, 0]), Fault.COMMAND, "not_finite"),
        (START + np.array([0, 0, 200.0, 0]), np.zeros(4), Fault.COMMAND, "over_length"),
        (START + np.array([0, 0, 0, 0.5]), np.zeros(4), Fault.COMMAND, "jumps"),
    ],
)
def test_a_first_command_that_cannot_be_is_not_followed(rig, length, rate, fault, counter):
    rig.ask(Request.ENABLE)
    rig.host = rig.host | {"rate": rate}
    rig.send(length)
    assert (rig.machine.state, rig.machine.fault) == (DriveState.FAULT, fault)
    assert getattr(rig.machine.counters, counter) == 1
    assert rig.machine.winches.position == pytest.approx(START)


def test_a_command_beyond_the_speed_limit_stops_the_winches_within_their_limits(rig):
    rig.ask(Request.ENABLE)
    rig.move(0.2)
    rig.send(rig.host["length"] + np.array([0.2, 0, 0, 0]))  # 20 m/s
    assert rig.machine.fault is Fault.OVER_LIMIT
    rig.cycles(200)
    assert rig.machine.counters.over_speed == 1
    assert (rig.machine.winches.acceleration_peak <= PEAK_MAX).all()
    assert rig.machine.winches.at_rest


def shared_factors(speeds, before):
    """Largest reversal [unit/s] and distance of the speeds from one common factor of `before`."""
    speeds = np.array(speeds)
    factors = speeds @ before / (before @ before)
    back = float(np.max(-speeds * np.sign(before)))
    return back, float(np.abs(speeds - factors[:, None] * before).max() / np.abs(before).max())


@pytest.mark.parametrize("beat", [True, False])  # a controller that hangs, a host that is gone
def test_commands_that_stop_coming_end_in_a_common_ramp_and_a_latched_fault(rig, beat):
    rig.ask(Request.ENABLE)
    sent = rig.move(0.4, amplitude=1.0)
    rate = np.abs(sent[-1] - sent[-2]).max() / PERIOD
    rig.cycles(2, beat=beat)
    before, speeds = rig.machine.winches.speed.copy(), []
    for _ in range(200):
        rig.cycles(beat=beat)
        speeds.append(rig.machine.winches.speed.copy())
    back, apart = shared_factors(speeds, before)
    assert back <= 1e-9 and apart < 1e-9
    assert (rig.machine.state, rig.machine.fault) == (DriveState.FAULT, Fault.HEARTBEAT_LOST)
    assert rig.machine.counters.watchdog == 1
    far = np.abs(rig.machine.winches.position - sent[-1]).max()
    assert far < rate**2 / (2 * ROBOT.acceleration_max[0]) + 2 * PERIOD * rate
    assert (rig.machine.winches.acceleration_peak <= PEAK_MAX).all()


@pytest.mark.parametrize("cause", ["stop", "disable", "hold", "nan", "over_limit", "trip", "step"])
def test_no_way_to_stop_turns_a_winch_back_or_parts_the_winches(rig, cause):
    rig.host = rig.host | {"fault": Fault.CONTROLLER.number}
    rig.ask(Request.ENABLE)
    rig.move(0.4, amplitude=1.0)
    before = rig.machine.winches.speed.copy()
    if cause in ("stop", "disable", "hold"):
        rig.ask(Request[cause.upper()])
    elif cause == "trip":
        rig.machine.wires.tripped[3] = True  # of the winch that stands
    else:
        far = {"nan": np.nan, "over_limit": 0.2, "step": -0.5}[cause]
        rig.send(rig.host["length"] + np.array([far, 0, 0, 0]), cycles=1)
    speeds = [rig.machine.winches.speed.copy()]
    while not rig.machine.winches.at_rest:
        rig.cycles()
        speeds.append(rig.machine.winches.speed.copy())
    back, apart = shared_factors(speeds, before)
    assert back <= 1e-9 and apart < 1e-9
    assert (rig.machine.winches.acceleration_peak <= PEAK_MAX).all()


@pytest.mark.parametrize("lost", [0, 5])  # the host stood still, or its commands were lost
def test_commands_that_come_again_during_the_ramp_are_caught_up_with_forwards(rig, lost):
    rig.ask(Request.ENABLE)
    step = 0.8 * PERIOD * np.array([1.0, -0.7, 0.3, 0.0])
    for speed in np.minimum(1.0, 0.05 * np.arange(60)):
        rig.send(rig.host["length"] + speed * step)
    rig.cycles(10)
    assert (rig.machine.winches.speed[:3] != 0.8 * step[:3] / step[0]).all()
    rig.host = rig.host | {"command": rig.host["command"] + lost}
    rig.host["length"] = rig.host["length"] + lost * step
    for _ in range(60):
        rig.send(rig.host["length"] + step)
        assert (rig.machine.winches.speed * np.sign(step) >= 0.0).all()
    assert rig.machine.state is DriveState.FOLLOWING
    assert rig.machine.winches.speed == pytest.approx(step / PERIOD, abs=1e-3)
    late = rig.host["length"] - rig.machine.winches.position
    assert np.abs(late).max() < 2 * np.abs(step).max()
    assert (rig.machine.winches.acceleration_peak <= PEAK_MAX).all()
    assert (rig.machine.winches.speed_peak <= ROBOT.speed_max).all()


def test_commands_that_come_again_at_rest_must_begin_where_the_winches_stand(rig):
    rig.ask(Request.ENABLE)
    for _ in range(20):
        rig.send(rig.host["length"])
    rig.cycles(12)
    rig.send(rig.host["length"] + 0.02)
    assert rig.machine.state is DriveState.FOLLOWING
    rig.cycles(round(0.09 / CYCLE))
    rig.host["length"] = rig.machine.winches.position + 0.04
    rig.send(rig.host["length"])
    assert (rig.machine.fault, rig.machine.counters.jumps) == (Fault.HEARTBEAT_LOST, 1)


def approach(rig, speed):
    """Follow a straight line in length space up to a speed [m/s]; the limiter and the speeds."""
    limiter = Limiter(ROBOT, LimitSettings(box=False), period=PERIOD)
    length = rig.machine.winches.position.copy()
    limiter.reset(length[None])
    rates = speed * np.array([1.0, -0.7, 0.3, 0.004])
    for share in np.minimum(1.0, 0.02 / speed * np.arange(100)):
        length = length + share * rates * PERIOD
        sent = limiter.apply(Command(time=np.zeros(1), unstrained_length=length[None]))
        rig.send(sent.unstrained_length[0])
    return limiter, rates


@pytest.mark.parametrize("speed", [0.1, 0.8, 1.5])
@pytest.mark.parametrize("silent_cycles", [2, 6, 10, 18])
def test_winches_that_passed_the_end_of_a_late_stop_creep_back_together(rig, speed, silent_cycles):
    """A host that hangs lets the winches go on, or ramp, and then stops them behind there."""
    rig.ask(Request.ENABLE)
    limiter, rates = approach(rig, speed)
    rig.cycles(silent_cycles)
    since = len(rig.positions) - silent_cycles - 1
    stop = CoordinatedStop(limiter, np.zeros(4))
    while not limiter.stopped:
        rig.send(stop.step(np.zeros(1)).unstrained_length[0])
    for _ in range(40):
        rig.send(rig.host["length"])
    speeds = np.diff(rig.positions[since:], axis=0) / CYCLE
    back, apart = shared_factors(speeds, rates)
    assert back < 0.0051  # two thousandths of the speed limit
    assert apart < 0.005
    assert (rig.machine.winches.acceleration_peak <= PEAK_MAX).all()


def test_winches_at_rest_ahead_of_a_repeated_command_creep_back_to_it():
    rig = Rig(watchdog=0.5)
    rig.ask(Request.ENABLE)
    approach(rig, 0.4)
    rig.cycles(40)
    assert rig.machine.winches.at_rest
    ahead = rig.machine.winches.position - rig.host["length"]
    assert np.abs(ahead).max() > 0.01
    since = len(rig.positions) - 1
    for _ in range(600):
        rig.send(rig.host["length"])
    speeds = np.diff(rig.positions[since:], axis=0) / CYCLE
    assert np.abs(speeds).max() < 0.0051
    assert rig.machine.winches.position == pytest.approx(rig.host["length"], abs=1e-6)


@pytest.mark.parametrize(("paused", "fault"), [(0.09, Fault.NONE), (0.11, Fault.HEARTBEAT_LOST)])
def test_a_program_that_was_held_up_longer_than_the_watchdog_stops(rig, paused, fault):
    """It cannot know whether the host was there; data that waited meanwhile are no sign of it."""
    rig.ask(Request.ENABLE)
    approach(rig, 0.4)
    before, since = rig.machine.winches.speed.copy(), len(rig.positions) - 1
    rig.machine.held_up(paused)
    rig.send(rig.host["length"] + np.array([0.004, 0, 0, 0]))
    assert rig.machine.fault is fault
    rig.cycles(40)
    if fault is not Fault.NONE:
        speeds = np.diff(rig.positions[since:], axis=0) / CYCLE
        back, apart = shared_factors(speeds, before)
        assert back <= 1e-9 and apart < 1e-9


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({"period": 10.0}, Fault.COMMAND), ({"period": 1e300}, Fault.COMMAND),
        ({"period": 1e-9}, Fault.COMMAND), ({"period": 0.05}, Fault.COMMAND),
        ({"period": np.nan}, Fault.COMMAND), ({"command": 1100}, Fault.OVER_LIMIT),
        ({"command": 3}, Fault.OVER_LIMIT),
    ],
)  # fmt: skip
def test_no_period_or_number_of_the_host_lifts_the_limits(rig, changes, fault):
    rig.ask(Request.ENABLE)
    rig.move(0.2)
    peak = rig.machine.winches.speed_peak.max()
    rig.host = rig.host | {"length": rig.host["length"] + np.array([1.0, 0, 0, 0])} | (
        {"command": rig.host["command"] + 1} | changes
    )  # fmt: skip
    rig.cycles(100)
    assert (rig.machine.state, rig.machine.fault) == (DriveState.FAULT, fault)
    assert rig.machine.winches.speed_peak.max() == peak


@pytest.mark.parametrize(
    "changes", [{"rate": np.full(4, 1e300)}, {"rate": np.array([0, 0, 3.0, 0])}, {"period": 0.2}]
)
def test_a_rate_or_period_out_of_range_is_refused_with_a_length_that_could_be_followed(
    rig, changes
):
    rig.ask(Request.ENABLE)
    rig.host = rig.host | changes
    rig.send(START)
    assert rig.machine.state is DriveState.FAULT


def test_commands_faster_than_the_limit_by_the_clock_of_the_plc_are_not_followed(rig):
    rig.ask(Request.ENABLE)
    rig.host = rig.host | {"period": 0.1}  # stated; one comes each 10 ms
    for _ in range(30):
        rig.send(rig.host["length"] + np.array([0.05, 0, 0, 0]) * (rig.host["command"] > 1))
        if rig.machine.state is DriveState.FAULT:
            break
    assert rig.machine.fault is Fault.OVER_LIMIT
    assert rig.machine.counters.commands < 10


def test_only_one_session_is_obeyed(rig):
    rig.ask(Request.ENABLE)
    mine = dict(rig.host)
    rig.host = mine | {"session": 8, "request": int(Request.STOP), "request_number": 1}
    rig.cycles()
    assert rig.out["answer"] == Answer.NOT_OWNER
    assert rig.machine.counters.foreign == 1
    rig.host = rig.host | {"length": START + 0.01, "follow": 1, "command": 9}
    rig.cycles(3)
    assert rig.machine.state is DriveState.ENABLED
    assert rig.out["owner"] == 70  # the public number, not the session
    rig.host = mine
    assert rig.ask(Request.DISABLE) is Answer.DONE
    rig.cycles(2)
    assert rig.out["owner"] == 0 and rig.machine.state is DriveState.CONNECTED


def test_a_host_with_the_file_of_another_robot_is_not_enabled(rig):
    rig.host = rig.host | {"machine": IDENTITY + 1}
    assert rig.ask(Request.ENABLE) is Answer.ANOTHER_ROBOT
    assert rig.machine.state is DriveState.CONNECTED and rig.out["owner"] == 0
    rig.send(START + 0.01)
    assert rig.machine.winches.position == pytest.approx(START)
    rig.host = rig.host | {"machine": IDENTITY}
    assert rig.ask(Request.ENABLE) is Answer.DONE


def test_the_public_number_of_the_owner_commands_nothing(rig):
    rig.ask(Request.ENABLE)
    rig.host = rig.host | {"session": rig.host["host_number"]}
    rig.send(START + 0.01)
    assert rig.machine.state is DriveState.ENABLED
    assert rig.machine.counters.foreign > 0


def test_torn_data_are_not_taken_over(rig):
    rig.ask(Request.ENABLE)
    rig.host = rig.host | {"command": 5, "follow": 1, "length": START + 0.01}
    rig.host = rig.host | {"sequence": rig.host["sequence"] + 1}
    rig.cycles(beat=False)
    assert rig.machine.counters.torn == 1
    assert rig.machine.state is DriveState.ENABLED


def test_a_tripped_winch_brakes_by_itself_and_the_others_together(rig):
    rig.ask(Request.ENABLE)
    rig.move(0.4, amplitude=1.0)
    before = rig.machine.winches.speed.copy()
    rig.machine.wires.tripped[0] = True
    rig.cycles(4)
    assert (rig.machine.fault, rig.machine.fault_axis) == (Fault.DRIVE_TRIP, 1)
    speed = rig.machine.winches.speed
    assert speed[1:3] / before[1:3] == pytest.approx(np.full(2, speed[1] / before[1]))
    assert abs(speed[0] / before[0]) < abs(speed[1] / before[1])
    rig.cycles(200)
    assert rig.ask(Request.RESET) is Answer.CAUSE_REMAINS
    rig.machine.wires.tripped[0] = False
    assert rig.ask(Request.RESET) is Answer.DONE


def test_a_trip_that_goes_away_in_mid_ramp_does_not_start_the_winch_again(rig):
    rig.ask(Request.ENABLE)
    rig.move(0.4, amplitude=1.0)
    rig.machine.wires.tripped[0] = True
    while rig.machine.winches.speed[0]:
        rig.cycles()
    assert rig.machine.winches.speed[1]
    rig.machine.wires.tripped[0] = False
    while not rig.machine.winches.at_rest:
        rig.cycles()
        assert rig.machine.winches.speed[0] == 0.0
    peak = rig.machine.winches.acceleration_peak
    assert peak[0] == pytest.approx(BRAKE_RATIO * ROBOT.acceleration_max[0])  # by its brake
    assert (peak <= PEAK_MAX)[1:].all()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_ramp_ends_before_the_soft_ends_and_otherwise_by_one_factor(sign):
    winches = Winches(LIMITS, CYCLE)
    brake = BRAKING_SHARE * LIMITS.acceleration[1]
    middle = (LIMITS.length_min + LIMITS.length_max) / 2
    end = LIMITS.length_max if sign > 0 else LIMITS.length_min
    worst, capped = -np.inf, 0
    for distance in (0.01, 0.05, 0.1, 0.2, 0.3):
        winches.place(middle)
        winches.position[1] = end[1] - sign * distance
        winches.speed = np.array([2.5, sign * np.sqrt(2 * brake * distance), 0, 0])
        begun = winches.speed.copy()
        while not winches.at_rest:
            winches.ramp(np.zeros(4, dtype=bool))
            assert not winches.beyond_ends
            factor = winches.speed[0] / begun[0]
            assert abs(winches.speed[1]) <= factor * abs(begun[1]) + 1e-9
            capped += abs(winches.speed[1]) < factor * abs(begun[1]) - 1e-6
        worst = max(worst, sign * (winches.position[1] - end[1]))
    assert worst < 1e-4
    assert capped > 10  # the common ramp alone would have passed the end
    assert (winches.acceleration_peak <= PEAK_MAX).all()


def test_positions_that_move_out_beyond_a_soft_end_are_counted(rig):
    winches = rig.machine.winches
    rig.machine.place(np.array([LIMITS.length_max[0] + 0.01, *START[1:]]))
    rig.cycles(3)
    assert rig.machine.counters.beyond_ends == 0  # it stands there
    rig.machine.place(winches.position)
    winches.speed = np.array([0.2, 0, 0, 0])
    rig.cycles(1)
    assert rig.machine.counters.beyond_ends == 1
    rig.cycles(100)
    assert winches.at_rest
    assert winches.acceleration_peak[0] <= PEAK_MAX[0]


def test_each_start_of_the_program_has_another_number(rig):
    assert rig.out["boot"] != Rig().out["boot"]
    before = rig.out["boot"]
    rig.cycles(5)
    assert rig.out["boot"] == before != 0


def test_the_emergency_stop_is_a_status_until_it_is_closed_and_reset(rig):
    rig.ask(Request.ENABLE)
    rig.move(0.3)
    rig.machine.wires.estop = True
    rig.cycles(200)
    assert rig.machine.state is DriveState.ESTOP and rig.machine.winches.at_rest
    assert rig.ask(Request.RESET) is Answer.CAUSE_REMAINS
    rig.machine.wires.estop = False
    rig.cycles(5)
    assert rig.machine.state is DriveState.ESTOP
    assert rig.ask(Request.RESET) is Answer.DONE


def test_a_fault_that_a_host_hands_over_during_an_emergency_stop_is_held(rig):
    rig.host = rig.host | {"fault": Fault.CONTROLLER.number}
    rig.ask(Request.ENABLE)
    rig.move(0.2)
    rig.machine.wires.estop = True
    rig.cycles()
    assert rig.ask(Request.HOLD) is Answer.DONE
    assert (rig.machine.state, rig.machine.fault) == (DriveState.ESTOP, Fault.CONTROLLER)


def test_an_encoder_that_jumps_is_a_fault_and_set_points_follow_it_on_enable(rig):
    rig.ask(Request.ENABLE)
    rig.move(0.2)
    rig.offset = np.array([0.05, 0, 0, 0])
    rig.cycles()
    assert (rig.machine.fault, rig.machine.fault_axis) == (Fault.ENCODER_JUMP, 1)
    rig.cycles(200)
    stands = rig.machine.winches.position - rig.machine.reference
    assert rig.ask(Request.RESET) is Answer.DONE
    assert rig.ask(Request.ENABLE) is Answer.DONE
    assert rig.machine.winches.position - rig.machine.reference == pytest.approx(stands)
    assert rig.machine.winches.position == pytest.approx(stands + rig.offset)


def test_a_winch_that_does_not_follow_is_a_fault(rig):
    rig.ask(Request.ENABLE)
    rig.move(0.1)
    for _ in range(60):
        rig.offset = rig.offset + np.array([0, 0, 0.006, 0])
        rig.send(rig.host["length"])
        if rig.machine.state is DriveState.FAULT:
            break
    assert (rig.machine.fault, rig.machine.fault_axis) == (Fault.FOLLOWING_ERROR, 3)


def test_lost_commands_are_counted_and_bridged(rig):
    rig.ask(Request.ENABLE)
    rig.move(0.2)
    rig.host = rig.host | {"command": rig.host["command"] + 2}
    rig.send(rig.host["length"])
    assert rig.machine.counters.lost == 2
    assert rig.machine.state is DriveState.FOLLOWING


def test_a_first_command_that_was_lost_counts_as_lost_and_not_as_a_jerk(rig):
    rig.ask(Request.ENABLE)
    limiter = Limiter(ROBOT, LimitSettings(box=False), period=PERIOD)
    limiter.reset(START[None])
    for k in range(1, 12):
        asked = Command(time=np.zeros(1), unstrained_length=START[None] + 0.2)
        length = limiter.apply(asked).unstrained_length[0]
        rig.host = rig.host | {"command": k, "length": length, "follow": k > 3}
        rig.cycles(2)
    counters = rig.machine.counters
    assert counters.lost == 3
    assert counters.over_acceleration == counters.over_jerk == 0
    assert rig.machine.state is DriveState.FOLLOWING
