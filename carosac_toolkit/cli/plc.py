"""Emulate the PLC of a robot in real time: ADS over TCP, winch drives, a simulated robot.

Clients reach it as they reach a TwinCAT PLC: the driver `ads`, `carosac run`, any ADS client. It
listens on this machine only, and serves nobody but this user and root, unless --allow-others is
given. With --control each line of the standard input does something to the machine: `trip 2`,
`trip 2 off`, `jump 1 0.05`, `freeze-counter on`, `freeze-data on`, `network 0.02 0.01`,
`estop on`, `place 0.4 -1.8 2.2`, `clear`, `state`, `quit`; the end of the input ends it.

With --print-machine it prints what a real PLC program declares for this robot, and ends.

Exit status 1 means that more than one cycle in ten was late.
"""

from __future__ import annotations

import json
import signal
import sys
import threading
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import tyro

from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.cli.common import CommandResult, DefaultRobotOptions, check_reach
from carosac_toolkit.cli.position_option import Place
from carosac_toolkit.live.real_time import short_pauses, take_priority
from carosac_toolkit.plc.blocks import Injection
from carosac_toolkit.plc.emulator.emulator import Emulator
from carosac_toolkit.plc.emulator.settings import EmulatorSettings
from carosac_toolkit.plc.identity import declaration, hash_text, machine_values
from carosac_toolkit.robot.condition_file import find_condition
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.robot.perturbations import draw_plant
from carosac_toolkit.robot.robot import Robot

WIRING_FAULTS = ("wrong_sign", "reversed_drive")
LATE_CYCLES_MAX = 0.1  # share above which it was no PLC


@dataclass(frozen=True, kw_only=True)
class Options(DefaultRobotOptions):
    """Options of ``carosac plc``."""

    ip: str | None = None
    """Address to listen on; by default one of this machine only. One that other machines can reach
    needs --allow-others."""
    allow_others: tyro.conf.FlagCreatePairsOff[bool] = False
    """Confirm that other machines may reach --ip, and other users of this one too: they can move
    the simulated robot and inject faults."""
    condition: str = "none"
    """Condition that perturbs the simulated robot, as in a study."""
    plant: str = "simulator"
    """Driver whose plant is the robot."""
    cables: str = "catenary"
    """Cable model of the driver `simulator`."""
    start: Place = None
    """Where the platform is at power-on, x y z in m; by default at home."""
    cycle: float = 0.005
    """Period of the PLC in s."""
    watchdog: float = 0.5
    """Silence of the host in s after which the winches ramp to rest; the default suits a busy
    desk, a plant needs 0.1."""
    shift: float = 0.0
    """Standard deviation in m of the offset of the encoders after power-on."""
    load_cells: bool = True
    """Whether the tensions are measured."""
    encoder_check: bool = True
    """Whether the PLC itself stops when a position jumps."""
    priority: bool = False
    """Run before all ordinary processes, as a PLC does; on Linux, with the permission to."""
    duration: float | None = None
    """How long to run in s; by default until Ctrl-C or SIGTERM."""
    fault: Annotated[
        tuple[str, ...], tyro.conf.arg(metavar="KIND=CABLE"), tyro.conf.UseAppendAction
    ] = ()
    """Cable wired the other way than in the robot file: `wrong_sign=CABLE` (encoder and drive) or
    `reversed_drive=CABLE` (the drive alone), by name or number; may be given several times."""
    control: bool = False
    """Read lines of the standard input that do something to the machine."""
    print_machine: bool = False
    """Print the constants `ST_Machine` of the robot file as Structured Text for the program of a
    real PLC, and end."""


