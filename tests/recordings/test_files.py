from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import loadmat, savemat

from carosac_toolkit.base.errors import CarosacError, InvalidField, InvalidFile, MissingFile
from carosac_toolkit.recordings.files import export_tum, load_recording, save_recording
from carosac_toolkit.recordings.recording import Recording
from tests.recordings.synthetic import assert_same, full_recording

LOSSLESS = ("parquet", "csv")


@pytest.fixture
def recording() -> Recording:
    return full_recording()


# Round trips


@pytest.mark.parametrize("suffix", LOSSLESS)
@pytest.mark.parametrize("n", [1, 4, 12])
def test_every_bit_comes_back(tmp_path, suffix, n):
    recording = full_recording(n=n, seed=n)
    path = tmp_path / f"run.{suffix}"
    save_recording(recording, path)
    assert_same(load_recording(path), recording)
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", LOSSLESS)
def test_extreme_numbers_come_back(tmp_path, suffix):
    lengths = np.array([[5e-324, 1.7976931348623157e308], [0.1 + 0.2, 1 / 3]])
    recording = Recording(time=np.array([1.7e9 + 1e-6, 1.7e9 + 2e-6]), unstrained_length=lengths)
    save_recording(recording, tmp_path / f"run.{suffix}")
    assert_same(load_recording(tmp_path / f"run.{suffix}"), recording)


@pytest.mark.parametrize("suffix", LOSSLESS)
@pytest.mark.parametrize(
    "absent",
    [
        "tension",
        "poses",
        "imu",
        "command",
        "exit_points",
        "swivel_angle",
        "attitude",
        "inclination",
    ],
)
def test_an_absent_channel_stays_absent(tmp_path, suffix, absent):
    recording = full_recording(**{absent: None})
    save_recording(recording, tmp_path / f"run.{suffix}")
    assert_same(load_recording(tmp_path / f"run.{suffix}"), recording)


def test_a_plain_table_has_swivel_angles_attitude_and_inclination(tmp_path):
    path = tmp_path / "run.csv"
    names = [
        "time_s", "cable_length_1_m", "swivel_angle_1_rad",
        *(f"attitude_quaternion_{axis}" for axis in "wxyz"),
        "inclination_roll_rad", "inclination_pitch_rad",
    ]  # fmt: skip
    path.write_text(",".join(names) + "\n0,5,0.1,0.6,0,0.8,0,,\n1,5,,,,,,0.02,0.03\n")
    recording = load_recording(path)
    assert recording.swivel_angle.value.tolist() == [[0.1]]
    assert recording.attitude.value.tolist() == [[0.6, 0.0, 0.8, 0.0]]
    assert recording.inclination.time.tolist() == [1.0]
    assert recording.inclination.value.tolist() == [[0.02, 0.03]]
    path.write_text(path.read_text().replace("0.6,0,0.8", "0.6,0,0.6"))
    with pytest.raises(InvalidFile, match=r"'attitude_quaternion_w' to .*: got norm 0\.84"):
        load_recording(path)


def test_formats_convert_into_each_other_without_loss(tmp_path, recording):
    save_recording(recording, tmp_path / "a.csv")
    save_recording(load_recording(tmp_path / "a.csv"), tmp_path / "b.parquet")
    save_recording(load_recording(tmp_path / "b.parquet"), tmp_path / "c.csv")
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "c.csv").read_bytes()


def test_parquet_is_one_table_sorted_by_time_with_nulls_and_a_document(tmp_path, recording):
    save_recording(recording, tmp_path / "run.parquet")
    table = pq.read_table(tmp_path / "run.parquet")
    time = table["time_s"].to_numpy()
    stamps = set(np.concatenate(list(recording.channel_times.values())).tolist())
    assert (np.diff(time) > 0).all()
    assert set(time.tolist()) == stamps
    assert table["tension_01_N"].null_count == len(stamps) - len(recording.tension.time)
    document = json.loads(table.schema.metadata[b"carosac"])
    assert document["schema"] == "carosac-recording/1"
    assert document["metadata"]["robot"] == "carosac"
    assert document["units"]["tension"] == "N"
    assert document["rates_hz"]["imu"] == pytest.approx(recording.rates["imu"])


