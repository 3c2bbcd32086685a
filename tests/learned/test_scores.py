from dataclasses import replace

import numpy as np
import pytest

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.physics.cable import straight_line
from carosac_toolkit.physics.rest import statics
from learned.environment import CableEnvironment, EnvironmentSettings
from learned.scores import PolicyScores, score
from learned.target_paths import PathSettings, TargetPath
from tests.robots import simple_robot

SHORT = PathSettings(steps=5)
SEEN = ("target",)
ROWS = ("position", "velocity", "acceleration")


def made(world="no_sag", size=4):
    settings = EnvironmentSettings(world=world, observation=SEEN, path=SHORT)
    environment = CableEnvironment(simple_robot(), settings, size=size)
    environment.reset()
    return environment


def solver(environment, offset=0.0):
    """A policy that asks for the lengths of its target, and a constant more of the first."""
    scales = environment.scales

    def act(observation):
        target = scales.center + scales.half * observation
        if environment.settings.world == "no_sag":
            length = straight_line.inverse_kinematics(environment.robot, target)
        else:
            length = statics.inverse_kinematics(environment.robot, target).unstrained_length
        length[:, 0] += offset
        return scales.to_action(length)

    return act


def paths_of(environment, count=8):
    found = []
    while len(found) < count:
        environment.reset()
        found += environment.state()["paths"]
    return found


@pytest.mark.parametrize("world", ["no_sag", "settle"])
def test_inverse_kinematics_scores_no_error_at_any_step_of_any_path(world):
    environment = made(world)
    paths = paths_of(environment)
    found = score(environment, solver(environment), paths)
    np.testing.assert_array_equal(found.target, [path.position[1:] for path in paths])
    np.testing.assert_allclose(found.error, 0.0, atol=1e-5)
    np.testing.assert_allclose(found.length_error, 0.0, atol=1e-9)
    np.testing.assert_allclose(found.inconsistency, 0.0, atol=1e-5)
    np.testing.assert_allclose(found.tilt, 0.0, atol=1e-4)
    assert not found.failed.any()
    data = found.data(environment.robot)
    assert data["trajectories"] == 8
    assert data["failures"] == 0
    if world == "settle":
        assert data["slack_share"] == data["overload_share"] == 0.0
        low, high = data["tension_range_N"]
        assert 5.0 - 1e-6 < low < high < 500.0


def test_a_length_too_long_is_found_in_lengths_and_in_inconsistency():
    environment = made()
    found = score(environment, solver(environment, 0.1), paths_of(environment, 4))
    expected = np.broadcast_to([0.1, 0.0, 0.0, 0.0], found.length_error.shape)
    np.testing.assert_allclose(found.length_error, expected, atol=1e-9)  # the last steps too
    assert (found.inconsistency > 0.005).all() and (found.inconsistency < 0.1).all()
    assert found.data(environment.robot)["length_error_m"] == pytest.approx(0.0, abs=1e-9)


def made_up(**changes):
    """Two paths of four steps with known errors."""
    position = np.zeros((2, 4, 3))
    position[0, :, 0] = [0.01, 0.01, 0.01, 0.01]
    position[1, :, 2] = [-0.02, 0.04, -0.06, 0.08]
    still = PolicyScores(
        target=np.zeros((2, 4, 3)), position=position, length_error=np.zeros((2, 4, 4)),
        inconsistency=np.zeros((2, 4)), length=np.full((2, 4, 4), 7.0), tilt=np.zeros((2, 4)),
        tension=None, failed=np.zeros((2, 4), dtype=bool), counted=np.ones((2, 4), dtype=bool),
    )  # fmt: skip
    return replace(still, **changes)


def test_both_medians_are_what_their_names_say():
    data = made_up().data(simple_robot())
    norms = [0.01] * 4 + [0.02, 0.04, 0.06, 0.08]
    assert data["median_error_m"]["norm"] == pytest.approx(np.median(norms))
    assert data["median_error_m"]["x"] == pytest.approx(0.005)
    assert data["median_error_m"]["y"] == 0.0
    assert data["median_of_trajectory_means_m"] == pytest.approx((0.01 + 0.05) / 2)
    assert data["rmse_m"] == pytest.approx(np.sqrt(np.mean(np.square(norms))))
    assert data["p95_error_m"] == pytest.approx(np.percentile(norms, 95))
    assert "slack_share" not in data


def test_nothing_counts_from_a_failure_on():
    failed = np.zeros((2, 4), dtype=bool)
    failed[1, 2] = True
    data = made_up(failed=failed).data(simple_robot())
    assert data["failures"] == 1
    norms = [0.01] * 4 + [0.02, 0.04]
    assert data["median_error_m"]["norm"] == pytest.approx(np.median(norms))
    assert data["median_of_trajectory_means_m"] == pytest.approx((0.01 + 0.03) / 2)


