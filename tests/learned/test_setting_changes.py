import json

import pytest

from carosac_toolkit.base.errors import InvalidField
from learned.presets import find_preset
from learned.setting_changes import changed, concerned, label_of, read_changes, read_variations

STAGES = ("no_sag", "sag")


def stage(name="no_sag"):
    return find_preset("carosac").stages[name]


def test_a_change_is_for_all_stages_or_for_one():
    changes = read_changes(["td3.target_rate=0.02", "no-sag.environment.path.steps=7"], STAGES)
    first, second = (changed(name, stage(name), changes) for name in STAGES)
    assert (first.td3.target_rate, second.td3.target_rate) == (0.02, 0.02)
    assert first.environment.path.steps == 7
    assert second.environment == stage("sag").environment


def test_what_is_not_changed_stays():
    assert changed("sag", stage("sag"), {}) == stage("sag")
    found = changed("sag", stage("sag"), {"td3.exploration.end": 0.001}).td3
    assert found.exploration.start == stage("sag").td3.exploration.start


def test_lists_become_what_the_settings_have():
    changes = read_changes(["td3.hidden=[32,16]", 'environment.observation=["target"]'], STAGES)
    found = changed("no_sag", stage(), changes)
    assert found.td3.hidden == (32, 16)
    assert found.environment.observation == ("target",)


def test_settings_inside_settings_are_a_value_too():
    changes = read_changes(['td3.exploration={"start": 0.3, "end": 0.1}'], STAGES)
    assert changed("no_sag", stage(), changes).td3.exploration.start == 0.3
    part = {"environment.path": {"speed": [1.0, 2.0]}, "environment.path.steps": 7}
    kept = json.loads(json.dumps(part))
    found = changed("no_sag", stage(), part).environment.path
    assert (found.speed, found.steps) == ((1.0, 2.0), 7)
    assert part == kept  # what was asked stays as it was


def test_a_stage_depends_on_its_own_changes_and_those_before():
    changes = {"td3.critics": 1, "no_sag.td3.steps": 7, "sag.td3.rate_end": 0.5}
    assert concerned("sag", STAGES, changes) == changes
    assert list(concerned("no_sag", STAGES, changes)) == ["td3.critics", "no_sag.td3.steps"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("td3.target_rate", "--set"),
        ("target_rate=1", r"\[STAGE\.\]td3\.FIELD=VALUE"),
        ("td3=1", "STAGE no-sag or sag"),
        ("sagg.td3.steps=1", "STAGE no-sag or sag"),
        ("sag=1", "STAGE"),
        ("td3..steps=1", "STAGE"),
        ("td3.target_rate=NaN", "finite numbers, not NaN"),
    ],
)
def test_other_texts_are_refused(text, message):
    with pytest.raises(InvalidField, match=message):
        read_changes([text], STAGES)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"td3.target_rat": 0.1}, "no_sag.td3.target_rat"),
        ({"td3.target_rate": "fast"}, "no_sag.td3.target_rate: got 'fast'; allowed: a number"),
        ({"td3.target_rate": 2.0}, "target_rate: got 2.0"),
        ({"td3.hidden": 64}, "hidden"),
        ({"td3.exploration": {"begin": 1.0}}, "exploration.begin"),
        ({"td3.exploration": {"start": 1.0}, "td3.exploration.end": 0.1, "td3.exploration.start":
          1.0}, "each field once"),
        ({"td3.target_rate": 0.1, "no_sag.td3.target_rate": 0.2}, "each field once"),
    ],
)  # fmt: skip
def test_changes_that_are_not_allowed_are_refused(changes, message):
    with pytest.raises(InvalidField, match=message):
        changed("no_sag", stage(), changes)


def test_a_field_is_changed_once():
    with pytest.raises(InvalidField, match="each field once"):
        read_changes(["td3.critics=1", "td3.critics=2"], STAGES)
    with pytest.raises(InvalidField, match="each field once"):
        read_variations(["td3.critics=[1,2]"], STAGES, {"td3.critics": 1})


def test_every_value_meets_every_other():
    found = read_variations(["td3.critics=[1,2]", "td3.target_rate=[0.1,0.2]"], STAGES, {})
    assert found == [
        {"td3.critics": critics, "td3.target_rate": rate}
        for critics in (1, 2)
        for rate in (0.1, 0.2)
    ]
    assert read_variations([], STAGES, {}) == [{}]


@pytest.mark.parametrize("values", ["1", "[]", "[1]", "[1,1]", '["a b","ab"]'])
def test_variations_are_two_or_more_that_can_be_told_apart(values):
    with pytest.raises(InvalidField, match="--vary"):
        read_variations([f"td3.critics={values}"], STAGES, {})


def test_labels_are_short_and_fit_for_folders():
    assert label_of({}) == ""
    assert label_of({"td3.hidden": [64, 64]}) == "hidden=64+64"
    changes = {"sag.td3.rate_end": 0.5, "environment.path.kind": "scatter"}
    assert label_of(changes) == "path.kind=scatter_sag.rate_end=0.5"
    assert label_of(dict(reversed(changes.items()))) == label_of(changes)
    assert label_of({"td3.exploration": {"start": 0.4}}) == "exploration=start0.4"
    nested = {"td3.exploration": {"start": 0.3, "end": 0.1}}
    turned = {"td3.exploration": {"end": 0.1, "start": 0.3}}
    assert label_of(nested) == label_of(turned) == "exploration=end0.1+start0.3"
    long = {"environment.observation": ["part"] * 40}
    longer = {"environment.observation": ["part"] * 41}
    assert len(label_of(long)) == 90
    assert label_of(long) != label_of(longer)
    assert "/" not in label_of({"environment.moving.condition": "../x/y"})