def run(options: Options) -> CommandResult:
    """Run the PLC."""
    if options.ip is not None:
        consequence = "move the simulated robot and inject faults"
        check_reach("--ip", options.ip, options.allow_others, consequence)
    if options.priority:
        take_priority("carosac plc")
    nominal = load_robot(options.robot)
    if options.print_machine:
        print(declaration(nominal))
        values = machine_values(nominal)
        return CommandResult(values | {"hash": hash_text(values["hash"]),
                                       "name": list(nominal.cable_names)})  # fmt: skip
    condition = find_condition(options.condition).of(nominal)
    plant = draw_plant(nominal, condition, np.random.default_rng(options.seed))
    settings = EmulatorSettings(
        wrong_sign=_cables(options.fault, "wrong_sign", nominal),
        reversed_drive=_cables(options.fault, "reversed_drive", nominal),
        plant=options.plant, cables=options.cables, cycle=options.cycle,
        watchdog=options.watchdog, shift=options.shift, has_tension=options.load_cells,
        encoder_check=options.encoder_check, start_position=options.start,
        wind_force=condition.wind_force,
    )  # fmt: skip
    emulator = Emulator(
        plant, nominal, settings,
        seed=options.seed, ip=options.ip, allow_others=options.allow_others,
    )  # fmt: skip
    with_signals(emulator)
    if options.control:
        threading.Thread(target=listen, args=(emulator,), daemon=True).start()
    ads = emulator.hardware.ads
    print(f"carosac plc: ready: {nominal.name} at {emulator.ip}:48898, net id {emulator.ip}.1.1, "
          f"{ads.from_host}, {ads.to_host}", flush=True)  # fmt: skip
    try:
        with short_pauses():
            emulator.run(options.duration)
    finally:
        emulator.close()
    counters = emulator.diagnosis()
    print(f"carosac plc: {summary(counters)}")
    late = counters["overruns"] > LATE_CYCLES_MAX * max(1, counters["cycles"])
    return CommandResult(counters, status=int(late))


def _cables(faults: tuple[str, ...], wanted: str, robot: Robot) -> tuple[int, ...]:
    """Return the cables of one kind of fault, from 0."""
    cables = []
    for text in faults:
        kind, _, cable = text.partition("=")
        names = [*robot.cable_names, *(str(i + 1) for i in range(robot.n))]
        if kind not in WIRING_FAULTS or cable not in names:
            allowed = f"{' or '.join(WIRING_FAULTS)}, '=' and one of {', '.join(names)}"
            raise InvalidField("--fault", repr(text), allowed)
        if kind == wanted:
            cables.append(names.index(cable) % robot.n)
    return tuple(cables)


def with_signals(emulator: Emulator) -> None:
    """Stop the PLC at Ctrl-C and SIGTERM."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: emulator.stop())


def summary(counters: dict[str, Any]) -> str:
    """Return the counters in one line."""
    over = {name: counters[f"over_{name}"] for name in ("length", "speed", "acceleration", "jerk")}
    limits = ", ".join(f"{name} {count}" for name, count in over.items())
    return (
        "{cycles} cycles, {overruns} late, {lost_time:.3f} s lost; "
        "{commands} commands, {lost} lost, {not_finite} not finite; "
        "over limits: {limits}; beyond ends {beyond_ends}; watchdog {watchdog}"
    ).format(limits=limits, **counters)


def obey(emulator: Emulator, line: str) -> str:
    """Carry out one line of the standard input.

    Returns:
        Answer to print.

    Raises:
        CarosacError: No such line, or it cannot be done now.
    """
    word, *rest = line.split()
    if word == "quit":
        emulator.stop()
        return "ok"
    if word == "state":
        machine = emulator.machine
        state = {"state": machine.state, "fault": machine.fault, "axis": machine.fault_axis}
        return json.dumps(state | {"owner": machine.owner or None})  # the host it obeys
    kinds = {kind.name.lower().replace("_", "-"): kind for kind in Injection if kind}
    if word not in kinds:
        raise InvalidField("control", repr(line.strip()), f"{', '.join(kinds)}, state, quit")
    emulator.inject(kinds[word], **_arguments(kinds[word], rest))
    return "ok"


def _arguments(kind: Injection, words: list[str]) -> dict[str, Any]:
    """Return the arguments of an injection from its words."""
    try:
        numbers = [{"on": 1.0, "off": 0.0}.get(word) for word in words]
        values = [float(w) if x is None else x for w, x in zip(words, numbers, strict=True)]
    except ValueError as error:
        raise InvalidField("control", repr(" ".join(words)), "numbers, on or off") from error
    if kind == Injection.PLACE:
        if len(values) != 3:
            raise InvalidField("control", f"{len(values)} numbers", "x y z in m")
        return {"position": values}
    if kind in (Injection.TRIP, Injection.JUMP):
        axis, *values = [0.0] if not values else values
        return {"axis": int(axis), "value": values[0] if values else 1.0}
    if kind == Injection.NETWORK:
        return dict(zip(("value", "second"), values, strict=False))
    return {"value": values[0] if values else 1.0}


def listen(emulator: Emulator) -> None:
    """Obey lines of the standard input until it ends."""
    for line in sys.stdin:
        if not line.strip():
            continue
        try:
            print(f"carosac plc: {obey(emulator, line)}", flush=True)
        except CarosacError as error:
            print(f"carosac plc: refused: {error}", flush=True)
    emulator.stop()
