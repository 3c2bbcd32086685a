"""Make a recording from a bag of ROS 1 or 2 or an MCAP file, or align the clocks of one.

With a bag alone it lists the topics and says which may hold what. Each channel keeps its own time
stamps, those of message headers where there are any; nothing is interpolated.

carosac import recording run.bag

carosac import recording run.bag --lengths /joint_states --pose /mocap/pose --output run.parquet

With --align, the stamps of poses, length rates, tensions, IMU, swivel angles, AHRS and inclinometer
are shifted to the clock of the cable lengths, those of an AHRS with the IMU's if they are equal.
How far they are apart is estimated from what the lengths predict of each channel, which takes the
robot. A recording file is aligned in the same way:

carosac import recording run.csv --align --robot scampi --output aligned.parquet

An offset that is known otherwise is removed by --shift, of a channel that does not tell it too:

carosac import recording run.csv --shift attitude 2.0 --output aligned.parquet
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.files import check_writable
from carosac_toolkit.base.tables import format_table
from carosac_toolkit.cli.common import CommandResult, CommonOptions, OutputFile
from carosac_toolkit.interchange.bag import Bag, Topic, open_bag
from carosac_toolkit.interchange.bag_channels import (
    IMU_TYPE,
    LENGTH_TYPES,
    POSE_TYPES,
    TF_TYPES,
    has_orientation,
    numeric,
)
from carosac_toolkit.interchange.bag_recording import Imported, Topics, read_bag
from carosac_toolkit.recordings.encoders import calibrated
from carosac_toolkit.recordings.files import READERS_BY_SUFFIX, load_recording, save_recording
from carosac_toolkit.recordings.recording import Recording
from carosac_toolkit.recordings.robot import find_robot
from carosac_toolkit.validation.clocks import (
    ALIGNED_CHANNELS,
    ANGLE_CHANNELS,
    align_clocks,
    channel_clocks,
    not_aligned,
    remove_offsets,
)
from carosac_toolkit.validation.time_shift import TimeShift

_PER_CABLE = ("lengths", "tension", "command", "rates", "swivel")
_OTHER_CHANNELS = (*_PER_CABLE[1:], "pose", "imu", "attitude", "inclination", "output")
_OF_BAGS = (
    "lengths", *_OTHER_CHANNELS[:-1], "frames", "names", "length_unit", "relative", "stamps",
    "together", "definitions",
)  # fmt: skip
EXTRAS_OF_PARTS = {"ros": "bags"}  # `carosac --help` says so where one is not installed
CLOCK_HEADER = (
    "channel", "offset [ms]", "sigma [ms]", "explained", "jitter [ms]", "intervals [ms]",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Options(CommonOptions):
    """Options of ``carosac import recording``."""

    bag: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="BAG ...")]
    """A .bag of ROS 1 (or its parts), the folder of a ROS 2 bag, or a single .mcap or .db3; to
    align the clocks of a recording, its .parquet, .csv or .mat file."""
    output: OutputFile = None
    """Write the recording here (.parquet or .csv)."""
    lengths: Annotated[tuple[str, ...], tyro.conf.arg(metavar="TOPIC[.FIELD] ...")] = ()
    """Cable lengths: one topic with a number for each cable, or a topic for each cable. Known are
    arrays, JointState (position) and single numbers; of other messages name the FIELD, such as
    `/winches.drives.length`."""
    tension: Annotated[tuple[str, ...], tyro.conf.arg(metavar="TOPIC[.FIELD] ...")] = ()
    """Tensions at the platform [N], in the same way; of JointState the effort."""
    command: Annotated[tuple[str, ...], tyro.conf.arg(metavar="TOPIC[.FIELD] ...")] = ()
    """Commanded lengths, in the same way."""
    rates: Annotated[tuple[str, ...], tyro.conf.arg(metavar="TOPIC[.FIELD] ...")] = ()
    """Rates of the lengths, in the same way; of JointState the velocity."""
    swivel: Annotated[tuple[str, ...], tyro.conf.arg(metavar="TOPIC[.FIELD] ...")] = ()
    """Angles of the pulleys about their swivel axes [rad], in the same way; of JointState the
    position."""
    pose: Annotated[str | None, tyro.conf.arg(metavar="TOPIC[.FIELD]")] = None
    """Measured poses: PoseStamped, TransformStamped, Odometry, tf, or the FIELD with a pose."""
    frames: Annotated[tuple[str, ...], tyro.conf.arg(metavar="PARENT CHILD")] = ()
    """For a topic of tf: the frames of world and platform."""
    imu: Annotated[str | None, tyro.conf.arg(metavar="TOPIC")] = None
    """Inertial samples: sensor_msgs/Imu."""
    attitude: Annotated[str | None, tyro.conf.arg(metavar="TOPIC[.FIELD]")] = None
    """Orientation of an AHRS on the platform: sensor_msgs/Imu (orientation), QuaternionStamped, or
    the FIELD with a quaternion."""
    inclination: Annotated[tuple[str, ...], tyro.conf.arg(metavar="TOPIC[.FIELD] ...")] = ()
    """Roll and pitch of an inclinometer on the platform [rad]: one topic with two numbers, or one
    of each."""
    names: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")] = ()
    """For JointState: the joints of the cables, in the order of the robot's cables."""
    length_unit: Literal["m", "cm", "mm"] = "m"
    """Unit of lengths and commands; rates are in this unit per second."""
    relative: tyro.conf.FlagCreatePairsOff[bool] = False
    """Lengths are known only up to a constant per cable."""
    stamps: Literal["header", "receive"] = "header"
    """`header`: stamps of the message headers, where there are any; `receive`: when the recorder
    got the message."""
    together: float | None = None
    """With one topic per cable: merge samples whose stamps differ by at most this [s], at the time
    of the first topic's."""
    definitions: str | None = None
    """Folder with PACKAGE/msg/NAME.msg, for a bag that does not define its message types."""
    robot: str | None = None
    """Robot of the recording: a bundled name or a YAML file; kept in the recording."""
    align: tyro.conf.FlagCreatePairsOff[bool] = False
    """Shift the stamps of all channels but commands to the clock of the lengths; it needs --robot,
    or a recording that names its robot. Refused where a channel does not tell its offset, but for
    angles, which stay as they are then."""
    align_channels: tuple[
        Literal[
            "poses", "length_rate", "tension", "imu", "swivel_angle", "attitude", "inclination"
        ],
        ...,
    ] = ()
    """Channels to align; by default all that there are, but angles that do not tell their clock."""
    shift: Annotated[tuple[tuple[str, float], ...], tyro.conf.arg(metavar="CHANNEL S ...")] = ()
    """Known offsets of clocks, by which stamps of channels are late against those of the lengths
    [s]; they are removed, and not estimated: `--shift attitude 2.0 poses -0.5`. The channels are
    those of --align-channels."""


