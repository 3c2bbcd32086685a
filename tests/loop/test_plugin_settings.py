from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Literal

import numpy as np
import pytest

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.loop.plugin_settings import check_types, chosen_settings
from carosac_toolkit.studies.compare.study import Study

NAMES = {"controllers": ["mpc", "mpc@long", "my.module:Own"], "estimators": ["ekf"]}


@pytest.mark.parametrize("text", ["1" * 5000, "[" * 100_000], ids=["digits", "brackets"])
def test_what_json_cannot_hold_is_text(text):
    assert chosen_settings([f"driver.x={text}"], **NAMES)["driver_settings"] == {"x": text}


def test_settings_go_to_the_plug_in_that_is_named():
    texts = [
        "controller.mpc.period=0.04", "controller.mpc@long.horizon=1e0", "driver.real_time=true",
        "controller.my.module:Own.limits.speed=[1, 2]", "estimator.ekf.coupling=tight",
        'estimator.ekf.note="1"', "driver.sensors.encoder_bias=0", "driver.sensors.imu_rate=100",
        "estimator.ekf.delay=null", "estimator.ekf.text=a=b",
    ]  # fmt: skip
    assert chosen_settings(texts, **NAMES) == {
        "controller_settings": {
            "mpc": {"period": 0.04}, "mpc@long": {"horizon": 1.0},
            "my.module:Own": {"limits": {"speed": [1, 2]}},
        },
        "estimator_settings": {
            "ekf": {"coupling": "tight", "note": "1", "delay": None, "text": "a=b"}
        },
        "driver_settings": {"real_time": True, "sensors": {"encoder_bias": 0, "imu_rate": 100}},
    }  # fmt: skip


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (["mpc.period=1"], "allowed: controller.NAME.FIELD=VALUE, estimator"),
        (["controller.mpc.period"], "allowed: controller.NAME.FIELD=VALUE, estimator"),
        (["driver=1"], "allowed: controller.NAME.FIELD=VALUE, estimator"),
        (["driver.=1"], "allowed: controller.NAME.FIELD=VALUE, estimator"),
        (["driver.a..b=1"], "allowed: controller.NAME.FIELD=VALUE, estimator"),
        (["controller.mpq.period=1"], r"with a NAME of \['mpc', 'mpc@long', 'my.module:Own'\]"),
        (["controller.mpc=1"], "with a NAME of"),
        (["driver.a=1", "driver.a=2"], "'driver.a=2'; allowed: each field once"),
        (["driver.a=1", "driver.a.b=2"], "each field once"),
        (["driver.a.b=1", "driver.a=2"], "each field once"),
    ],
)
def test_what_means_nothing_is_refused(texts, message):
    with pytest.raises(InvalidField, match=f"--set: got .*{message}"):
        chosen_settings(texts, **NAMES)


@dataclass(frozen=True, kw_only=True)
class Inner:
    bias: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Settings:
    gain: float = 1.0
    count: int = 3
    fast: bool = False
    label: str = "a"
    mode: Literal["one", "two"] = "one"
    delay: float | None = None
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    names: tuple[str, ...] = ()
    start: tuple[float, float] | tuple[tuple[float, float], ...] | None = None
    turn: Array = field(default_factory=lambda: np.eye(2))
    inner: Inner = Inner()


GOOD = {
    "gain": [2, 0.5, np.float32(1.0)], "count": [2, np.int64(3)], "fast": [True], "label": ["b"],
    "mode": ["two"], "delay": [None, 0, 0.1], "mount": [[1, 2, 3.0], (0, 0, 0), np.ones(3)],
    "names": [[], ["a", "b"]], "start": [None, [1, 2], [[1, 2], [3, 4], [5, 6]]],
    "turn": [[[1, 0], [0, 1]], np.eye(2)], "inner": [{"bias": 1}, Inner(bias=2.0)],
    "not_there": ["is for others to refuse"],
}  # fmt: skip


