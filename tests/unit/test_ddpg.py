"""The update: losses of known batches, who is changed by whom, targets, determinism."""

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch

from training.ddpg import Ddpg
from training.networks import ActorNetwork, CriticNetwork, polyak_update
from training.presets import DdpgOptions
from training.replay_buffer import Batch, ReplayBuffer

SMALL = DdpgOptions(hidden=(8, 8))
TWIN = replace(SMALL, twin_critics=True, target_noise=0.1)


def make_batch(count=16, columns=5, *, bootstrap=0.9, seed=0):
    generator = torch.Generator().manual_seed(seed)

    def draw(*shape):
        return torch.rand(*shape, generator=generator) * 2 - 1

    return Batch(
        draw(count, columns),
        draw(count, 3),
        draw(count, columns),
        draw(count),
        torch.full((count,), bootstrap),
    )


def weights(network):
    return {name: value.clone() for name, value in network.state_dict().items()}


def same(first, second):
    return all(torch.equal(first[name], second[name]) for name in first)


@pytest.mark.parametrize("options", [SMALL, TWIN], ids=["one critic", "twin critics"])
def test_the_critic_loss_of_a_terminated_batch_is_the_squared_error_to_the_reward(options):
    learner, batch = Ddpg(5, options, seed=1), make_batch(bootstrap=0.0)
    with torch.no_grad():
        q = learner.critic(batch.observation, batch.action)
        expected = (q - batch.reward).square().mean(dim=1).sum()
    assert learner.update(batch).critic == pytest.approx(expected.item(), rel=1e-5)


def test_the_bellman_target_bootstraps_from_the_target_networks():
    learner, batch = Ddpg(5, SMALL, seed=1), make_batch()
    # Targets that differ from the networks they follow, by a known amount.
    with torch.no_grad():
        learner.critic_target.biases[-1].add_(3.0)
        next_q = learner.critic(batch.next_observation, learner.actor(batch.next_observation))
        target = batch.reward + 0.9 * (next_q[0] + 3.0)
        expected = (learner.critic(batch.observation, batch.action)[0] - target).square().mean()
    assert learner.update(batch).critic == pytest.approx(expected.item(), rel=1e-5)


def test_twin_critics_take_the_smaller_value():
    learner = Ddpg(5, replace(SMALL, twin_critics=True), seed=1)
    batch = make_batch()
    with torch.no_grad():
        learner.critic_target.biases[-1][0].add_(5.0)
        learner.critic_target.biases[-1][1].add_(-5.0)
        next_action = learner.actor_target(batch.next_observation)
        smaller = learner.critic_target(batch.next_observation, next_action)[1]
        q = learner.critic(batch.observation, batch.action)
        expected = (q - (batch.reward + 0.9 * smaller)).square().mean(dim=1).sum()
    assert learner.update(batch).critic == pytest.approx(expected.item(), rel=1e-5)


def test_the_actor_step_leaves_no_gradient_in_the_critic():
    learner, batch = Ddpg(5, SMALL, seed=1), make_batch()
    gradients = []
    before_step = learner.critic_optimizer.step

    def step():
        gradients.extend(p.grad.clone() for p in learner.critic.parameters())
        before_step()

    learner.critic_optimizer.step = step
    learner.update(batch)
    after = [p.grad for p in learner.critic.parameters()]
    assert all(torch.equal(a, b) for a, b in zip(gradients, after, strict=True))


def test_the_actor_climbs_the_critic():
    """With a critic that pays for the first action column alone, that column rises."""
    options = DdpgOptions(
        hidden=(8,), critic_lr=0.0, actor_lr=0.05, pre_activation_penalty=0.0, tau=0.0
    )
    learner, batch = Ddpg(2, options, seed=1), make_batch(columns=2)
    with torch.no_grad():
        for parameter in learner.critic.parameters():
            parameter.zero_()
        learner.critic.weights[0][0, 2, 0] = 1.0  # columns: two observed, then the action
        learner.critic.biases[0][0, 0, 0] = 2.0
        learner.critic.weights[1][0, 0, 0] = 1.0
    for _ in range(40):
        learner.update(batch)
    action = learner.actor(batch.observation)
    assert (action[:, 0] > 0.9).all()
    assert (action[:, 1:].abs() < 0.1).all()


def test_the_pre_activation_penalty_pulls_back_from_saturation():
    options = DdpgOptions(hidden=(8,), critic_lr=0.0, actor_lr=0.05, pre_activation_penalty=1.0)
    learner, batch = Ddpg(5, options, seed=1), make_batch()
    with torch.no_grad():
        for parameter in learner.critic.parameters():
            parameter.zero_()
        learner.actor.head.bias.fill_(4.0)
    before = learner.actor.pre_activation(batch.observation).abs().mean()
    for _ in range(40):
        learner.update(batch)
    assert learner.actor.pre_activation(batch.observation).abs().mean() < 0.8 * before


