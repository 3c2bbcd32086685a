import json
from dataclasses import asdict

import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField
from learned.observation import ObservationUnits
from learned.rewards import RewardSettings
from learned.training_record import (
    SETTINGS_FILE,
    TrainingRecord,
    check_settings,
    digest,
    read_record,
)

ASKED = {
    "preset": "tiny", "changes": "", "device": "cpu", "seed": 0,
    "td3": {"steps": 100, "hidden": [8, 8], "target_rate": 0.005},
}  # fmt: skip


def test_a_record_is_read_as_it_was_written(tmp_path):
    assert read_record(tmp_path) is None
    record = TrainingRecord(
        settings=ASKED, commits=("aaa", "bbb with changes"), started_from={"steps": 3}
    )
    record.write(tmp_path)
    assert read_record(tmp_path) == record
    assert record.commit == "aaa, bbb with changes"


@pytest.mark.parametrize(("kept", "read"), [("17f0196", "17f0196"), (None, "unknown")])
def test_an_older_record_has_one_commit(tmp_path, kept, read):
    (tmp_path / SETTINGS_FILE).write_text(json.dumps(ASKED | {"commit": kept}))
    assert read_record(tmp_path) == TrainingRecord(settings=ASKED, commits=(read,))


def test_commits_are_those_of_each_time_that_the_code_was_another(tmp_path):
    record = TrainingRecord(settings=ASKED, commits=("aaa",))
    for commit in ("aaa", "bbb", "bbb", "aaa"):
        record = record.resumed(commit)
    assert record.commits == ("aaa", "bbb", "aaa")


def test_the_history_of_a_training_is_none_of_its_settings(tmp_path):
    assert check_settings(ASKED, tmp_path) is None
    record = TrainingRecord(settings=ASKED, commits=("aaa",), started_from={"steps": 3})
    record.write(tmp_path)
    assert check_settings(ASKED, tmp_path) == record
    with pytest.raises(InvalidField, match=r"output: .*; there seed is 0, not 1$"):
        check_settings(ASKED | {"seed": 1}, tmp_path)
    less = {name: value for name, value in ASKED.items() if name != "td3"}
    with pytest.raises(InvalidField, match=r"output: .*; there td3\.\w+ is .*, not None"):
        check_settings(less, tmp_path)


def test_fields_that_came_later_make_no_other_training(tmp_path):
    reward, units = asdict(RewardSettings()), asdict(ObservationUnits())
    environment = {"world": "no_sag", "reward": reward, "units": units, "memory": 1.0}
    environment |= {"correction": 0.0, "correction_memory": 4.0, "truth": False}
    asked = ASKED | {"environment": environment}
    asked = json.loads(json.dumps(asked))
    older = json.loads(json.dumps(asked))
    for name in ("tracking_scale", "slack", "reserve", "jerk"):
        del older["environment"]["reward"][name]
    del older["environment"]["units"]["acceleration"]
    for name in ("memory", "correction", "correction_memory", "truth"):
        del older["environment"][name]
    del older["td3"]["target_rate"], older["changes"]
    TrainingRecord(settings=older, commits=("aaa",)).write(tmp_path)
    assert check_settings(asked, tmp_path) is not None
    asked["environment"]["reward"]["slack"] = 1.0
    with pytest.raises(InvalidField, match=r"there environment\.reward\.slack is 0\.0, not 1\.0"):
        check_settings(asked, tmp_path)


def test_a_digest_changes_with_every_number():
    values = np.arange(6.0)
    changed = values.copy()
    changed[4] = np.nextafter(4.0, 5.0)
    assert digest(["a", values]) == digest(["a", values.copy()])
    assert len({digest(one) for one in (["a", values], ["b", values], ["a", changed])}) == 3