def run(options: Options) -> CommandResult:
    """List topics, or import."""
    check_writable("--output", options.output, (".parquet", ".csv"))
    if not options.bag:
        raise InvalidField("BAG", "nothing", "a bag; see 'carosac import recording --help'")
    if options.align_channels and not options.align:
        raise InvalidField("--align-channels", "channels", "nothing without --align")
    if _is_recording(options.bag):
        return _align_file(options)
    definitions = Path(options.definitions) if options.definitions else None
    with open_bag([Path(bag) for bag in options.bag], definitions=definitions) as bag:
        asked = [name for name in _OTHER_CHANNELS if getattr(options, name)]
        if not options.lengths and not asked:
            return _list(bag)
        imported = read_bag(bag, _topics(options))
    _say(imported)
    recording, clocks = _shifted(imported.recording, options), dict[str, Any]()
    if options.align:
        recording, clocks = _aligned(recording, Path(options.bag[0]), options)
    _save(recording, options.output)
    return CommandResult(_data(imported, recording) | clocks)


def _is_recording(paths: tuple[str, ...]) -> bool:
    """Tell whether the only input is a recording file rather than a bag."""
    return len(paths) == 1 and Path(paths[0]).suffix.lower() in READERS_BY_SUFFIX


def _align_file(options: Options) -> CommandResult:
    """Align the clocks of a recording file."""
    if not options.align and not options.shift:
        allowed = "a bag, or --align or --shift with a recording file"
        raise InvalidField("BAG", repr(options.bag[0]), allowed)
    for field in (field for field in fields(options) if field.name in _OF_BAGS):
        value = getattr(options, field.name)
        if value != field.default:
            said = " ".join(value) if isinstance(value, tuple) else str(value)
            allowed = "nothing with a recording file: its channels are known"
            raise InvalidField(f"--{field.name.replace('_', '-')}", said, allowed)
    path = Path(options.bag[0])
    recording, clocks = _shifted(load_recording(path), options), dict[str, Any]()
    if options.align:
        recording, clocks = _aligned(recording, path, options)
    if recording.metadata.robot is None:
        metadata = replace(recording.metadata, robot=options.robot)
        recording = replace(recording, metadata=metadata)
    _save(recording, options.output)
    return CommandResult({**clocks, "metadata": recording.metadata.to_dict()})


