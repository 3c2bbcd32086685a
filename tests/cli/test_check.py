import json

import pytest

from carosac_toolkit.cli.main import main
from carosac_toolkit.robot_file import list_robots, robot_text


@pytest.mark.parametrize("name", list_robots())
def test_check_describes_every_bundled_robot(name, tmp_path, capsys):
    assert main(["check", name, "--json", str(tmp_path / "x.json")]) == 0
    data = json.loads((tmp_path / "x.json").read_text())
    out = capsys.readouterr().out
    assert data["n"] == len(data["cables"])
    assert data["home"]["feasible"] and data["home"]["stable"]
    assert f"{data['n']}, {data['constraint']}" in out
    for cable in data["cables"]:
        assert cable["tension_min_N"] - 1e-6 <= cable["home_tension_N"] <= cable["tension_max_N"]
        assert f"{cable['home_tension_N']:.2f}" in out
    assert "natural frequencies at home [Hz]" in out
    assert all(field in out for field in data["provenance"])


def test_check_draws_a_picture(tmp_path, capsys):
    picture = tmp_path / "robot.png"
    assert main(["check", "carosac", "--picture", str(picture)]) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert [path.name for path in tmp_path.iterdir()] == ["robot.png"]
    assert f"picture: {picture}" in capsys.readouterr().out


def test_a_robot_that_cannot_hang_at_home_is_a_negative_answer(tmp_path, capsys):
    path = tmp_path / "weak.yaml"
    path.write_text(robot_text("carosac").replace("max: 500 N", "max: 30 N"))
    words = ["check", str(path), "--json", str(tmp_path / "x.json")]
    assert main([*words, "--picture", str(tmp_path / "x.png")]) == 1
    captured = capsys.readouterr()
    assert "cannot be at its home position: no tensions within the limits" in captured.err
    assert json.loads((tmp_path / "x.json").read_text())["cables"][0]["home_tension_N"] is None
    assert (tmp_path / "x.png").exists()
