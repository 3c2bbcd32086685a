import json
import math

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
    assert "cannot be at its home position:\n  no tensions within the limits" in captured.err
    assert "cable front_left would need 84.5 N at home, its maximum is 30 N" in captured.err
    assert json.loads((tmp_path / "x.json").read_text())["cables"][0]["home_tension_N"] is None
    assert (tmp_path / "x.png").exists()


def with_pulleys(radius):
    """The bundled robot with pulleys fed from below, and a payload."""
    pulley = f"], pulley: {{radius: {radius}, swivel_axis: [0, 0, 1]}}}}\n"
    text = robot_text("carosac").replace("]}\n", pulley, 4)
    payload = "{name: camera, mass: 2 kg, center_of_mass: [0, 0.1, 0], inertia: [1, 2, 3]}"
    text = text.replace("  air_drag:", f"  payloads:\n    - {payload}\n  air_drag:")
    return text.replace("  home: assumed", "  home: assumed\n  platform.payloads: weighed")


def test_points_pulleys_and_payloads_are_shown(tmp_path, capsys):
    path = tmp_path / "pulleys.yaml"
    path.write_text(with_pulleys("30 cm"))
    words = ["check", str(path), "--json", str(tmp_path / "x.json")]
    assert main([*words, "--picture", str(tmp_path / "x.png")]) == 0
    out = capsys.readouterr().out
    data = json.loads((tmp_path / "x.json").read_text())
    assert "(2.519, -8.388, 8.469)  (0.21, -0.21, -0.011)" in out
    assert "camera                 2  (0, 0.1, 0)" in out
    assert "300  (0, 0, 1)         below" in out
    assert data["payloads"][0]["name"] == "camera" and data["payloads"][0]["mass_kg"] == 2.0
    for cable in data["cables"]:
        assert cable["pulley_radius_m"] == 0.3 and cable["swivel_axis"] == [0.0, 0.0, 1.0]
        assert f"{cable['home_wrap_rad'] * 180.0 / math.pi:.1f}\n" in out
    assert data["problems"] == [] and data["warnings"] == []


def test_a_home_out_of_reach_of_the_winches_is_a_negative_answer(tmp_path, capsys):
    path = tmp_path / "short.yaml"
    path.write_text(with_pulleys("30 cm").replace("length_max: 20 m", "length_max: 9.5 m"))
    words = ["check", str(path), "--json", str(tmp_path / "x.json")]
    assert main(words) == 1
    error = capsys.readouterr().err
    assert "cable front_left needs 9.6" in error
    assert "length_min to length_max = 1 to 9.5 m" in error
    data = json.loads((tmp_path / "x.json").read_text())
    assert not data["home"]["feasible"] and len(data["problems"]) == 4


def test_warnings_are_shown_and_leave_the_answer_as_it_is(tmp_path, capsys):
    path = tmp_path / "spare.yaml"
    spare = "    spare: {position: [0, 0, 8]}\nplatform:\n"
    path.write_text(robot_text("carosac").replace("platform:\n", spare, 1))
    assert main(["check", str(path)]) == 0
    assert capsys.readouterr().err.endswith(
        "carosac: warning: frame.exit_points.spare is used by no chain\n"
    )