def _shifted(recording: Recording, options: Options) -> Recording:
    """Remove the offsets that are stated, and print them."""
    offsets = dict(options.shift)
    if len(offsets) < len(options.shift):
        raise InvalidField("--shift", " ".join(name for name, _ in options.shift), "a channel once")
    both = sorted(offsets.keys() & set(options.align_channels))
    if both:
        raise InvalidField("--shift", both[0], "a channel that --align-channels does not name")
    if not offsets:
        return recording
    if options.output is None:
        raise InvalidField("--output", "nothing", "a file, in which --shift moves the stamps")
    try:
        shifted = remove_offsets(recording, offsets)
    except InvalidField as error:
        raise InvalidField("--shift", error.value, error.allowed) from error
    for name, seconds in offsets.items():
        print(f"{name}: {seconds:+g} s, as stated, removed from its stamps")
    return shifted


def _aligned(
    recording: Recording, path: Path, options: Options
) -> tuple[Recording, dict[str, Any]]:
    """Align clocks and print by how much; return the numbers too."""
    robot = find_robot(recording, path, options.robot).robot
    recording.require_cables(robot)
    stated = dict(options.shift)
    usual = tuple(name for name in ALIGNED_CHANNELS if name not in stated)
    channels = tuple(dict.fromkeys(options.align_channels)) or usual
    for name in options.align_channels:
        if name not in recording.channel_times:
            allowed = f"of {[c for c in ALIGNED_CHANNELS if c in recording.channel_times]}"
            raise InvalidField("--align-channels", name, allowed)
    every = channel_clocks(calibrated(recording, robot), robot, channels)
    untold = {
        clock.channel: clock.reason
        for clock in every
        if clock.shift is None
        and clock.channel in ANGLE_CHANNELS
        and clock.channel not in options.align_channels
    }
    clocks = [clock for clock in every if clock.channel not in untold]
    if untold and not clocks:
        raise CarosacError(
            "no clock can be aligned: "
            + ", ".join(f"{name}: {reason}" for name, reason in untold.items())
        )
    aligned = align_clocks(recording, clocks)
    rows = [
        (clock.channel, f"{1e3 * clock.shift.seconds:+.2f}", f"{1e3 * clock.shift.sigma:.2f}",
         f"{clock.shift.explained:.2%}",
         _jitter(clock.shift),
         f"{1e3 * clock.interval_deviation:.2f}")
        for clock in clocks if clock.shift is not None
    ]  # fmt: skip
    print(format_table(CLOCK_HEADER, rows))
    print("\nOffset: of the stamps against the clock of the lengths; it is removed from them.")
    left = [name for name in not_aligned(recording, clocks) if name not in stated]
    if left:
        words = [f"{name} ({untold[name]})" if name in untold else name for name in left]
        print(f"Not aligned: {', '.join(words)}.")
    return aligned, {"clocks": {clock.channel: clock.data() for clock in every}}


def _jitter(shift: TimeShift) -> str:
    """Format the jitter of single stamps [ms]."""
    if not np.isfinite(shift.jitter):
        return ""
    return f"{1e3 * shift.jitter:.2f} +-{1e3 * shift.jitter_sigma:.2f}"


def _save(recording: Recording, output: Path | None) -> None:
    """Write the recording where one is asked for."""
    if output is not None:
        save_recording(recording, output)
        print(f"\nrecording: {output}; next: carosac validate {output}")


