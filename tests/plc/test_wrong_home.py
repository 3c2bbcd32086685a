"""A home that is wrong, with encoders that cannot know it, on a PLC in a process of its own."""

import json
import time

import numpy as np
import pytest

from carosac_toolkit.cli.main import main
from carosac_toolkit.loop.drive_state import DriveState
from carosac_toolkit.physics.cable import straight_line
from carosac_toolkit.plc.guarded import GuardedAds, GuardedAdsSettings
from carosac_toolkit.safety.guard import NotReady
from tests.plc_process import plc_process


def guard_at(plc, home, **changes):
    inner = {"lost_after": 0.5}
    settings = GuardedAdsSettings(motion=True, stale_time=0.5, inner=inner, home_anew=True,
                                  start_position=tuple(home), **changes)  # fmt: skip
    return GuardedAds.build(plc.robot, settings)


def state_of(plc):
    """Where the robot truly is, and how many commands the PLC has got."""
    with plc.client() as client:
        return client.truth()["position"], client.diagnosis()["commands"]


def refused(plc, home, match, **changes):
    """Refuse a home; nothing is enabled, commanded or moved."""
    before = state_of(plc)
    guard = guard_at(plc, home, **changes)
    with pytest.raises(NotReady, match=match):
        guard.connect()
    assert guard.state is DriveState.DISCONNECTED
    after = state_of(plc)
    assert after[0] == pytest.approx(before[0], abs=1e-4)
    assert after[1] == before[1]


def test_load_cells_refuse_a_home_that_they_contradict_whoever_confirms_it():
    with plc_process("--watchdog", "0.6") as plc:
        home = np.array(plc.robot.home_position)
        for place in ([1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0], [0.3, 0, 0], [-0.3, 0, 0]):
            assert plc.say("place {:g} {:g} {:g}".format(*(home + place))) == "ok"
            time.sleep(0.1)
            refused(plc, home, "load cells contradict a platform at rest at", home_confirmed=True)
        for place in ([0, 0.3, 0], [0, 0, -0.3]):  # 1 N of the cells hides these
            assert plc.say("place {:g} {:g} {:g}".format(*(home + place))) == "ok"
            time.sleep(0.1)
            refused(plc, home, "home: .* or a person's word")


@pytest.mark.parametrize("times", [4, pytest.param(20, marks=pytest.mark.slow)])
def test_load_cells_do_not_contradict_the_right_home(times):
    with plc_process("--watchdog", "0.6") as plc:
        home = np.array(plc.robot.home_position)
        assert plc.say("place {:g} {:g} {:g}".format(*home)) == "ok"
        time.sleep(0.1)
        for _ in range(times):
            guard = guard_at(plc, home)
            guard.connect()
            assert guard.state is DriveState.ENABLED
            assert not guard.homing.evidence.contradicts
            guard.close()


def test_encoders_alone_need_the_word_of_a_person(tmp_path, capsys):
    with plc_process("--watchdog", "0.6", "--no-load-cells") as plc:
        home = np.array(plc.robot.home_position)
        assert plc.say("place {:g} {:g} {:g}".format(*(home + np.array([0.0, 1.0, 0.0])))) == "ok"
        time.sleep(0.1)
        refused(plc, home, "encoders alone do not show a wrong home; .* --home-confirmed")
        before = state_of(plc)
        where = [f"{x:g}" for x in home]
        words = ["run", "--driver", "ads", "--robot", str(plc.file), "--home", *where, "--enable"]
        words += ["--home-anew", "--recording", str(tmp_path / "run.jsonl"), "--duration", "0.2"]
        words += ["--set", "driver.inner.lost_after=0.5", "--set", "driver.stale_time=0.5"]
        assert main(words) == 2
        said = capsys.readouterr().err
        assert said.count("--home-confirmed") == 1 and said.count("\n") == 1
        assert state_of(plc)[1] == before[1]
        guard = guard_at(plc, home, home_confirmed=True)
        guard.connect()
        assert guard.state is DriveState.ENABLED
        guard.close()


def winch_rates(recording, robot, column):
    """Distances of lengths' positions from the first [m], and the winches' rates [m/s]."""
    rows = [json.loads(line) for line in recording.read_text().splitlines()]
    sent = [row for row in rows if row.get("row") == "sent" and column in row]
    lengths = np.array(list({row["time"]: row[column] for row in sent}.values()))
    position = straight_line.forward_kinematics(robot, lengths).position
    rates = np.abs(np.diff(lengths, axis=0)).max(axis=1) / 0.02
    return np.linalg.norm(position[1:] - position[0], axis=1), rates


@pytest.mark.parametrize("wiring", [(), ("--fault", "wrong_sign=2")], ids=["right", "wrong"])
def test_a_fast_run_from_a_new_home_starts_slowly_and_sees_a_wrong_sign(tmp_path, wiring):
    """Tensions shift on the first centimetres, at 5 cm/s, whatever speed was asked for."""
    with plc_process("--watchdog", "0.6", "--shift", "0.5", *wiring) as plc:
        home = np.array(plc.robot.home_position)
        goal = home + np.array([0.0, 0.4, 0.0])
        words = ["run", "--driver", "ads", "--robot", str(plc.file), "--enable", "--rate", "50"]
        words += ["--home", *(f"{x:g}" for x in home), "--to", *(f"{x:g}" for x in goal)]
        words += ["--home-anew", "--home-confirmed", "--speed", "0.4"]
        words += ["--recording", str(tmp_path / "run.jsonl"), "--json", str(tmp_path / "run.json")]
        for setting in ("inner.lost_after=0.5", "stale_time=0.5", "overrun_share=1.0"):
            words += ["--set", f"driver.{setting}"]
        status = main([*words, "--set", "driver.hang_time=1.5"])
        found = json.loads((tmp_path / "run.json").read_text())
        moved = state_of(plc)[0] - home
        if wiring:
            assert status == 1 and found["fault"] == "closure"
            assert "turn the other way" in found["reason"]
            assert np.linalg.norm(moved) < 0.1
        else:
            assert status == 0, found["reason"]
            assert found["reason"] == "end of the trajectory"
            way, rates = winch_rates(tmp_path / "run.jsonl", plc.robot, "asked")
            assert rates[way < 0.08].max() < 0.06  # the reference itself is slow
            assert "first_way" not in found["limited_cycles"]
            way, rates = winch_rates(tmp_path / "run.jsonl", plc.robot, "unstrained_length")
            assert rates[way < 0.08].max() < 0.0751  # the setting `first_speed`
            assert rates.max() > 0.12
            assert moved == pytest.approx(goal - home, abs=0.1)  # it sways, more on a busy machine
