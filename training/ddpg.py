"""Algorithm 1 of the paper: the update, lines 10 to 14.

The loop around it (lines 4 to 9) is in ``train``. Additions to the paper are options, each off
in preset ``paper`` unless its documentation says otherwise.
"""

import copy
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F
from torch.nn.utils import get_total_norm

from training.networks import ACTION_SIZE, ActorNetwork, CriticNetwork, polyak_update
from training.presets import DdpgOptions
from training.replay_buffer import Batch

_NEARBY_STD = 0.2
"""Spread of the sampled actions near the actor's own: 2 m of 20, 18 degrees, 36 degrees."""


class Losses(NamedTuple):
    """Of one update; tensors without a graph, so that reading them is left to the log."""

    critic: Tensor
    actor: Tensor
    value: Tensor
    """Mean Q of the batch's states under the actor."""
    critic_gradient: Tensor
    """Norm of the gradient of the critic loss,"""
    actor_gradient: Tensor
    """and of the actor's."""


class Ddpg:
    """Actor, critic, their targets and optimisers."""

    def __init__(
        self,
        observation_size: int,
        options: DdpgOptions,
        seed: int,
        device: torch.device | str = "cpu",
    ) -> None:
        self.options = options
        self.device = torch.device(device)
        # On the CPU whatever the device: a seed then means the same numbers on all of them.
        self.noise_generator = torch.Generator().manual_seed(seed)

        # Lines 1 and 2: random actor and critic, targets equal to them.
        self.actor = ActorNetwork(observation_size, options.hidden, self.noise_generator)
        num_critics = 2 if options.twin_critics else 1
        self.critic = CriticNetwork(
            observation_size, options.hidden, num_critics, self.noise_generator
        )
        self.actor.to(self.device)
        self.critic.to(self.device)
        self.actor_target = copy.deepcopy(self.actor).requires_grad_(False)
        self.critic_target = copy.deepcopy(self.critic).requires_grad_(False)
        self.actor_average = copy.deepcopy(self.actor).requires_grad_(False)

        self.actor_optimizer = torch.optim.Adam(
            self.actor.parameters(), lr=options.actor_lr, fused=True
        )
        self.critic_optimizer = torch.optim.Adam(
            self.critic.parameters(), lr=options.critic_lr, fused=True
        )

    def update(self, batch: Batch) -> Losses:
        """Take one gradient step on the critic and one on the actor, then track the targets."""
        # Line 11: the Bellman target. Truncated episodes bootstrap, terminated ones do not.
        with torch.no_grad():
            next_action = self._next_action(batch.next_observation)
            next_q = self.critic_target(batch.next_observation, next_action).amin(dim=0)
            target_q = batch.reward + batch.bootstrap * next_q

        # Line 12: minimise the mean squared error of the critic, of both where there are two.
        q = self.critic(batch.observation, batch.action)
        critic_loss = F.mse_loss(q, target_q.expand_as(q), reduction="sum") / len(target_q)
        self.critic_optimizer.zero_grad()
        critic_loss.backward()
        self.critic_optimizer.step()

        # Line 13: ascend Q along the policy. No gradient is computed for the critic's weights.
        pre_activation = self.actor.pre_activation(batch.observation)
        action = torch.tanh(pre_activation)
        value = self.critic.first(batch.observation, action).mean()
        penalty = self.options.pre_activation_penalty * pre_activation.square().mean()
        attraction = self.options.best_of_weight * self._distance_to_best(batch.observation, action)
        actor_loss = penalty - value + attraction
        self.actor_optimizer.zero_grad()
        actor_loss.backward(inputs=list(self.actor.parameters()))
        self.actor_optimizer.step()

        # Line 14: the target networks follow, by tau = 1 - nu (E5).
        polyak_update(self.critic, self.critic_target, self.options.tau)
        polyak_update(self.actor, self.actor_target, self.options.tau)
        polyak_update(self.actor, self.actor_average, self.options.average_tau)
        return Losses(
            critic_loss.detach(),
            actor_loss.detach(),
            value.detach(),
            _gradient_norm(self.critic),
            _gradient_norm(self.actor),
        )

    def _next_action(self, next_observation: Tensor) -> Tensor:
        """Return mu'(s'), with TD3's clipped noise where the options ask for it."""
        action: Tensor = self.actor_target(next_observation)
        std = self.options.target_noise
        if std == 0.0:
            return action
        noise = self._normal(action.shape)
        return (action + (std * noise).clamp(-2.0 * std, 2.0 * std)).clamp(-1.0, 1.0)

    def _distance_to_best(self, observation: Tensor, action: Tensor) -> Tensor:
        """Return the squared distance from the actor's actions to the best of random ones.

        Zero where the actor's own is the best by the critic, and where the options ask for none.
        """
        half = self.options.best_of_samples // 2
        if half == 0:
            return torch.zeros((), device=self.device)
        count = int(self.options.best_of_share * len(action))
        own, seen = action[:count], observation[:count]
        with torch.no_grad():
            shape = (half, count, ACTION_SIZE)
            anywhere = 2.0 * self._uniform(shape) - 1.0
            step = _NEARBY_STD * self._normal(shape)
            candidates = torch.cat((own[None], anywhere, (own + step).clamp(-1.0, 1.0)))
            repeated = seen.expand(len(candidates), -1, -1).flatten(0, 1)
            q = self.critic(repeated, candidates.flatten(0, 1)).amin(dim=0)
            winner = q.view(len(candidates), count).argmax(dim=0)
            best = candidates[winner, torch.arange(count, device=self.device)]
        return (own - best).square().sum(dim=-1).mean()

    def _normal(self, shape: Sequence[int]) -> Tensor:
        return torch.randn(shape, generator=self.noise_generator).to(self.device)

    def _uniform(self, shape: Sequence[int]) -> Tensor:
        return torch.rand(shape, generator=self.noise_generator).to(self.device)

    def state_dict(self) -> dict[str, Any]:
        """Return networks, optimisers and the noise's generator."""
        return {
            **{name: getattr(self, name).state_dict() for name in (*_NETWORKS, *_OPTIMIZERS)},
            "noise_generator": self.noise_generator.get_state(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore everything ``state_dict`` returned."""
        for name in (*_NETWORKS, *_OPTIMIZERS):
            getattr(self, name).load_state_dict(state[name])
        self.noise_generator.set_state(state["noise_generator"])

    def transfer_from(self, state: Mapping[str, Any], *, actor_only: bool = False) -> None:
        """Start from another stage's networks: the paper's transfer learning.

        Actor, critic and targets are carried over, or the actor and its target alone. Optimisers
        keep their fresh state, because the moments of the old task's gradients say nothing of the
        new one; replay buffer and epsilon are the caller's and start afresh.
        """
        for name in ACTORS if actor_only else _NETWORKS:
            getattr(self, name).load_state_dict(state[name])


def _gradient_norm(network: torch.nn.Module) -> Tensor:
    return get_total_norm(p.grad for p in network.parameters() if p.grad is not None)


ACTORS = ("actor", "actor_target", "actor_average")
_NETWORKS = (*ACTORS, "critic", "critic_target")
_OPTIMIZERS = ("actor_optimizer", "critic_optimizer")
