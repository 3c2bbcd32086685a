"""Recordings from the topics of a bag: each channel keeps its stamps, none is interpolated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.units import parse_quantity
from carosac_toolkit.base.version import __version__
from carosac_toolkit.interchange.bag import Bag
from carosac_toolkit.interchange.bag_channels import (
    STAMP_SOURCES,
    Nanoseconds,
    TopicSamples,
    attitudes,
    inertial,
    numbers,
    poses,
)
from carosac_toolkit.loop.values import Imu, Stamped
from carosac_toolkit.recordings.metadata import RecordingMetadata
from carosac_toolkit.recordings.poses import PoseSamples
from carosac_toolkit.recordings.recording import STAMPED_CHANNELS, Recording

_LENGTH_CHANNELS = ("command", "length_rate")  # in units of length, or of it per second
_DELAY_DIFFERENCE_MAX_S = 1.0  # [s] by which delays of two channels may differ before a warning


@dataclass(frozen=True, kw_only=True)
class Topics:
    """Topics by content; see `read_bag`.

    Attributes:
        lengths: One topic with a number for each cable, or one topic for each cable.
        tensions: In the same way, or nothing.
        commands: Commanded lengths, in the same way, or nothing.
        rates: Rates of the lengths, in the same way, or nothing.
        swivels: Swivel angles of the pulleys [rad], in the same way, or nothing.
        pose: A topic of poses, or None.
        imu: A topic of ``sensor_msgs/Imu``, or None.
        attitude: A topic of orientations of an AHRS, or None.
        inclination: A topic of roll and pitch of an inclinometer [rad], or one of each, or nothing.
        frames: Parent and child frame, where `pose` is a topic of many transforms.
        names: Names of the cables in a topic with names, such as JointState, in their order.
        together: Stamps of the topics of single cables that are one sample [s], or None.
        stamps: Preferred clock, `header` or `receive`.
        length_unit: Unit of lengths, commands and rates per second.
        length_kind: `unstrained` or `relative`.
        robot: Robot of the recording, for the metadata.
    """

    lengths: tuple[str, ...]
    tensions: tuple[str, ...] = ()
    commands: tuple[str, ...] = ()
    rates: tuple[str, ...] = ()
    swivels: tuple[str, ...] = ()
    pose: str | None = None
    imu: str | None = None
    attitude: str | None = None
    inclination: tuple[str, ...] = ()
    frames: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    together: float | None = None
    stamps: str = "header"
    length_unit: str = "m"
    length_kind: str = "unstrained"
    robot: str | None = None

    def __post_init__(self) -> None:
        """Refuse settings that no bag can satisfy."""
        if self.stamps not in STAMP_SOURCES:
            raise InvalidField("--stamps", repr(self.stamps), f"one of {', '.join(STAMP_SOURCES)}")
        if not self.lengths:
            allowed = "a topic with cable lengths; a recording needs them"
            raise InvalidField("--lengths", "nothing", allowed)
        if self.together is not None and not self.together > 0.0:
            raise InvalidField("--together", f"{self.together} s", "> 0")


@dataclass(frozen=True)
class Imported:
    """Recording, and notes on its import.

    Attributes:
        recording: Time 0 is the first stamp of all.
        channels: Samples by channel, as they were in the bag.
        notes: Omissions and merges.
        warnings: Likely mistakes.
    """

    recording: Recording
    channels: dict[str, TopicSamples]
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def read_bag(bag: Bag, topics: Topics) -> Imported:
    """Read a recording from a bag.

    Raises:
        InvalidField: Topics that are not there, or that do not make a recording.
    """
    notes: list[str] = []
    scale = parse_quantity(f"1 {topics.length_unit}", "m")
    channels: dict[str, TopicSamples] = {}
    for channel, option, specs in (
        ("unstrained_length", "--lengths", topics.lengths),
        ("tension", "--tension", topics.tensions),
        ("command", "--command", topics.commands),
        ("length_rate", "--rates", topics.rates),
        ("swivel_angle", "--swivel", topics.swivels),
    ):
        if specs:
            samples = _cables(bag, specs, option, topics, notes)
            channels[channel] = _in_order_of(channels.get("unstrained_length", samples), samples)
    if topics.pose is not None:
        channels["poses"] = poses(bag, topics.pose, stamps=topics.stamps, frames=topics.frames)
    if topics.imu is not None:
        channels["imu"] = inertial(bag, topics.imu, stamps=topics.stamps)
    if topics.attitude is not None:
        channels["attitude"] = attitudes(bag, topics.attitude, stamps=topics.stamps)
    if topics.inclination:
        channels["inclination"] = _roll_and_pitch(bag, topics, notes)
    if topics.names and not any(samples.labels for samples in channels.values()):
        raise InvalidField("--names", " ".join(topics.names), "none, as these topics have no names")
    for channel, samples in channels.items():
        if samples.repeated:
            notes.append(f"{channel}: {samples.repeated} messages with the stamp of an earlier one")
    start = min(int(samples.time[0]) for samples in channels.values())
    recording = _recording(channels, start, scale, topics, bag)
    return Imported(recording, channels, notes, _clock_warnings(channels))


def _cables(
    bag: Bag, specs: Sequence[str], option: str, topics: Topics, notes: list[str]
) -> TopicSamples:
    """Return a number per cable: from one topic, or from one topic per cable."""
    each = [numbers(bag, spec, option, stamps=topics.stamps, names=topics.names) for spec in specs]
    if len(each) == 1:
        return each[0]
    wide = [samples.topic for samples in each if samples.value.shape[1] != 1]
    if wide:
        allowed = "one number a message, where there is a topic for each cable"
        raise InvalidField(option, f"several numbers in {wide[0]}", allowed)
    if len({samples.clock for samples in each}) > 1:
        allowed = "topics with stamps of one clock; --stamps receive takes that of the recorder"
        raise InvalidField(option, "some topics with header stamps, some without", allowed)
    rows = _matched(each, topics.together, option)
    first = each[0]
    kept = np.all([row >= 0 for row in rows], axis=0)
    if not kept.all():
        notes.append(f"{option}: {np.sum(~kept)} of {len(kept)} samples without all cables")
    value = np.column_stack(
        [samples.value[row[kept], 0] for samples, row in zip(each, rows, strict=True)]
    )
    if not len(value):
        raise InvalidField(option, "no sample with all cables", "topics recorded together")
    title = ", ".join(samples.topic for samples in each)
    repeated = sum(samples.repeated for samples in each)
    labels = tuple(samples.topic for samples in each)
    return TopicSamples(title, first.time[kept], value, first.clock, first.behind, repeated, labels)


def _roll_and_pitch(bag: Bag, topics: Topics, notes: list[str]) -> TopicSamples:
    """Return roll and pitch: from one topic, or from one topic of each."""
    unnamed = replace(topics, names=())
    samples = _cables(bag, topics.inclination, "--inclination", unnamed, notes)
    if samples.value.shape[1] != 2:
        got = f"{samples.value.shape[1]} numbers in {samples.topic}"
        raise InvalidField("--inclination", got, "two: roll and pitch [rad]")
    return samples


def _in_order_of(lengths: TopicSamples, samples: TopicSamples) -> TopicSamples:
    """Return the columns in the order of the lengths, if their names are the same."""
    names = list(samples.labels)
    if samples.labels == lengths.labels or set(names) != set(lengths.labels):
        return samples
    columns = [names.index(name) for name in lengths.labels]
    return replace(samples, value=samples.value[:, columns], labels=lengths.labels)


def _matched(
    each: Sequence[TopicSamples], together: float | None, option: str
) -> list[np.ndarray[tuple[int], np.dtype[np.int64]]]:
    """Return the row of each topic that belongs to a sample of the first topic, or -1."""
    first = each[0].time
    rows = []
    worst = 0
    for samples in each:
        near = _nearest(samples.time, first)
        distance = np.abs(samples.time[near] - first)
        worst = max(worst, int(np.percentile(distance, 99)))
        limit = 0 if together is None else round(together * 1e9)
        rows.append(np.where(distance <= limit, near, -1))
    if together is None and worst > 0:
        got = f"topics whose stamps differ by {1e-9 * worst:.3g} s"
        allowed = (
            f"topics of equal stamps; --together {2e-9 * worst:.1g} takes samples that near to "
            "each other as one, at the time of the first topic's"
        )
        raise InvalidField(option, got, allowed)
    return rows


def _nearest(time: Nanoseconds, when: Nanoseconds) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Return the index of the nearest stamp for each of others."""
    right = np.clip(np.searchsorted(time, when), 0, len(time) - 1)
    left = np.maximum(right - 1, 0)
    closer = np.abs(time[left] - when) < np.abs(time[right] - when)
    return np.where(closer, left, right).astype(np.int64)