def _topics(options: Options) -> Topics:
    """Return the topics that the options name."""
    if options.frames and len(options.frames) != 2:
        raise InvalidField("--frames", " ".join(options.frames), "two: PARENT CHILD")
    if options.frames and options.pose is None:
        raise InvalidField("--frames", " ".join(options.frames), "nothing without --pose")
    several = (*_PER_CABLE, "inclination")
    single = max(len(getattr(options, name)) for name in several) < 2
    if options.together is not None and single:
        allowed = "nothing without a topic for each cable"
        raise InvalidField("--together", f"{options.together} s", allowed)
    return Topics(
        lengths=options.lengths,
        tensions=options.tension,
        commands=options.command,
        rates=options.rates,
        swivels=options.swivel,
        pose=options.pose,
        imu=options.imu,
        attitude=options.attitude,
        inclination=options.inclination,
        frames=options.frames,
        names=options.names,
        together=options.together,
        stamps=options.stamps,
        length_unit=options.length_unit,
        length_kind="relative" if options.relative else "unstrained",
        robot=options.robot,
    )


def _list(bag: Bag) -> CommandResult:
    """List all topics and their possible uses."""
    rows = [
        (topic.name, topic.kind, topic.count, "" if topic.rate is None else f"{topic.rate:.1f}",
         _use(bag, topic))
        for topic in bag.topics.values()
    ]  # fmt: skip
    print(format_table(("topic", "type", "messages", "rate [Hz]", "may be"), rows))
    print("\nName the topics: --lengths /joint_states --pose /mocap/pose --output run.parquet")
    if bag.assumed:
        print("The bag does not define its message types; those of ROS 2 are assumed.")
    data = [
        {"topic": topic.name, "type": topic.kind, "messages": topic.count, "rate_Hz": topic.rate}
        for topic in bag.topics.values()
    ]
    return CommandResult({"topics": data})


def _use(bag: Bag, topic: Topic) -> str:
    """Name the option that fits a message type; for unknown types the numeric fields."""
    kind = topic.kind
    if kind == IMU_TYPE:
        first = bag.first(topic.name)
        return "--imu" if first is None or not has_orientation(first) else "--imu, --attitude"
    if kind in TF_TYPES:
        return "--pose, with --frames"
    if kind in POSE_TYPES:
        return "--pose"
    if kind in LENGTH_TYPES:
        return "--lengths, --tension, --swivel"
    fields = numeric(bag.first(topic.name))
    return f"{topic.name}.FIELD of {fields}" if fields else ""


def _say(imported: Imported) -> None:
    """Print channels, clocks and omissions."""
    rates = imported.recording.rates
    rows = [
        (
            name,
            samples.topic,
            len(samples.time),
            samples.value.shape[1],
            "" if rates[name] is None else f"{rates[name]:.1f}",
            samples.clock,
            "" if samples.behind is None else f"{1e3 * samples.behind:.1f}",
        )
        for name, samples in imported.channels.items()
    ]
    header = (
        "channel",
        "topic",
        "samples",
        "columns",
        "rate [Hz]",
        "stamps",
        "received after [ms]",
    )
    print(format_table(header, rows))
    labels = imported.channels["unstrained_length"].labels
    if labels:
        print("\ncables: " + ", ".join(f"{i + 1} is {name}" for i, name in enumerate(labels)))
    for note in imported.notes:
        print(f"left out: {note}")
    for warning in imported.warnings:
        print(f"warning: {warning}")
    print(f"\n{imported.recording.duration:.3f} s, {imported.recording.n} cables; "
          f"{imported.recording.metadata.description}")  # fmt: skip


def _data(imported: Imported, recording: Recording) -> dict[str, Any]:
    """Return the numbers that ``--json`` writes."""
    return {
        "duration_s": recording.duration,
        "cables": recording.n,
        "channels": {
            name: {
                "topic": samples.topic,
                "samples": len(samples.time),
                "rate_Hz": recording.rates[name],
                "stamps": samples.clock,
                "received_after_s": samples.behind,
                "left_out": samples.repeated,
                "labels": list(samples.labels),
            }
            for name, samples in imported.channels.items()
        },
        "notes": imported.notes,
        "warnings": imported.warnings,
        "metadata": recording.metadata.to_dict(),
    }