def test_saving_replaces_a_file_whole_or_not_at_all(tmp_path, recording, monkeypatch):
    path = tmp_path / "run.csv"
    path.write_text("precious")

    def fail(*_: object) -> None:
        raise OSError("disk full")

    with monkeypatch.context() as patch:
        patch.setattr("carosac_toolkit.recordings.csv_file._cells", fail)
        with pytest.raises(CarosacError, match="cannot be written: disk full"):
            save_recording(recording, path)
    assert path.read_text() == "precious"
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.csv"]
    save_recording(recording, path)
    assert_same(load_recording(path), recording)


def test_saving_refuses_other_suffixes_and_folders(tmp_path, recording):
    with pytest.raises(InvalidField, match=r"path: got suffix '.xlsx' .* .parquet or .csv"):
        save_recording(recording, tmp_path / "run.xlsx")
    with pytest.raises(InvalidField, match=r"path: .*allowed: a file in an existing folder"):
        save_recording(recording, tmp_path / "nowhere" / "run.csv")
    assert not list(tmp_path.iterdir())


def test_tum_has_the_quaternion_scalar_last(tmp_path, recording):
    export_tum(recording, tmp_path / "run.tum")
    rows = np.loadtxt(tmp_path / "run.tum")
    np.testing.assert_array_equal(rows[:, 0], recording.poses.time)
    np.testing.assert_array_equal(rows[:, 1:4], recording.poses.position)
    np.testing.assert_array_equal(rows[:, 4:7], recording.poses.quaternion[:, 1:])
    np.testing.assert_array_equal(rows[:, 7], recording.poses.quaternion[:, 0])
    with pytest.raises(InvalidField, match="poses: got None"):
        export_tum(full_recording(poses=None), tmp_path / "other.tum")


# Tables of others


HEADER = "time_s,cable_length_1_m,cable_length_2_m"
POSES = "position_x_m,position_y_m,position_z_m,quaternion_w,quaternion_x,quaternion_y,quaternion_z"


def write(folder: Path, text: str, name: str = "run.csv") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_a_plain_csv_is_read_by_its_column_names(tmp_path):
    points = ",".join(f"exit_point_{i}_{axis}_m" for i in (1, 2) for axis in "xyz")
    rows = ["0,7,8,1,2,3,4,5,6", "0.5,7.5,8.5,1.5,2,3,4,5,6", "1,7,8,9,2,3,4,5,6"]
    loaded = load_recording(write(tmp_path, "\n".join([f"{HEADER},{points}", *rows, "", ""])))
    np.testing.assert_array_equal(loaded.unstrained_length, [[7, 8], [7.5, 8.5], [7, 8]])
    np.testing.assert_array_equal(loaded.exit_points, [[1.5, 2, 3], [4, 5, 6]])
    assert loaded.poses is None
    assert loaded.metadata.source == "run.csv"


def test_a_plain_parquet_with_other_number_types_is_read(tmp_path):
    table = pa.table({
        "time_s": pa.array([0, 1, 2], pa.int64()),
        "unstrained_length_1_m": pa.array([7.5, None, 7.25], pa.float32()),
        "tension_1_N": pa.array([None, 40, None], pa.int32()),
    })  # fmt: skip
    pq.write_table(table, tmp_path / "run.parquet")
    loaded = load_recording(tmp_path / "run.parquet")
    np.testing.assert_array_equal(loaded.time, [0, 2])
    np.testing.assert_array_equal(loaded.tension.time, [1])
    np.testing.assert_array_equal(loaded.tension.value, [[40]])


def test_rows_of_channels_with_other_times_have_empty_cells(tmp_path):
    text = f"{HEADER},tension_1_N,tension_2_N\n0,7,8,,\n0.1,,,30,40\n0.2,7,8,31,41\n"
    loaded = load_recording(write(tmp_path, text))
    np.testing.assert_array_equal(loaded.time, [0, 0.2])
    np.testing.assert_array_equal(loaded.tension.time, [0.1, 0.2])