def _recording(
    channels: dict[str, TopicSamples], start: int, scale: float, topics: Topics, bag: Bag
) -> Recording:
    """Return all channels on one clock that begins with the first sample."""
    lengths = channels["unstrained_length"]
    stamped: dict[str, Any] = {
        name: Stamped(
            time=_seconds(samples, start),
            value=(scale if name in _LENGTH_CHANNELS else 1.0) * samples.value,
        )
        for name in STAMPED_CHANNELS
        if (samples := channels.get(name)) is not None
    }
    where = channels.get("poses")
    imu = channels.get("imu")
    origin = f"time 0 is {start // 10**9}.{start % 10**9:09d} s since 1970"
    return Recording(
        time=_seconds(lengths, start),
        unstrained_length=scale * lengths.value,
        poses=None
        if where is None
        else PoseSamples(
            time=_seconds(where, start), position=where.value[:, :3], quaternion=where.value[:, 3:]
        ),
        imu=None
        if imu is None
        else Imu(
            time=_seconds(imu, start),
            angular_rate=imu.value[:, :3],
            specific_force=imu.value[:, 3:],
        ),
        metadata=RecordingMetadata(
            robot=topics.robot,
            description=f"imported from a bag; {origin}",
            source="; ".join([bag.name, *(f"{n}: {s.topic}" for n, s in channels.items())]),
            created_by=f"carosac import recording {__version__}",
            length_kind=topics.length_kind,
        ),
        **stamped,
    )


def _seconds(samples: TopicSamples, start: int) -> Array:
    """Convert stamps to seconds since the first one."""
    return np.asarray((samples.time - start) / 1e9, dtype=np.float64)


def _clock_warnings(channels: dict[str, TopicSamples]) -> list[str]:
    """Return warnings of channels that can hardly share one clock."""
    warnings = []
    if len({samples.clock for samples in channels.values()}) > 1:
        late = ", ".join(name for name, s in channels.items() if s.clock == "receive")
        warnings.append(
            f"header stamps, but times of receipt for {late} (no header): their delay against each "
            "other is not known; --stamps receive takes times of receipt for all"
        )
    delays = {
        n: s.behind for n, s in channels.items() if s.behind is not None and s.clock == "header"
    }
    if delays and max(delays.values()) - min(delays.values()) > _DELAY_DIFFERENCE_MAX_S:
        text = ", ".join(f"{name} {delay:.3g} s" for name, delay in delays.items())
        warnings.append(f"header stamps of different clocks? received after their stamps: {text}")
    return warnings
