"""`carosac view` serves this machine alone, says what it refuses, and writes whole files."""

from __future__ import annotations

import json
import re
import socket
import threading

import pytest

from carosac_toolkit.cli.main import main
from carosac_toolkit.recordings.bundled import find_recording
from carosac_toolkit.recordings.files import load_recording, save_recording
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.viewer.page import Page


def refused(capsys, *words):
    assert main(["view", *words]) == 2
    return capsys.readouterr().err


def test_the_page_is_served_on_loopback_alone():
    page = Page(load_robot("carosac"), "carosac", port=8640)
    try:
        port = page.server.get_port()
        assert re.fullmatch(rf"http://127.0.0.1:{port}/[\w-]{{22}}/", page.url)
        socket.create_connection(("127.0.0.1", port), timeout=5.0).close()
        with pytest.raises(OSError):  # another address of this machine
            socket.create_connection(("127.0.0.2", port), timeout=5.0)
    finally:
        page.close()


def test_a_robot_at_rest_becomes_one_file_that_needs_nobody(tmp_path, capsys):
    file, numbers = tmp_path / "robot.html", tmp_path / "numbers.json"
    words = ["view", "scampi", "--html", str(file), "--sag", "10", "--json", str(numbers)]
    assert main(words) == 0
    text = file.read_text(encoding="utf-8")
    assert "__VISER_EMBED_DATA__" in text and "drawn 10 times larger" in text
    assert not re.findall(r"""<(?:script|link|img)[^>]*(?:src|href)=["']https?:""", text)
    assert json.loads(numbers.read_text(encoding="utf-8"))["pictures"] == 1
    assert str(file) in capsys.readouterr().out


def test_a_live_simulation_runs_its_time_and_draws(tmp_path):
    numbers = tmp_path / "numbers.json"
    words = ["view", "carosac", "--live", "--driver", "quasi_static", "--duration", "1.5",
             "--rate", "20", "--port", "8650", "--json", str(numbers)]  # fmt: skip
    assert main(words) == 0
    data = json.loads(numbers.read_text(encoding="utf-8"))
    assert data["cycles"] == 30 and data["error"] is None
    assert 3 <= data["pictures"] <= 30


def test_a_replay_plays_and_ends(tmp_path, capsys):
    file, numbers = tmp_path / "run.csv", tmp_path / "numbers.json"
    save_recording(load_recording(find_recording("synthetic")).slice(0, 400), file)
    words = ["view", str(file), str(file), "--duration", "1", "--port", "8660",
             "--json", str(numbers)]  # fmt: skip
    assert main(words) == 0
    data = json.loads(numbers.read_text(encoding="utf-8"))
    assert data["pictures"] >= 3 and data["duration_s"] == pytest.approx(19.95)
    assert "poses measured" in capsys.readouterr().out


def test_what_means_nothing_is_refused_in_one_message(tmp_path, capsys):
    before = set(threading.enumerate())
    assert "did you mean" in refused(capsys, "syntetic")
    assert "GHOST" in refused(capsys, "carosac", "scampi")
    assert "a robot, with --live" in refused(capsys, "synthetic", "--live")
    assert "--sag" in refused(capsys, "carosac", "--sag", "0.5")
    assert "--port" in refused(capsys, "carosac", "--port", "0")
    exposed = refused(capsys, "carosac", "--host", "0.0.0.0", "--duration", "1")
    assert "--host: got '0.0.0.0'" in exposed and "add --allow-others: whoever" in exposed
    elsewhere = ("--host", "203.0.113.7", "--allow-others")
    assert "address of this machine" in refused(capsys, "carosac", *elsewhere, "--duration", "1")
    assert "simulated driver" in refused(capsys, "carosac", "--live", "--driver", "ads")
    file = tmp_path / "live.html"
    assert "no --live" in refused(capsys, "carosac", "--live", "--html", str(file))
    assert "--plain or --html" in refused(capsys, "carosac", "--plain", "--html", str(file))
    assert "--live --priority" in refused(capsys, "carosac", "--priority")
    assert ".html" in refused(capsys, "carosac", "--html", str(tmp_path / "x.png"))
    assert "nothing: an option of the command sets it" in refused(
        capsys, "carosac", "--live", "--set", "driver.real_time=false"
    )
    assert list(tmp_path.iterdir()) == []
    assert "viewer" not in {thread.name for thread in set(threading.enumerate()) - before}