# Faults


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file is empty"),
        ("# {}\n", "there is no header line"),
        (HEADER + "\n", "there is no row of data"),
        (HEADER.replace("time_s", "time") + "\n0,7,8\n",
         "column 'time_s' is missing; did you mean 'time'?"),
        ("time_s,cable_lenght_1_m\n0,7\n",
         "'cable_lenght_1_m' is unknown; did you mean 'cable_length_1_m'?"),
        ("time_s,position_x_m\n0,7\n", "column 'position_y_m' is missing"),
        ("time_s,cable_length_1_m,cable_length_3_m\n0,7,8\n",
         "column 'cable_length_2_m' is missing"),
        ("time_s,cable_length_1_m,cable_length_2_m,cable_length_3_m,tension_1_N,tension_2_N,"
         "tension_3_N,tension_4_N\n0,7,8,9,1,2,3,4\n",
         "1 fault\n  column 'cable_length_4_m' is missing"),
        ("time_s,unstrained_length_01_m,tension_01_N,tension_02_N\n0,7,1,2\n",
         "1 fault\n  column 'unstrained_length_02_m' is missing"),
        ("time_s;cable_length_1_m;cable_length_2_m\n0,0;7,1;8,1\n",
         "1 fault\n  the header line has no comma: is the separator ';'? allowed: ','"),
        ("time_s\tcable_length_1_m\n0\t7\n", "is the separator '\\t'?"),
        (f"{HEADER},position_x_m,position_y_m,position_z_m\n0,7,8,1,2,3\n",
         "1 fault\n  columns 'quaternion_w' to 'quaternion_z' are missing: a pose needs its "
         "orientation, because the cable lengths depend on it; positions alone are not read"),
        (HEADER + ",battery\n0,7,8,9\n",
         "column 'battery' is unknown and refused, as every extra column is: remove or rename it"),
        (HEADER + "," + 300 * "b" + "\n0,7,8,9\n", "column '" + 60 * "b" + "...' is unknown"),
        ("time_s,cable_length_1_m,unstrained_length_01_m\n0,7,8\n",
         "column 'unstrained_length_01_m' appears 2 times"),
        ("time_s,time_s,cable_length_1_m\n0,7,8\n", "column 'time_s' appears twice"),
        (HEADER + "\n0,7,8\n0.1,nan,8\n",
         "row 2 (line 3), column 'cable_length_1_m': got nan; allowed: a finite number"),
        (HEADER + "\n0,7,8\n0.1,7,\n",
         "row 2 (line 3), column 'cable_length_2_m': got nothing; allowed: a finite number"),
        (HEADER + "\n0,7,8\n0.1,7,8m\n",
         "line 3, column 'cable_length_2_m': got '8m'; allowed: a number"),
        (HEADER + "\n0,7,8\n0.1,7\n", "line 3: 2 cells; allowed: 3, as the header has"),
        (HEADER + "\n0,7,8\n0.2,7,8\n0.1,7,8\n",
         "row 3 (line 4), column 'time_s': got 0.1; allowed: > 0.2, the time of the row before"),
        (HEADER + "\n0,7,8\n0,7,8\n", "column 'time_s': got 0.0; allowed: > 0.0"),
        (HEADER + 2 * "\n4,7,8\n3,7,8\n2,7,8\n1,7,8",
         "1 fault\n  column 'time_s': got 6 of 8 times that are not above the one before, the "
         "first in row 2 (line 3); allowed: rows sorted by time, of one run"),
        (HEADER + "\n,7,8\n", "row 1 (line 2), column 'time_s': got nothing; allowed: a finite"),
        (HEADER + "\n0,,\n", "the length columns are empty"),
        (HEADER + "\n0,7,-8\n", "unstrained_length[0, 1]: got -8.0 m; allowed: > 0 m"),
        (f"{HEADER},{POSES}\n0,7,8,0,0,0,0,0,0,0\n",
         "row 1 (line 2), columns 'quaternion_w' to 'quaternion_z': got norm 0; allowed: within"),
        (f"{HEADER},{POSES}\n0,7,8,0,0,0,2,0,0,0\n", "got norm 2; allowed: within 0.001 of 1"),
        ("# {broken\n" + HEADER, "line 1: the comment lines at the top are not a JSON document"),
        ("# []\n" + HEADER, "the comment lines at the top are not a JSON object"),
        ('# {"schema": "carosac-recording/2"}\n' + HEADER + "\n0,7,8\n",
         "schema: got 'carosac-recording/2'; allowed: 'carosac-recording/1'"),
        ('# {"schema": "carosac-recording/1", "rows": 2}\n' + HEADER + "\n0,7,8\n",
         "the file is truncated: 1 of 2 rows are there"),
        ('# {"schema": "carosac-recording/1", "metadata": {"robt": "x"}}\n' + HEADER + "\n0,7,8\n",
         "did you mean 'robot'?"),
        ('# {"schema": "carosac-recording/1", "exit_points_m": [[1]]}\n' + HEADER + "\n0,7,8\n",
         "exit_points: got shape (1, 1); allowed: shape (2, 3)"),
    ],
)  # fmt: skip
def test_a_faulty_csv_gets_one_clear_message(tmp_path, text, message):
    path = write(tmp_path, text)
    with pytest.raises(InvalidFile) as caught:
        load_recording(path)
    assert message in str(caught.value)
    assert str(caught.value).startswith(str(path))


