"""One builder for all plug-ins: what was asked wins, what is offered fills in."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

import carosac_toolkit as ct
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.plugin_builder import build_controller, build_plugin


@dataclass(frozen=True)
class Settings:
    period: float = 0.01
    gain: float = 1.0


class Plain:
    """A plug-in without settings."""

    @classmethod
    def build(cls, robot, settings=None, *, seed=0):
        return ("plain", robot.name, settings, seed)


class Tuned:
    """A plug-in with settings, alone or in a batch."""

    Settings = Settings

    @classmethod
    def build(cls, robot, settings=None, *, seed=0):
        return settings

    @classmethod
    def build_batch(cls, robots, settings=None, *, seeds):
        return (len(robots), settings, tuple(seeds))


ROBOT = ct.load_robot("carosac")


def test_what_was_asked_wins_over_what_is_offered():
    built = build_plugin(
        Tuned, ROBOT, where="tuned", asked={"period": 0.02}, offered={"period": 0.05, "gain": 2.0}
    )
    assert built == Settings(period=0.02, gain=2.0)


def test_an_offer_that_the_plugin_has_no_setting_for_is_left_out():
    assert build_plugin(Tuned, ROBOT, where="tuned", offered={"suite": "lengths"}) == Settings()


def test_a_plugin_without_settings_gets_none_and_its_seed():
    assert build_plugin(Plain, ROBOT, where="plain", offered={"period": 0.05}, seed=7) == (
        "plain", "carosac", None, 7,
    )  # fmt: skip


def test_a_batch_gets_a_seed_for_each_robot():
    built = build_plugin(Tuned, [ROBOT, ROBOT], where="tuned", asked={"gain": 3.0}, seeds=[4, 5])
    assert built == (2, Settings(gain=3.0), (4, 5))


@pytest.mark.parametrize(
    ("plugin", "asked", "message"),
    [
        (Plain, {"gain": 2.0}, "where: got .*gain.*; allowed: nothing: Plain has no Settings"),
        (Tuned, {"gian": 2.0}, "where.gian: got 2.0; allowed: one of .*'gain', 'period'"),
        (Tuned, {"gain": "high"}, "where.gain: got 'high'; allowed: a number"),
    ],
)
def test_settings_that_cannot_count_are_refused(plugin, asked, message):
    with pytest.raises(InvalidField, match=message):
        build_plugin(plugin, ROBOT, where="where", asked=asked)


def test_a_live_controller_takes_the_period_of_the_run_unless_another_was_asked():
    chosen = {"controller_settings": {"mpc": {}}, "estimator_settings": {}}
    assert build_controller("mpc", ROBOT, chosen, 0.02, seed=0).period == 0.02


def test_settings_for_an_instance_without_any_are_refused():
    with pytest.raises(InvalidField, match=r"allowed: nothing: <.*Plain.* has no Settings"):
        build_plugin(Plain(), ROBOT, where="plain", asked={"gain": 1.0})
