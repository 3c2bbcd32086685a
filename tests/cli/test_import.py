"""``carosac import robot`` and ``carosac import recording``."""

from __future__ import annotations

import json

import pytest

from carosac_toolkit.cli.main import main
from carosac_toolkit.recordings.files import load_recording
from carosac_toolkit.robot.file import load_robot
from tests.interchange.bags import START, Bags
from tests.interchange.models import (
    IPANEMA_LENGTH,
    REST,
    caspr_body,
    caspr_cables,
    geometry,
    straight_cables,
    write_caspr,
)


@pytest.fixture
def bodies(tmp_path):
    cables = caspr_cables({"original": straight_cables(*geometry("ipanema1"))})
    return str(write_caspr(tmp_path, caspr_body(joint='q_initial="0 0 1 0 0 0"'), cables)[0])


def test_a_robot_comes_with_form_and_completion(bodies, tmp_path, capsys):
    form, rest, output = (tmp_path / name for name in ("form.yaml", "rest.yaml", "robot.yaml"))
    data = tmp_path / "numbers.json"
    assert main(["import", "robot", bodies, "--form", str(form)]) == 1
    said = capsys.readouterr().out
    assert "axial_stiffness: EA, a force in N" in said and "dropped:" in said
    assert "winches:\n  winch:\n    speed_max:  # a speed in m/s" in form.read_text()
    rest.write_text(REST)
    asked = ["import", "robot", bodies, "--complete", str(rest), "--output", str(output)]
    assert main([*asked, "--json", str(data)]) == 0
    assert "8 cables" in capsys.readouterr().out
    numbers = json.loads(data.read_text())
    assert numbers["straight_lengths_m"] == pytest.approx([IPANEMA_LENGTH] * 8, abs=1e-15)
    assert load_robot(output).mass == 25.0


def test_no_robot_file_without_all_fields(bodies, tmp_path, capsys):
    output = tmp_path / "robot.yaml"
    assert main(["import", "robot", bodies, "--set", "gravity=9.81", "--output", str(output)]) == 2
    said = capsys.readouterr().err
    assert "is not written" in said and "licence: a text" in said and "gravity" not in said
    assert not output.exists()


@pytest.mark.parametrize(
    "words", [["robot"], ["recording"], ["robot", "x.xml"], ["robot", "x.txt"]]
)
def test_bad_files_are_one_message(words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["import", *words]) == 2
    assert capsys.readouterr().err.count("carosac: ") == 1


def test_a_recording_comes_from_a_bag(tmp_path, capsys):
    bags = Bags("ros1")
    messages = [
        ("/array", "std_msgs/msg/Float64MultiArray", START + k * 10**7, bags.array([1.5 + k, 2.5]))
        for k in range(5)
    ]
    bag, output = str(bags.write(tmp_path, messages)), tmp_path / "run.csv"
    assert main(["import", "recording", bag]) == 0
    assert "--lengths, --tension, --swivel" in capsys.readouterr().out
    assert main(["import", "recording", bag, "--lengths", "/array", "--output", str(output)]) == 0
    assert "receive" in capsys.readouterr().out
    assert load_recording(output).unstrained_length[:, 0].tolist() == [1.5, 2.5, 3.5, 4.5, 5.5]
    assert main(["import", "recording", bag, "--pose", "/array"]) == 2
    assert "a recording needs them" in capsys.readouterr().err
