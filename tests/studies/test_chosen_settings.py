from __future__ import annotations

import pytest

from carosac_toolkit.errors import InvalidField
from carosac_toolkit.studies.chosen_settings import chosen_settings

NAMES = {"controllers": ["mpc", "mpc@long", "my.module:Own"], "estimators": ["ekf"]}


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
