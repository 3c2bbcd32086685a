"""`carosac workspace` as its user meets it."""

import csv
import json

import pyarrow.parquet as pq
import pytest

from carosac_toolkit.cli.main import main
from carosac_toolkit.robot.file import robot_text


def run(tmp_path, *words):
    out = tmp_path / "out"
    status = main(["workspace", *words, "--output", str(out), "--json", str(tmp_path / "w.json")])
    return status, out


def test_pictures_are_drawn(tmp_path):
    words = ("--box", "frame", "--points", "60", "--slice", "z=2", "--slice-points", "40")
    status, out = run(tmp_path, "cogiro", *words)
    assert status == 0
    names = {path.name for path in out.iterdir()}
    ends = ("png", "svg", "pdf")
    pictures = {f"{name}.{end}" for name in ("slices", "space", "maps_z_2") for end in ends}
    assert names == {*pictures, "positions.csv", ".carosac-results"}
    begins = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}
    for name in pictures:
        assert (out / name).read_bytes().startswith(begins[name.rpartition(".")[2]])


def test_table_numbers_and_words(tmp_path, capsys):
    status, out = run(
        tmp_path, "cogiro", "--box", "frame", "--points", "150", "--slice-points", "60",
        "--slice", "z=2", "x=0", "--model", "both", "--no-pictures",
    )  # fmt: skip
    assert status == 0
    said = capsys.readouterr().out
    assert "cogiro can hold its platform in" in said and "sag takes" in said
    data = json.loads((tmp_path / "w.json").read_text())
    assert data["sentence"] in said
    assert data["inside"] + sum(row["positions"] for row in data["limits"]) == data["positions"]
    assert data["volume_m3"] == pytest.approx(data["share"] * data["box_m3"])
    assert set(data["models"]) == {"sag", "straight"}
    assert [part["plane"] for part in data["slices"]["sag"]] == ["z=2", "x=0"]
    assert {path.name for path in out.iterdir()} == {
        "positions-sag.csv", "positions-straight.csv", ".carosac-results",
    }  # fmt: skip
    with (out / "positions-sag.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == data["positions"]
    assert sum(row["inside"] == "1" for row in rows) == data["inside"]
    for row in rows:
        assert (row["limit"] == "inside") == (row["inside"] == "1")
        if row["inside"] == "1":
            tension = [float(row[f"tension_{k:02d}_N"]) for k in range(1, 9)]
            margin = min(min(t - 10.0, 5000.0 - t) for t in tension)
            # A cable that could not hang with tension_min has a higher limit: never above.
            assert float(row["margin_N"]) <= margin + 1e-5
            assert float(row["frequency_Hz"]) > 0.0 and float(row["sag_m"]) >= 0.0


@pytest.mark.parametrize(
    ("box", "status"), [([], 0), (["--lower", "9", "9", "9", "--upper", "10", "10", "10"], 1)]
)
def test_what_sag_changes_is_said_where_there_is_a_margin(tmp_path, capsys, box, status):
    words = ["workspace", "hangprinter", "--box", "frame", "--points", "60", "--model", "both"]
    more = ["--slice-points", "4", "--no-pictures", "--output", str(tmp_path), *box]
    assert main([*words, *more]) == status
    out = capsys.readouterr().out
    assert "sag takes 0 positions" in out and "nan" not in out
    assert ("where both can, the margin changes by" in out) is (status == 0)


def test_nowhere_is_status_1_and_parquet_is_read_back(tmp_path, capsys):
    status, out = run(
        tmp_path, "carosac", "--lower", "0", "-2", "9", "--upper", "1", "-1", "10", "--points",
        "30", "--slice-points", "20", "--table", "parquet", "--no-pictures",
    )  # fmt: skip
    assert status == 1
    assert "nowhere in the box" in capsys.readouterr().out
    table = pq.read_table(out / "positions.parquet").to_pydict()
    assert not any(table["inside"]) and set(table["limit"]) == {"no cable pulls there"}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["carosac", "--rpy-deg", "0,0,0"], "4 cables of carosac leave the orientation free"),
        (["cogiro", "--rpy-deg", "0;0"], "ROLL,PITCH,YAW in degrees"),
        (["carosac", "--slice", "z=99"], "'z=99'; allowed: z=1 to z=5 m, the box searched"),
        (["carosac", "--slice", "q=1"], "x=, y= or z= with a number"),
        (["carosac", "--lower", "0", "0", "0"], "--lower and --upper go together"),
        (["carosac", "--lower", "0", "0", "3", "--upper", "1", "1", "2"], "below --upper"),
        (["carosac", "--points", "0"], "1 to 10000000"),
        (["carosac", "--force", "-1", "0", "0"], "force"),
        (["carosac", "--tilt-max-deg", "200"], "--tilt-max-deg: got 200.0 deg"),
    ],
)
def test_wrong_input_is_one_message_and_nothing_is_written(tmp_path, capsys, words, message):
    status, out = run(tmp_path, *words)
    assert status == 2 and not out.exists() and not (tmp_path / "w.json").exists()
    error = capsys.readouterr().err
    assert message in error and len(error.strip().splitlines()) == 1


def two_cables(path):
    """Write the file of `carosac` with the chains of two opposite corners only."""
    lines = robot_text("carosac").splitlines(keepends=True)
    chains = [line for line in lines if line.startswith("  - {name:")]
    path.write_text("".join(line for line in lines if line not in chains[1::2]))
    return str(path)


def test_two_cables_are_judged_in_their_plane(tmp_path, capsys):
    file = two_cables(tmp_path / "two.yaml")
    words = ["workspace", file, "--points", "60", "--output", str(tmp_path / "out")]
    main([*words, "--json", str(tmp_path / "w.json")])
    said = capsys.readouterr().out
    assert said.startswith("two cables let the platform rest in one vertical plane only: along (")
    assert " of the plane; " in said or "in the plane" in said
    assert "m^2, box" in said and "m^3" not in said
    data = json.loads((tmp_path / "w.json").read_text())
    assert data["area_m2"] == pytest.approx(data["share"] * data["plane_m2"])
    assert data["share"] > 0.3
    assert "volume_m3" not in data and data["slices"] == {"sag": []}
    names = {path.stem for path in (tmp_path / "out").glob("*.png")}
    assert names == {"plane", "maps_plane"}
    assert main([*words, "--slice", "z=2"]) == 2
    assert "--slice: got 'z=2'; allowed: nothing: carosac rests in one" in capsys.readouterr().err
    assert main([*words, "--model", "both", "--no-pictures"]) in (0, 1)
    assert "m^2) away from the workspace" in capsys.readouterr().out
