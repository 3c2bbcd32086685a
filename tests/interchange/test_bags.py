from __future__ import annotations

import numpy as np
import pytest

from carosac_toolkit.base.errors import CarosacError, InvalidField, InvalidFile
from carosac_toolkit.cli.main import main
from carosac_toolkit.interchange import bag_channels, bag_chunks
from carosac_toolkit.interchange.bag import open_bag
from carosac_toolkit.interchange.bag_recording import Topics, read_bag
from carosac_toolkit.recordings.files import load_recording, save_recording
from tests.interchange.bags import KINDS, START, Bags

RNG = np.random.default_rng(5)
LENGTHS = 5.0 + RNG.random((20, 4))  # of no round numbers
POSITIONS = RNG.normal(size=(10, 3))
WXYZ = RNG.normal(size=(10, 4))
WXYZ /= np.linalg.norm(WXYZ, axis=1, keepdims=True)
RATES, FORCES = RNG.normal(size=(40, 3)), RNG.normal(size=(40, 3))
NAMES = ["front_left", "front_right", "rear_right", "rear_left"]
LATE = 3_000_000  # [ns] from stamp to receipt
JOINTS, MOCAP, IMU = (
    "sensor_msgs/msg/JointState",
    "geometry_msgs/msg/PoseStamped",
    "sensor_msgs/msg/Imu",
)


def stamps(count, period):
    return [START + k * period for k in range(count)]


def run_messages(bags):
    order = [2, 0, 3, 1]  # joint states come in an order of their own
    messages = []
    for time, row in zip(stamps(20, 20_000_000), LENGTHS, strict=True):
        joints = bags.joints(time, [NAMES[i] for i in order], row[order])
        messages.append(("/joints", JOINTS, time + LATE, joints))
        messages.append(("/winches", "lab_msgs/msg/Winches", time + LATE, bags.winches(time, row)))
        array = bags.array(row)
        messages.append(("/array", "std_msgs/msg/Float64MultiArray", time + LATE, array))
        for i, value in enumerate(row):
            topic = f"/cable_{i}"
            messages.append((topic, "std_msgs/msg/Float64", time + i * 1000, bags.number(value)))
    for time, place, turn in zip(stamps(10, 35_000_000), POSITIONS, WXYZ, strict=True):
        messages.append(("/mocap", MOCAP, time + LATE, bags.pose(time, place, turn)))
        frames = [("world", "platform"), ("world", "camera")]
        tree = bags.transforms(time, frames, place, turn)
        messages.append(("/tf", "tf2_msgs/msg/TFMessage", time + LATE, tree))
    for time, rate, force in zip(stamps(40, 10_000_000), RATES, FORCES, strict=True):
        messages.append(("/imu", IMU, time + LATE, bags.imu(time, rate, force)))
    return sorted(messages, key=lambda message: message[2])


@pytest.fixture(scope="module", params=KINDS)
def path(request, tmp_path_factory):
    bags = Bags(request.param)
    return bags.write(tmp_path_factory.mktemp(request.param), run_messages(bags))


@pytest.fixture(scope="module")
def mcap(tmp_path_factory):
    bags = Bags("mcap")
    folder = bags.write(tmp_path_factory.mktemp("plain"), run_messages(bags))
    return folder / "run_mcap.mcap"


def read(path, **topics):
    with open_bag([path]) as bag:
        return read_bag(bag, Topics(**topics))


def test_every_number_comes_back_bit_for_bit_at_its_stamp(path, tmp_path):
    found = read(path, lengths=("/joints",), names=tuple(NAMES), pose="/mocap", imu="/imu")
    save_recording(found.recording, tmp_path / "run.parquet")
    run = load_recording(tmp_path / "run.parquet")
    assert np.array_equal(run.unstrained_length, LENGTHS)
    assert np.array_equal(run.time, np.arange(20) * 20_000_000 / 1e9)
    assert np.array_equal(run.poses.position, POSITIONS)
    assert np.array_equal(run.poses.quaternion, WXYZ)
    assert np.array_equal(run.poses.time, np.arange(10) * 35_000_000 / 1e9)
    assert np.array_equal(run.imu.angular_rate, RATES)
    assert np.array_equal(run.imu.specific_force, FORCES)
    assert "time 0 is 1700000000.123456789 s" in run.metadata.description
    assert {samples.clock for samples in found.channels.values()} == {"header"}
    assert found.channels["poses"].behind == pytest.approx(LATE * 1e-9)
    assert found.warnings == []


def test_plain_mcap_holds_the_same(mcap):
    run = read(mcap, lengths=("/joints",), names=tuple(NAMES)).recording
    assert np.array_equal(run.unstrained_length, LENGTHS)


def test_custom_messages_arrays_and_transforms_hold_the_same(path):
    found = read(
        path, lengths=("/winches.drives.length",), tensions=("/winches.drives.force",),
        commands=("/array",), rates=("/joints",), pose="/tf", frames=("world", "platform"),
    )  # fmt: skip
    run = found.recording
    assert np.array_equal(run.unstrained_length, LENGTHS)
    assert np.array_equal(run.tension.value, np.tile(100.0 + np.arange(4), (20, 1)))
    assert np.array_equal(run.command.value, LENGTHS)
    assert (run.length_rate.value == 0.25).all()
    assert np.array_equal(run.poses.position, POSITIONS)
    assert found.channels["command"].clock == "receive"  # an array has no header
    assert "their delay against each other is not known" in found.warnings[0]