@pytest.mark.parametrize(("name", "value"), [(k, v) for k, some in GOOD.items() for v in some])
def test_values_of_the_right_kind_pass(name, value):
    check_types("driver_settings of x", Settings(), {name: value})


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [
        ("gain", "abc", "a number"),
        ("gain", True, "a number"),
        ("gain", None, "a number"),
        ("gain", [1.0], "a number"),
        ("count", 2.5, "a whole number"),
        ("count", False, "a whole number"),
        ("fast", 1, "true or false"),
        ("label", 3, "text"),
        ("mode", "three", "one of ['one', 'two']"),
        ("mode", 1, "one of ['one', 'two']"),
        ("delay", "soon", "a number or null"),
        ("mount", 3, "a list: [a number, a number, a number]"),
        ("mount", [1.0, 2.0], "a list: [a number, a number, a number]"),
        ("mount", [1.0, 2.0, "x"], "a list: [a number, a number, a number]"),
        ("mount", "abc", "a list: [a number, a number, a number]"),
        ("names", ["a", 1], "a list, each of it text"),
        ("turn", [1.0, 2.0], "2 x 2 numbers, as [...]"),
        ("turn", [[1.0, 2.0], [3.0]], "2 x 2 numbers, as [...]"),
        ("turn", [["a", "b"], ["c", "d"]], "2 x 2 numbers, as [...]"),
        ("inner", 5, "fields of it, each by its own name"),
    ],
)
def test_values_of_another_kind_are_refused(name, value, allowed):
    with pytest.raises(InvalidField) as caught:
        check_types("driver_settings of x", Settings(), {name: value})
    assert str(caught.value) == (f"driver_settings of x.{name}: got {value!r}; allowed: {allowed}")


def test_a_field_inside_is_named_in_full():
    with pytest.raises(InvalidField, match=r"x\.inner\.bias: got 'abc'; allowed: a number"):
        check_types("x", Settings(), {"inner": {"bias": "abc"}})


def test_defaults_pass_as_they_are_written_to_files():
    check_types("x", Settings(), asdict(Settings()) | {"turn": np.eye(2).tolist()})


def study(*texts, **changes):
    names = {"controllers": ["kinematic_solver"], "estimators": ["dynamic_estimator", "ks_ekf"]}
    names |= changes
    return Study(
        robots=["carosac"], trajectories=["line"], sensors=["lengths"],
        driver="simulator", **names, **chosen_settings(texts, **names),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("estimator.dynamic_estimator.mass=abc", "dynamic_estimator.mass: got 'abc'; allowed: a n"),
        ("estimator.dynamic_estimator.imu_position=3", "imu_position: got 3; allowed: a list"),
        ("estimator.ks_ekf.imu_position=[1, 2]", r"got \[1, 2\]; allowed: 3 numbers"),
        ("estimator.ks_ekf.misfit_time=abc", "ks_ekf.misfit_time: got 'abc'; allowed: a number"),
        ("driver.sensors.encoder_bias=abc", "sensors.encoder_bias: got 'abc'; allowed: a number"),
        ("driver.sensors=5", "simulator.sensors: got 5; allowed: fields of it"),
        ("driver.cables=rope", "simulator.cables: got 'rope'; allowed: one of"),
    ],
)
def test_a_study_refuses_values_of_another_kind(text, message):
    with pytest.raises(InvalidField, match=message):
        study(text).check()


@pytest.mark.parametrize(
    "text",
    [
        "estimator.dynamic_estimator.imu_position=[0, 0, 0.1]", "estimator.ks_ekf.gate=0.01",
        "estimator.dynamic_estimator.delay=null", "driver.sensors.encoder_bias=0",
        "estimator.ks_ekf.imu_position=[0, 0, 0.1]", "driver.winch.integral_time=null",
    ],
)  # fmt: skip
def test_a_study_takes_values_of_the_right_kind(text):
    study(text).check()


@pytest.mark.parametrize(
    ("kind", "name"), [("controllers", "kinematic_solver@"), ("estimators", "ks_ekf@")]
)
def test_an_empty_label_is_refused(kind, name):
    with pytest.raises(InvalidField, match=f"{kind[:-1]}: got '{name}'; allowed: NAME, or NAME@L"):
        study(**{kind: [name]}).check()