def test_polyak_moves_by_tau():
    generator = torch.Generator().manual_seed(0)
    source, target = (ActorNetwork(4, (8,), generator) for _ in range(2))
    before = weights(target)
    polyak_update(source, target, 0.0)
    assert same(weights(target), before)
    polyak_update(source, target, 0.25)
    for name, value in target.state_dict().items():
        expected = 0.75 * before[name] + 0.25 * source.state_dict()[name]
        torch.testing.assert_close(value, expected)
    polyak_update(source, target, 1.0)
    assert same(weights(target), weights(source))


def test_an_update_moves_the_targets_by_tau():
    learner, batch = Ddpg(5, SMALL, seed=1), make_batch()
    before = weights(learner.critic_target)
    learner.update(batch)
    for name, value in learner.critic_target.state_dict().items():
        moved = 0.99 * before[name] + 0.01 * learner.critic.state_dict()[name]
        torch.testing.assert_close(value, moved)


@pytest.mark.parametrize("options", [SMALL, TWIN], ids=["one critic", "twin critics"])
def test_same_seed_same_result_and_another_seed_another(options):
    learners = [Ddpg(5, options, seed=seed) for seed in (1, 1, 2)]
    for learner in learners:
        for step in range(5):
            learner.update(make_batch(seed=step))
    assert same(weights(learners[0].actor), weights(learners[1].actor))
    assert not same(weights(learners[0].actor), weights(learners[2].actor))


def test_a_restored_learner_goes_on_bit_for_bit():
    first, second = Ddpg(5, TWIN, seed=1), Ddpg(5, TWIN, seed=2)
    for step in range(3):
        first.update(make_batch(seed=step))
    second.load_state_dict(copy.deepcopy(first.state_dict()))
    for learner in (first, second):
        for step in range(3, 6):
            learner.update(make_batch(seed=step))
    for name in ("actor", "critic", "actor_target", "critic_target", "actor_average"):
        assert same(weights(getattr(first, name)), weights(getattr(second, name)))


def test_transfer_carries_networks_and_resets_optimisers():
    source, fresh = Ddpg(5, SMALL, seed=1), Ddpg(5, SMALL, seed=2)
    for step in range(3):
        source.update(make_batch(seed=step))
    fresh.transfer_from(copy.deepcopy(source.state_dict()))
    for name in ("actor", "critic", "actor_target", "critic_target", "actor_average"):
        assert same(weights(getattr(source, name)), weights(getattr(fresh, name)))
    assert source.actor_optimizer.state_dict()["state"]
    assert not fresh.actor_optimizer.state_dict()["state"]
    assert not fresh.critic_optimizer.state_dict()["state"]


def test_the_actor_alone_can_be_carried_over():
    source, fresh = Ddpg(5, SMALL, seed=1), Ddpg(5, SMALL, seed=2)
    critic = weights(fresh.critic)
    fresh.transfer_from(source.state_dict(), actor_only=True)
    for name in ("actor", "actor_target", "actor_average"):
        assert same(weights(getattr(source, name)), weights(getattr(fresh, name)))
    assert same(weights(fresh.critic), critic)
    assert same(weights(fresh.critic_target), critic)


def test_a_fresh_actor_is_far_from_saturation():
    actor = ActorNetwork(11, (128, 128), torch.Generator().manual_seed(0))
    observation = torch.from_numpy(
        np.random.default_rng(0).uniform(-1, 1, (100, 11)).astype(np.float32)
    )
    assert actor(observation).abs().max() < 0.2


def test_the_stacked_critics_equal_separate_networks():
    critic = CriticNetwork(5, (8, 8), 2, torch.Generator().manual_seed(0))
    batch = make_batch()
    both = critic(batch.observation, batch.action)
    assert both.shape == (2, 16)
    for index in range(2):
        hidden = torch.cat((batch.observation, batch.action), dim=1)
        for layer, (weight, bias) in enumerate(zip(critic.weights, critic.biases, strict=True)):
            hidden = hidden @ weight[index] + bias[index]
            if layer < 2:
                hidden = hidden.relu()
        torch.testing.assert_close(both[index], hidden[:, 0])
    torch.testing.assert_close(both[0], critic.first(batch.observation, batch.action))


def test_an_update_touches_one_device_only(monkeypatch):
    """Torch's meta device computes nothing and, like a GPU, takes no tensor from another one.

    It knows no fused optimiser, which CPUs and GPUs do.
    """
    adam = torch.optim.Adam
    monkeypatch.setattr(torch.optim, "Adam", lambda p, *, lr, fused: adam(p, lr=lr))
    options = replace(TWIN, best_of_samples=4)
    learner = Ddpg(5, options, seed=1, device="meta")
    buffer = ReplayBuffer(64, 5, batch_size=32, device="meta")
    buffer.add(np.zeros((64, 2 * 5 + 3 + 2), dtype=np.float32))
    losses = learner.update(buffer.sample(np.random.default_rng(0)))
    assert {loss.device.type for loss in losses} == {"meta"}


def test_a_seed_means_the_same_networks_on_every_device():
    drawn = [Ddpg(5, TWIN, seed=1, device=device).noise_generator for device in ("cpu", "meta")]
    assert torch.equal(drawn[0].get_state(), drawn[1].get_state())
