from dataclasses import replace
from itertools import pairwise
from typing import get_args

import pytest

from carosac_toolkit.base.errors import InvalidField
from learned.environment import EnvironmentSettings
from learned.presets import PRESETS, PresetName, Stage, Td3Settings, find_preset
from learned.rewards import PAPER_NO_SAG, PAPER_SAG


def test_the_paper_is_that_of_the_paper():
    """DESIGN: 5000 episodes of 200 steps, then 1000 of 30; the first 100 at random."""
    paper = find_preset("paper")
    no_sag, sag = paper.stage("no_sag"), paper.stage("sag")
    assert no_sag.td3.steps == 5000 * no_sag.environment.path.steps == 1_000_000
    assert sag.td3.steps == 1000 * sag.environment.path.steps == 30_000
    for stage in (no_sag, sag):
        assert stage.td3.random_steps == 100 * stage.environment.path.steps
        assert (stage.td3.batch_size, stage.td3.actor_rate, stage.td3.critic_rate) == (
            256, 3e-4, 3e-3,
        )  # fmt: skip
        assert stage.environment.observation == ("length", "position", "target")
        assert stage.environment.action == "absolute"
    assert no_sag.environment.reward.terms == PAPER_NO_SAG
    assert sag.environment.reward.terms == PAPER_SAG
    assert sag.environment.world == "settle"


def test_our_absolute_lengths_are_learned_without_inverse_kinematics():
    for stage in find_preset("carosac").stages.values():
        assert stage.environment.action == "absolute"
        assert set(stage.environment.observation) <= {"length", "position", "target"}


def test_our_policies_are_rewarded_for_taut_cables_and_smooth_pushes():
    ours = find_preset("carosac")
    sag = ours.stage("sag").environment
    assert sag.reward.slack > 0.0 and sag.reward.reserve > 0.0
    assert {stage.environment.path.kind for stage in ours.stages.values()} == {"scatter"}
    assert "jerk" in find_preset("residual").stage("realtime").environment.reward.terms


@pytest.mark.parametrize("name", list(PRESETS))
def test_stages_of_a_preset_hand_their_networks_on(name):
    """The next stage starts from the networks before it, so these must fit."""
    stages = list(PRESETS[name].stages.values())
    for first, second in pairwise(stages):
        for field in ("observation", "preview", "action"):
            assert getattr(first.environment, field) == getattr(second.environment, field)
        for field in ("hidden", "activation", "critics", "critic"):
            assert getattr(first.td3, field) == getattr(second.td3, field)


def test_unknown_names_are_refused_with_those_that_are_known():
    with pytest.raises(InvalidField, match=r"preset: got 'papre'; allowed: one of .*'paper'"):
        find_preset("papre")
    with pytest.raises(InvalidField, match=r"stage: got 'snow'; allowed: one of \['no_sag', 'sag'"):
        find_preset("paper").stage("snow")


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"steps": 0}, "steps: got 0"),
        ({"batch_size": 0}, "batch_size: got 0"),
        ({"random_steps": 1_000_000}, "random_steps: got 1000000"),
        ({"actor_rate": 0.0}, "actor_rate: got 0.0"),
        ({"discount": 1.5}, "discount: got 1.5; allowed: 0 to 1"),
        ({"rate_end": -0.1}, "rate_end: got -0.1"),
        ({"target_rate": 0.0}, "target_rate: got 0.0; allowed: 0 < target_rate <= 1"),
        ({"activation": "tanh"}, "activation: got 'tanh'"),
        ({"critic": "none"}, "critic: got 'none'"),
        ({"critic": "metric"}, "discount: got 0.99; allowed: 0 with a metric critic"),
        ({"relabelled": 0.5}, "discount: got 0.99; allowed: 0 with a metric critic or relabelled"),
    ],
)
def test_numbers_without_sense_are_refused(changes, message):
    with pytest.raises(InvalidField, match=message):
        Td3Settings(**changes)


def test_hindsight_that_does_not_know_the_reward_is_refused():
    td3 = replace(Td3Settings(), discount=0.0, relabelled=0.8)
    with pytest.raises(InvalidField, match=r"reward.terms: got .* allowed: \('fit',\)"):
        Stage(environment=EnvironmentSettings(), td3=td3)


def test_the_command_line_allows_every_preset():
    assert get_args(PresetName) == tuple(PRESETS)