def test_all_faults_come_in_one_message_but_no_flood(tmp_path):
    rows = "".join(f"{i},x,8\n" for i in range(50))
    with pytest.raises(InvalidFile) as caught:
        load_recording(write(tmp_path, f"{HEADER}\n{rows}"))
    assert len(caught.value.faults) == 21
    assert caught.value.faults[-1] == "and 30 more"


def test_a_missing_file_suggests_a_neighbour(tmp_path, recording):
    save_recording(recording, tmp_path / "monday.csv")
    with pytest.raises(MissingFile, match=r"mondy.csv: no such file; did you mean '.*monday.csv'"):
        load_recording(tmp_path / "mondy.csv")
    with pytest.raises(MissingFile, match="there is no folder"):
        load_recording(tmp_path / "nowhere" / "monday.csv")


def test_wrong_suffix_folder_and_wrong_content(tmp_path, recording):
    with pytest.raises(InvalidField, match=r"suffix '.txt' .* allowed: .*.parquet, .csv, .mat"):
        load_recording(write(tmp_path, HEADER, "run.txt"))
    with pytest.raises(InvalidFile, match="this is a folder"):
        load_recording(tmp_path)
    save_recording(recording, tmp_path / "run.parquet")
    (tmp_path / "run.parquet").rename(tmp_path / "run.csv")
    with pytest.raises(InvalidFile, match=r"the content is that of a .parquet file; rename it"):
        load_recording(tmp_path / "run.csv")


@pytest.mark.parametrize("suffix", LOSSLESS)
def test_a_file_cut_anywhere_is_refused_in_one_message(tmp_path, suffix, recording):
    path = tmp_path / f"run.{suffix}"
    save_recording(recording, path)
    whole = path.read_bytes()
    for size in (1, len(whole) // 5, len(whole) // 2, len(whole) - 9, len(whole) - 1):
        path.write_bytes(whole[:size])
        with pytest.raises(CarosacError):
            load_recording(path)


@pytest.mark.parametrize("suffix", [*LOSSLESS, "mat"])
def test_garbage_is_refused_in_one_message(tmp_path, suffix):
    garbage = np.random.default_rng(0).integers(0, 256, 4000, dtype=np.uint8).tobytes()
    path = tmp_path / f"run.{suffix}"
    for data in (garbage, b"\0" * 4000, b"MATLAB 5.0 MAT-file" + garbage):
        path.write_bytes(data)
        with pytest.raises(InvalidFile):
            load_recording(path)


def test_faults_of_parquet_columns_name_them(tmp_path):
    path = tmp_path / "run.parquet"
    pq.write_table(pa.table({"time_s": [0.0, 1.0], "unstrained_length_01_m": ["a", "b"]}), path)
    with pytest.raises(InvalidFile, match=r"'unstrained_length_01_m': got type string; allowed: n"):
        load_recording(path)
    lengths = pa.array([7.0, np.nan, 7.0], from_pandas=False)
    pq.write_table(pa.table({"time_s": [0.0, 1.0, 2.0], "unstrained_length_01_m": lengths}), path)
    with pytest.raises(InvalidFile, match=r"row 2, column 'unstrained_length_01_m': got nan"):
        load_recording(path)


# The published layout


def mat_variables(count: int = 5) -> dict[str, np.ndarray]:
    time = np.zeros((count, count))
    time[:, 0] = 0.25 * np.arange(count)
    poses = np.tile([0.1, 0.2, 0.3, 0.0, 1.0, 0.0, 0.0], (count, 1))
    pulleys = {f"pulley{k}_poses": np.full((count, 3), float(k)) for k in range(1, 5)}
    lengths = np.arange(1.0, 5.0) + np.ones((count, 1))
    return {"time_stamps": time, "measured_cable_lengths": lengths, "ef_poses": poses} | pulleys


def test_the_scampi_layout_is_read(tmp_path):
    savemat(tmp_path / "run.mat", mat_variables())
    loaded = load_recording(tmp_path / "run.mat")
    np.testing.assert_array_equal(loaded.time, 0.25 * np.arange(5))
    np.testing.assert_array_equal(loaded.unstrained_length[0], [2, 3, 4, 5])
    np.testing.assert_array_equal(loaded.poses.rotation[0], np.diag([1.0, -1.0, -1.0]))
    np.testing.assert_array_equal(loaded.exit_points[:, 0], [1, 2, 3, 4])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"ef_poses": None}, r"variable 'ef_poses' is missing"),
        ({"ef_poses": None, "ef_pose": np.zeros((5, 7))}, r"missing; did you mean 'ef_pose'"),
        ({"ef_poses": np.zeros((4, 7))}, r"'ef_poses': got shape \(4, 7\); allowed: \(5, 7\)"),
        ({"ef_poses": np.zeros((5, 7))}, r"got norm 0; allowed: within"),
        ({"pulley2_poses": None}, r"pulleys .* allowed: 1 to 4"),
        (
            {"time_stamps": np.zeros((5, 5))},
            r"'time_s': got 4 of 5 times that are not above the one ",
        ),
    ],
)
def test_faults_of_the_scampi_layout(tmp_path, changes, message):
    variables = {k: v for k, v in (mat_variables() | changes).items() if v is not None}
    savemat(tmp_path / "run.mat", variables)
    with pytest.raises(InvalidFile, match=message):
        load_recording(tmp_path / "run.mat")


