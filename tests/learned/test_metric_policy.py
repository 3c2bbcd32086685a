import numpy as np
import pytest

torch = pytest.importorskip("torch")
spaces = pytest.importorskip("gymnasium.spaces")
pytest.importorskip("stable_baselines3")
metric_policy = pytest.importorskip("learned.metric_policy")

FLOOR_M2 = metric_policy.DISTANCE_FLOOR_M2
SCALE, SPAN = 0.04, 6.93


def critic(target=slice(7, 10), size=10, critics=2):
    torch.manual_seed(0)
    policy = metric_policy.MetricPolicy(
        spaces.Box(-np.inf, np.inf, (size,), np.float32), spaces.Box(-1, 1, (4,), np.float32),
        lambda _: 1e-3, net_arch=[32, 32], n_critics=critics,
        metric={"target": target, "scale": SCALE, "span": SPAN},
    )  # fmt: skip
    return policy.critic


def drawn(size, count=200, scale=3.0):
    torch.manual_seed(1)
    return scale * torch.randn(count, size), torch.rand(count, 4) * 2 - 1


def test_values_are_never_positive_and_the_first_critic_is_the_first():
    network = critic()
    observation, action = drawn(10)
    values = network(observation, action)
    assert len(values) == 2
    assert all((value < 0.0).all() for value in values)
    assert torch.equal(network.q1_forward(observation, action), values[0])
    assert not torch.equal(values[0], values[1])


def test_the_value_is_that_of_the_reward_at_the_distance_of_the_embeddings():
    network = critic()
    observation, action = drawn(10)
    reached = network.reached[0](torch.cat([observation[:, :7], action], dim=1))
    apart = torch.linalg.norm(reached - network.wanted[0](observation[:, 7:]), dim=1)
    expected = -np.log1p(apart.detach().numpy() / SCALE) / np.log1p(SPAN / SCALE)
    value = network.q1_forward(observation, action).detach().numpy()[:, 0]
    np.testing.assert_allclose(value, expected, atol=1e-5)


def test_the_value_is_zero_where_both_embeddings_agree():
    """Up to the tenth of a millimetre under the root."""
    network = critic(target=slice(0, 3), size=3)  # nothing but the target is observed
    with torch.no_grad():
        for net in (network.reached[0], network.wanted[0]):
            net[-1].weight.zero_()
            net[-1].bias.fill_(0.3)
    observation, action = drawn(3)
    value = network.q1_forward(observation, action)
    floor = -np.log1p(np.sqrt(FLOOR_M2) / SCALE) / np.log1p(SPAN / SCALE)
    assert -5e-4 < floor < 0.0
    np.testing.assert_allclose(value.detach().numpy(), floor, rtol=1e-4)
    value.sum().backward()  # and its slope is finite there
    assert all(torch.isfinite(p.grad).all() for p in network.parameters() if p.grad is not None)


def test_what_an_action_reaches_does_not_depend_on_the_target():
    """Only one embedding sees the target: the best action of two targets follows from both."""
    network = critic(target=slice(2, 5))
    observation, action = drawn(10)
    other = observation.clone()
    other[:, 2:5] += 1.0
    seen = []
    network.reached[0].register_forward_hook(lambda *call: seen.append(call[2]))
    network.q1_forward(observation, action)
    network.q1_forward(other, action)
    assert torch.equal(seen[0], seen[1])
    other[:, 5] += 1.0
    network.q1_forward(other, action)
    assert not torch.equal(seen[1], seen[2])


def test_the_target_network_begins_as_a_copy():
    policy_critic, observation_action = critic(), drawn(10)
    target = critic()
    target.load_state_dict(policy_critic.state_dict())
    assert torch.equal(
        target.q1_forward(*observation_action), policy_critic.q1_forward(*observation_action)
    )