def test_paths_that_fail_at_once_count_as_failures_alone():
    failed = np.zeros((2, 4), dtype=bool)
    failed[1, 0] = True
    data = made_up(failed=failed).data(simple_robot())
    assert data["median_of_trajectory_means_m"] == pytest.approx(0.01)
    assert data["failures"] == 1


def test_failing_after_the_end_of_a_path_is_no_failure():
    environment = made("settle", size=2)
    paths = paths_of(environment, 2)
    good = solver(environment)

    def act(observation):
        act.calls += 1
        return np.full((2, 4), -1.8) if act.calls > 3 else good(observation)

    for steps, failures in ((5, 2), (3, 0)):
        act.calls = 0
        mixed = [cut(paths[0], steps), paths[1]]
        failed = score(environment, act, mixed).failed
        assert failed.any(axis=1).tolist() == [failures == 2, True]


def test_scores_of_nothing_but_failures_are_no_numbers():
    tension = np.full((2, 4, 4), 50.0)
    data = made_up(failed=np.ones((2, 4), dtype=bool), tension=tension).data(simple_robot())
    assert data["failures"] == 2
    for name in ("median_of_trajectory_means_m", "p95_error_m", "slack_share"):
        assert np.isnan(data[name]), name


def cut(path, steps):
    """The start of a path."""
    return TargetPath(**{name: getattr(path, name)[: steps + 1] for name in ROWS})


def test_each_path_counts_to_its_own_end():
    environment = made(size=2)
    paths = paths_of(environment, 4)
    mixed = [paths[0], cut(paths[1], 2), cut(paths[2], 4), cut(paths[3], 1)]
    found = score(environment, solver(environment, 0.1), mixed)
    np.testing.assert_array_equal(found.counted.sum(axis=1), [5, 2, 4, 1])
    assert (np.diff(found.counted.astype(int), axis=1) <= 0).all()  # what counts comes first
    for k, path in enumerate(mixed):
        alone = score(made(size=1), solver(environment, 0.1), [path])
        steps = len(path.position) - 1
        assert alone.position.shape[1] == steps
        np.testing.assert_array_equal(found.position[k, :steps], alone.position[0])
        assert (found.target[k, steps:] == path.position[-1]).all()
    norms = np.linalg.norm(found.error[found.counted], axis=1)
    assert found.data(environment.robot)["rmse_m"] == pytest.approx(np.sqrt((norms**2).mean()))


def test_only_the_longest_path_is_followed_to_the_end():
    environment = made(size=2)
    short = [cut(path, 3) for path in paths_of(environment, 4)]
    found = score(environment, solver(environment), short)
    assert found.target.shape == (4, 3, 3)
    assert found.counted.all()


def test_a_path_longer_than_an_episode_is_refused():
    environment = made(size=1)
    (path,) = paths_of(environment, 1)
    longer = TargetPath(**{
        name: np.concatenate([getattr(path, name)] * 2) for name in ROWS
    })  # fmt: skip
    with pytest.raises(InvalidField, match=r"paths\[1\]: got 11 steps; allowed: 5, those of an"):
        score(environment, solver(environment), [path, longer])


def test_slack_and_overload_are_shares_of_steps_in_which_any_cable_is():
    tension = np.full((2, 4, 4), 50.0)
    tension[0, 0, 1] = 4.9
    tension[0, 0, 2] = 1.0
    tension[1, :2, 3] = 501.0
    tension[1, 3] = [5.0 - 1e-9, 50.0, 50.0, 500.0 + 1e-9]  # at the limits, to rounding
    data = made_up(tension=tension).data(simple_robot())
    assert data["slack_share"] == pytest.approx(1 / 8)
    assert data["overload_share"] == pytest.approx(2 / 8)
    assert data["tension_range_N"] == [1.0, 501.0]


def test_tilt_is_the_angle_to_the_rest_at_the_target():
    environment = made("settle")
    paths = paths_of(environment, 4)
    found = score(environment, solver(environment, 0.05), paths)
    rest = statics.inverse_kinematics(environment.robot, found.target[:, 0])
    first = environment.reset(paths)
    reached = environment.step(solver(environment, 0.05)(first)).reached
    turned = np.einsum("bji,bjk->bik", rest.rotation, reached.rotation)
    np.testing.assert_allclose(np.cos(found.tilt[:, 0]), turned[:, 2, 2], atol=1e-9)
    assert (found.tilt[:, 0] > 1e-3).all()
