from __future__ import annotations

import pickle
from dataclasses import FrozenInstanceError, replace

import pytest

import carosac_toolkit
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.version import __version__
from carosac_toolkit.studies import Case, product
from carosac_toolkit.studies.run import case as case_module
from tests.studies.functions import NAMES, one_case, some_cases

ALL_NAMES = ("robot", "controller", "estimator", "sensors", "trajectory", "perturbation")


def changed(case: Case, name: str) -> Case:
    return replace(case, **{name: 7 if name == "seed" else "another"})


@pytest.mark.parametrize("name", [*ALL_NAMES, "seed"])
def test_identity_changes_with_every_field(name):
    case = one_case("mpc")
    assert changed(case, name).identity != case.identity


def test_identity_changes_with_settings_and_version(monkeypatch):
    case = one_case("mpc", speed_max=1.0)
    assert one_case("mpc", speed_max=2.0).identity != case.identity
    assert carosac_toolkit.__version__ == case_module.__version__
    monkeypatch.setattr(case_module, "__version__", "99.0")
    assert one_case("mpc", speed_max=1.0).identity != case.identity


def test_identity_and_seeds_are_the_same_everywhere():
    case = one_case("mpc", 3)
    assert (case.plant_seed, case.sensor_seed, case.path_seed, case.rng_seed) == (
        763508348114864695,
        5307601706005652439,
        2096325253211715654,
        274152644371951678,
    )
    assert len(case.identity) == 16
    assert pickle.loads(pickle.dumps(case)).identity == case.identity
    assert Case.from_dict(case.to_dict()) == case


@pytest.mark.parametrize(
    ("seed", "depends_on"),
    [
        ("plant_seed", {"robot", "perturbation", "seed"}),
        ("sensor_seed", {"robot", "seed"}),
        ("path_seed", {"robot", "seed"}),
        ("rng_seed", {*ALL_NAMES, "seed"}),
    ],
)
def test_each_seed_depends_on_no_more_than_it_needs(seed, depends_on, monkeypatch):
    case = one_case("mpc", timeout=1.0)
    differs = {x for x in (*ALL_NAMES, "seed")
               if getattr(changed(case, x), seed) != getattr(case, seed)}  # fmt: skip
    assert differs == depends_on
    monkeypatch.setattr(case_module, "__version__", "99.0")
    assert getattr(one_case("mpc", timeout=2.0), seed) == getattr(case, seed)


def test_order_of_settings_does_not_matter():
    first = one_case("mpc", horizon=3, weights={"a": 1, "b": [1, 2.5, None, "x"]})
    second = one_case("mpc", weights={"b": [1, 2.5, None, "x"], "a": 1}, horizon=3)
    assert first.identity == second.identity
    assert len({first, second}) == 1


def test_a_case_cannot_be_changed():
    weights = {"a": 1}
    case = one_case("mpc", weights=weights)
    weights["a"] = 2
    assert case.settings["weights"] == {"a": 1}
    with pytest.raises(TypeError):
        case.settings["weights"] = 3  # type: ignore[index]
    with pytest.raises(FrozenInstanceError):
        case.seed = 3  # type: ignore[misc]


@pytest.mark.parametrize(
    "settings", [{"x": float("nan")}, {"x": object()}, {1: "x"}, {"x": (1, 2)}, {"x": {2: 1}}]
)
def test_settings_that_json_would_change_are_refused(settings):
    with pytest.raises(InvalidField, match=r"settings: got .* allowed: JSON values"):
        replace(one_case("mpc"), settings=settings)


@pytest.mark.parametrize(
    ("field", "value"), [("robot", ""), ("sensors", None), ("seed", -1), ("seed", 1.0)]
)
def test_fields_are_checked(field, value):
    with pytest.raises(InvalidField, match=field):
        replace(one_case("mpc"), **{field: value})


def test_product_holds_every_combination_once():
    cases = product(**NAMES | {"sensors": ["a", "b"]}, controllers=["x", "y"], seeds=[0, 1, 2])
    assert len({case.identity for case in cases}) == len(cases) == 12
    assert [case.seed for case in cases[:3]] == [0, 1, 2]
    assert some_cases(2) == some_cases(2)


@pytest.mark.parametrize(
    ("axis", "values"), [("seeds", []), ("seeds", [1, 1]), ("controllers", "mpc")]
)
def test_product_refuses_axes_that_hide_a_mistake(axis, values):
    with pytest.raises(InvalidField, match=axis):
        product(**NAMES | {"controllers": ["x"], "seeds": [0]} | {axis: values})


def test_a_case_keeps_identity_and_seeds_of_when_its_sensors_were_called_suite():
    """Else the draws of published results would change, and earlier studies could not go on."""
    case = Case(
        robot="carosac", controller="mpc", estimator="ks_ekf", sensors="lengths+imu",
        trajectory="line", perturbation="nominal-1", seed=3,
    )  # fmt: skip
    assert case.rng_seed == 4324701224892008619
    assert case.plant_seed == 763508348114864695
    if __version__ == "0.1.0":  # which is in the identity
        assert case.identity == "2988a328fd739e59"