@pytest.mark.parametrize(("place", "value"), [(145, 255), (192, 0), (312, 0)])
def test_a_mat_file_that_ends_the_process_that_reads_it_is_refused(tmp_path, place, value):
    """One byte of a few hundred, over which scipy crashes."""
    count, path = 5, tmp_path / "run.mat"
    variables = {
        "time_stamps": np.arange(float(count))[:, None],
        "measured_cable_lengths": np.ones((count, 2)),
        "ef_poses": np.tile([0.0, 0, 0, 1, 0, 0, 0], (count, 1)),
        "s": {"a": 1},
    }
    savemat(path, variables)
    content = bytearray(path.read_bytes())
    content[place] = value
    path.write_bytes(content)
    with pytest.raises(
        InvalidFile, match=r"no whole MATLAB file.*: it ends the process that reads"
    ):
        load_recording(path)


# The real recording


def test_the_real_csv_and_mat_are_the_same_run(real_data):
    table = load_recording(real_data / "scampi_run_part.csv")
    layout = load_recording(real_data / "scampi_run_part.mat")
    assert (table.n, len(table.time), len(table.poses.time)) == (4, 600, 600)
    assert table.duration == pytest.approx(153.58, abs=0.01)
    # the text has nine significant digits of numbers below 154
    np.testing.assert_allclose(table.time, layout.time, atol=1e-6)
    np.testing.assert_allclose(table.unstrained_length, layout.unstrained_length, atol=1e-7)
    np.testing.assert_allclose(table.poses.position, layout.poses.position, atol=1e-7)
    np.testing.assert_allclose(table.poses.rotation, layout.poses.rotation, atol=1e-8)
    np.testing.assert_allclose(table.exit_points, layout.exit_points, atol=1e-7)


def test_the_real_chords_match_the_lengths(real_data):
    """Quaternion order and frames are right: chord and cable agree to sway and sag, centimetres."""
    run = load_recording(real_data / "scampi_run_part.csv")
    anchors = np.array([[-0.21, -0.21, -0.011], [0.21, -0.21, -0.011],
                        [0.21, 0.21, -0.011], [-0.21, 0.21, -0.011]])  # fmt: skip
    anchor_in_world = run.poses.position[:, None] + anchors @ run.poses.rotation.swapaxes(1, 2)
    chord = np.linalg.norm(run.exit_points - anchor_in_world, axis=2)
    assert np.abs((chord - run.unstrained_length).mean(axis=0)).max() < 0.012
    assert (chord - run.unstrained_length).std(axis=0).max() < 0.03


@pytest.mark.parametrize("suffix", LOSSLESS)
@pytest.mark.parametrize("source", ["csv", "mat"])
def test_the_real_recording_round_trips(real_data, tmp_path, suffix, source):
    run = load_recording(real_data / f"scampi_run_part.{source}")
    save_recording(run, tmp_path / f"run.{suffix}")
    assert_same(load_recording(tmp_path / f"run.{suffix}"), run)
    if source == "mat":
        published = loadmat(real_data / "scampi_run_part.mat")["measured_cable_lengths"]
        np.testing.assert_array_equal(run.unstrained_length, published)


def test_another_csv_of_the_folder_is_refused(real_data):
    with pytest.raises(InvalidFile, match="column 'motor_a_deg' is unknown"):
        load_recording(real_data / "hangprinter_hp4.csv")