def test_topics_of_single_cables_are_put_together_only_when_asked(mcap):
    topics = tuple(f"/cable_{i}" for i in range(4))
    with pytest.raises(
        InvalidField, match=r"stamps differ by 3e-06 s; allowed: .*--together 6e-06"
    ):
        read(mcap, lengths=topics)
    run = read(mcap, lengths=topics, together=1e-5).recording
    assert np.array_equal(run.unstrained_length, LENGTHS)
    assert np.array_equal(run.time, np.arange(20) * 20_000_000 / 1e9)
    backwards = read(mcap, lengths=topics[::-1], together=1e-5).recording
    assert np.array_equal(backwards.unstrained_length, LENGTHS[:, ::-1])


def test_swivel_angles_attitude_and_inclination_are_channels(mcap):
    run = read(
        mcap, lengths=("/array",), swivels=("/joints",), names=tuple(NAMES), attitude="/imu",
        inclination=("/imu.angular_velocity.x", "/imu.angular_velocity.y"),
    ).recording  # fmt: skip
    assert np.array_equal(run.swivel_angle.value, LENGTHS)  # positions of the joints
    np.testing.assert_allclose(np.linalg.norm(run.attitude.value, axis=1), 1.0, atol=1e-12)
    assert run.inclination.value.shape == (len(run.attitude.time), 2)
    np.testing.assert_array_equal(run.inclination.time, run.attitude.time)


def test_receipt_times_of_all_are_one_clock(mcap):
    topics = {"lengths": ("/array",), "pose": "/mocap", "stamps": "receive"}
    found = read(mcap, **topics)
    assert found.warnings == []
    assert found.recording.time[0] == found.recording.poses.time[0]


def test_millimetres_become_metres(mcap):
    run = read(mcap, lengths=("/array",), length_unit="mm").recording
    assert run.unstrained_length == pytest.approx(1e-3 * LENGTHS, rel=1e-15)


def test_late_and_repeated_messages_are_ordered_and_counted(tmp_path):
    bags = Bags("mcap")
    kind = JOINTS
    times = [START, START + 20_000_000, START + 10_000_000, START + 20_000_000]
    rows = [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0], [7.0, 8.0]]
    messages = [
        ("/joints", kind, START + k, bags.joints(time, NAMES[:2], row))
        for k, (time, row) in enumerate(zip(times, rows, strict=True))
    ]
    found = read(bags.write(tmp_path, messages), lengths=("/joints",))
    assert found.recording.unstrained_length.tolist() == [rows[0], rows[2], rows[1]]
    assert found.notes == ["unstrained_length: 1 messages with the stamp of an earlier one"]


def test_cables_have_one_order_in_all_topics_that_name_them(tmp_path):
    bags = Bags("ros1")
    messages = []
    for time in stamps(3, 10_000_000):
        lengths = bags.joints(time, ["a", "b", "c"], [1.0, 2.0, 3.0])
        forces = bags.joints(time, ["c", "a", "b"], [9.0, 9.0, 9.0])
        forces.effort = np.array([30.0, 10.0, 20.0])
        messages += [("/winches", JOINTS, time, lengths), ("/loads", JOINTS, time, forces)]
    with open_bag([bags.write(tmp_path, messages)]) as bag:
        found = read_bag(bag, Topics(lengths=("/winches",), tensions=("/loads",)))
    assert found.channels["tension"].labels == ("a", "b", "c")
    assert found.recording.tension.value[0].tolist() == [10.0, 20.0, 30.0]


def test_unset_headers_are_not_taken_for_the_year_1970(tmp_path):
    bags = Bags("mcap")
    messages = [
        ("/joints", JOINTS, START + k, bags.joints(0, NAMES[:1], [1.0 + k])) for k in range(3)
    ]
    found = read(bags.write(tmp_path, messages), lengths=("/joints",))
    assert found.channels["unstrained_length"].clock == "receive"


def test_a_rate_counts_the_gaps(mcap):
    with open_bag([mcap]) as bag:
        assert bag.topics["/joints"].count == 20
        assert bag.topics["/joints"].rate == pytest.approx(19 / 0.393, rel=1e-3)


@pytest.mark.parametrize(
    ("topics", "message"),
    [
        ({"lengths": ("/joint",)}, "--lengths: got '/joint'; .* did you mean '/joints'"),
        ({"lengths": ("/winches",)}, "FIELD one of drives.length, drives.force, supply"),
        ({"lengths": ("/winches.drives.label",)}, "a field with a number"),
        ({"lengths": ("/winches.drive.length",)}, "a field of the message: header, drives, supply"),
        ({"lengths": ("/joints",), "names": ("nobody",)}, "--names: got nobody in /joints"),
        ({"lengths": ("/array",), "names": ("a",)}, "--names: got a; allowed: none"),
        ({"lengths": ("/array",), "pose": "/tf"}, "--frames: got nothing; .* world camera"),
        ({"lengths": ("/array",), "pose": "/imu"}, "--pose: got '/imu'"),
        ({"lengths": ("/array",), "imu": "/mocap"}, "--imu: got '/mocap', geometry_msgs"),
        ({"lengths": ("/array",), "attitude": "/joints"}, "--attitude: got '/joints', sensor_msgs"),
        ({"lengths": ("/array",), "inclination": ("/array",)}, "4 numbers in /array.data; .* two"),
        ({"lengths": ("/array", "/array")}, "several numbers in /array.data"),
        ({"lengths": ()}, "a recording needs them"),
        ({"lengths": ("/array",), "stamps": "mine"}, "--stamps: got 'mine'"),
        ({"lengths": ("/array",), "together": 0.0}, "--together: got 0.0 s"),
    ],
)
def test_wrong_topics_are_one_message(mcap, topics, message):
    with pytest.raises(CarosacError, match=message):
        read(mcap, **topics)


@pytest.mark.parametrize("kind", KINDS)
def test_an_imu_without_orientation_gives_no_attitude(tmp_path, capsys, kind):
    bags = Bags(kind)
    path = bags.write(tmp_path, [
        *run_messages(bags),
        ("/bare", IMU, START + 10**9, bags.imu(START + 10**9, RATES[0], FORCES[0], oriented=False)),
    ])  # fmt: skip
    with pytest.raises(InvalidField, match="--attitude: got '/bare', without orientation"):
        read(path, lengths=("/array",), attitude="/bare")
    assert main(["import", "recording", str(path)]) == 0
    lines = {line.split()[0]: line for line in capsys.readouterr().out.splitlines() if line}
    assert "--imu, --attitude" in lines["/imu"]
    assert "--imu" in lines["/bare"] and "--attitude" not in lines["/bare"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9])
def test_cut_files_are_damaged_not_short(tmp_path, kind, share):
    bags = Bags(kind)
    path = bags.write(tmp_path, run_messages(bags))
    file = path if path.is_file() else next(f for f in path.iterdir() if f.suffix != ".yaml")
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    with pytest.raises(InvalidFile):
        read(path, lengths=("/joints",))


def test_definitions_of_a_folder_stand_in_for_those_of_the_bag(tmp_path):
    bags = Bags("sqlite3")
    path = bags.write(tmp_path, run_messages(bags))
    import sqlite3

    with sqlite3.connect(next(path.glob("*.db3"))) as base:  # as ROS 2 before Iron wrote it
        base.execute("DELETE FROM message_definitions")
    base.close()
    folder = tmp_path / "lab_msgs" / "msg"
    folder.mkdir(parents=True)
    from tests.interchange.bags import DRIVE, WINCHES

    (folder / "Winches.msg").write_text(WINCHES)
    (folder / "Drive.msg").write_text(DRIVE)
    with open_bag([path], definitions=tmp_path) as bag:
        assert bag.assumed
        run = read_bag(bag, Topics(lengths=("/winches.drives.length",))).recording
    assert np.array_equal(run.unstrained_length, LENGTHS)
    with (
        pytest.raises(InvalidField, match="--definitions"),
        open_bag([path], definitions=folder / "x"),
    ):
        pass


def test_other_files_are_no_bags(tmp_path):
    text = tmp_path / "run.txt"
    text.write_text("hello")
    with pytest.raises(InvalidField, match="BAG"), open_bag([text]):
        pass
    with pytest.raises(InvalidFile, match="no metadata"), open_bag([tmp_path]):
        pass


@pytest.mark.parametrize("compression", ["BZ2", "LZ4"])
def test_a_chunk_of_a_bag_that_decompresses_to_much_is_refused(tmp_path, compression, monkeypatch):
    from rosbags.rosbag1 import Writer

    monkeypatch.setattr(bag_chunks, "CHUNK_BYTES_MAX", 100_000)
    bags, path = Bags("ros1"), tmp_path / "run.bag"
    kind = "std_msgs/msg/Float64MultiArray"
    writer = Writer(path)
    writer.set_compression(Writer.CompressionFormat[compression])
    with writer:
        connection = writer.add_connection("/array", kind, typestore=bags.store)
        content = bags.store.serialize_ros1(bags.array(np.ones(100_000)), kind)
        writer.write(connection, 1, content)
    assert path.stat().st_size < 20_000
    with open_bag([path]) as bag, pytest.raises(InvalidFile, match="a chunk of more than"):
        bag.first("/array")


def test_a_message_of_thousands_of_numbers_is_no_row_of_a_recording():
    samples = bag_channels._Samples("run.bag")
    with pytest.raises(InvalidFile, match="has 8000 columns; allowed: up to 1000"):
        samples.add(1, None, np.ones(8000))


def test_messages_without_numbers_are_no_channel():
    samples = bag_channels._Samples("run.mcap")
    with pytest.raises(InvalidFile, match="no numbers in the messages of /lengths"):
        samples.ordered("/lengths", "header")
