"""Algorithm 1 of the paper, lines 3 to 9: collect with many worlds, learn, validate."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch

from companion.arrays import Float32Array, FloatArray
from companion.world.maps import Map
from sim.guides import Surveyor
from sim.world import CityWorld
from training.ddpg import Ddpg, Losses
from training.evaluate import Evaluation, Policy, evaluate_policy
from training.loop import evaluate_loop
from training.networks import ActorNetwork
from training.places import Place
from training.presets import Preset
from training.replay_buffer import MultiStep, ReplayBuffer
from training.seeds import Purpose, generator

TARGETS_PER_MAP = 32
"""Where the actor is shown the way: so many targets on each map, the ways to them found before."""
SATURATED = 0.98
"""An action column beyond this is saturated: tanh's slope is below 4 % there."""


_LOSSES = ("critic_loss", "actor_loss", "q", "critic_gradient", "actor_gradient")
"""Names in the log of the fields of ``Losses``, averaged over the updates between two lines."""


class Trainer:
    """One run: worlds, buffer and learner, with everything that a checkpoint must hold."""

    def __init__(
        self, preset: Preset, place: Place, seed: int, device: torch.device | str = "cpu"
    ) -> None:
        self.preset = preset
        self.place = place
        self.maps = place.training_maps()
        self.seed = seed
        self.updates = 0
        self.steps = 0
        options = preset.world
        self.world = CityWorld(
            self.maps,
            preset.layout,
            preset.scaling,
            preset.num_worlds,
            generator(seed, Purpose.WORLD),
            horizon=options.horizon,
            arrival_radius_m=options.arrival_radius_m,
            reward=options.reward,
            end_on_contact=options.end_on_contact,
            restart_probability=options.restart_probability,
            arrived_restart_probability=options.arrived_restart_probability,
            dynamics=options.dynamics,
            imperfections=options.imperfections,
            targets_per_map=TARGETS_PER_MAP if preset.layout.shows_way else None,
        )
        self._surveyor = Surveyor()
        network_seed = int(generator(seed, Purpose.NETWORKS).integers(2**62))
        num_columns = len(preset.layout.fields)
        self.learner = Ddpg(num_columns, preset.ddpg, network_seed, device)
        # Line 3: the replay buffer.
        self.buffer = ReplayBuffer(preset.replay_capacity, num_columns, preset.batch_size, device)
        self.multi_step = MultiStep(preset.num_steps, preset.ddpg.gamma)
        self._explore_rng = generator(seed, Purpose.EXPLORATION)
        self._replay_rng = generator(seed, Purpose.REPLAY)
        # Line 5: the first observation.
        self._observation = self.world.reset()
        self.meter = Meter(device)
        self.best = Best()

    @property
    def finished(self) -> bool:
        """Whether all updates were made."""
        return self.updates >= self.preset.updates

    @property
    def epsilon(self) -> float:
        """Chance of a random action now; falls linearly over ``epsilon_fraction`` of the run."""
        preset = self.preset
        share = min(1.0, self.updates / (preset.epsilon_fraction * preset.updates))
        return preset.epsilon_start + share * (preset.epsilon_end - preset.epsilon_start)

    def advance(self) -> None:
        """Step every world once, then make the updates that belong to one step."""
        # Line 7: a random action with chance epsilon, else the actor's.
        action = self._explore(act(self.learner.actor, self._observation))
        # Line 8: execute it.
        result = self.world.step(action)
        # Line 9: store the transition, with the successor from before any reset.
        self.buffer.add(
            self.multi_step.push(
                self._observation,
                action,
                result.reward,
                result.next_observation,
                result.terminated,
                result.truncated,
            )
        )
        self.meter.add_episodes(result.episode_end.reward_sum, result.episode_end.reached)
        self._observation = result.observation
        self.steps += 1
        if self.steps <= self.preset.warmup_steps:
            return
        for _ in range(self.preset.updates_per_step):
            self._set_learning_rates()
            # Line 10: a random batch; lines 11 to 14 are the learner's.
            losses = self.learner.update(self.buffer.sample(self._replay_rng))
            self.meter.add_losses(losses)
            self.updates += 1

    def validate(self, now_s: Callable[[], float]) -> dict[str, Evaluation]:
        """Evaluate the actor and its average on validation cases; keep the best ever seen."""
        maps = self.place.validation_maps()
        networks = {"actor": self.learner.actor, "actor_average": self.learner.actor_average}
        results: dict[str, Evaluation] = {}
        for name, network in networks.items():
            results[name] = fly_cases(
                self.preset,
                self.world.v_max_mps,
                network_policy(network),
                maps,
                episodes=self.preset.validation_episodes,
                seed=self.seed,
                purpose=Purpose.VALIDATION,
                surveyor=self._surveyor,
                now_s=now_s,
            )
            self.best.offer(results[name], network, f"{name} after {self.updates} updates")
        return results

    def saturated(self) -> list[float]:
        """Return the share of saturated actions of each column, over the worlds as they are."""
        action = act(self.learner.actor, self._observation)
        return [float(share) for share in (np.abs(action) > SATURATED).mean(axis=0)]

    def state_dict(self) -> dict[str, Any]:
        """Return all that is needed to go on to the same result, bit for bit."""
        return {
            "updates": self.updates,
            "steps": self.steps,
            "world": self.world.state_dict(),
            "learner": self.learner.state_dict(),
            "buffer": self.buffer.state_dict(),
            "multi_step": self.multi_step.state_dict(),
            "explore_rng": self._explore_rng.bit_generator.state,
            "replay_rng": self._replay_rng.bit_generator.state,
            "meter": self.meter.state_dict(),
            "best": self.best.state_dict(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from a ``state_dict`` of the same run."""
        self.updates, self.steps = state["updates"], state["steps"]
        self._observation = self.world.load_state_dict(state["world"])
        self.learner.load_state_dict(state["learner"])
        self.buffer.load_state_dict(state["buffer"])
        self.multi_step.load_state_dict(state["multi_step"])
        self._explore_rng.bit_generator.state = state["explore_rng"]
        self._replay_rng.bit_generator.state = state["replay_rng"]
        self.meter.load_state_dict(state["meter"])
        self.best.load_state_dict(state["best"])

    def _explore(self, action: Float32Array) -> Float32Array:
        """Return the action with noise, replaced by a random one with chance epsilon."""
        rng, shape = self._explore_rng, action.shape
        std = self.preset.exploration_noise
        if std > 0.0:
            action = action + std * rng.standard_normal(shape, dtype=np.float32)
        random = rng.uniform(-1.0, 1.0, shape).astype(np.float32)
        chosen = rng.random((shape[0], 1)) < self.epsilon
        return np.clip(np.where(chosen, random, action), -1.0, 1.0)

    def _set_learning_rates(self) -> None:
        share = self.updates / self.preset.updates
        factor = 1.0 + share * (self.preset.lr_final - 1.0)
        options = self.preset.ddpg
        self.learner.actor_optimizer.param_groups[0]["lr"] = options.actor_lr * factor
        self.learner.critic_optimizer.param_groups[0]["lr"] = options.critic_lr * factor


def fly_cases(
    preset: Preset,
    v_max_mps: float,
    policy: Policy,
    maps: Sequence[Map],
    *,
    episodes: int,
    seed: int,
    purpose: Purpose,
    surveyor: Surveyor | None = None,
    now_s: Callable[[], float],
) -> Evaluation:
    """Evaluate a policy the way the preset's actors are judged: in the loop or kinematic."""
    place = (policy, maps, preset.layout, preset.scaling)
    if not preset.in_the_loop:
        return evaluate_policy(*place, episodes=episodes, seed=seed, purpose=purpose, now_s=now_s)
    return evaluate_loop(
        *place,
        v_max_mps=v_max_mps,
        episodes=episodes,
        seed=seed,
        purpose=purpose,
        surveyor=surveyor,
        now_s=now_s,
    )


@torch.inference_mode()
def act(network: ActorNetwork, observation: Float32Array) -> Float32Array:
    """Return the network's action, shape ``(N, 3)``, without a graph."""
    device = network.head.weight.device
    action: Float32Array = network(torch.from_numpy(observation).to(device)).cpu().numpy()
    return action


def network_policy(network: ActorNetwork) -> Policy:
    """Return the network as something that ``evaluate_policy`` can fly."""

    def policy(_: CityWorld, observation: Float32Array) -> Float32Array:
        return act(network, observation)

    return policy


class Meter:
    """What is averaged between two log lines."""

    def __init__(self, device: torch.device | str = "cpu") -> None:
        # Summed on the device: to read a loss at every update would make a GPU wait.
        self._losses = torch.zeros(len(_LOSSES), device=device)
        self._updates, self._episodes = 0, np.zeros(3)

    def add_losses(self, losses: Losses) -> None:
        """Count one update."""
        self._losses += torch.stack(losses)
        self._updates += 1

    def add_episodes(self, returns: FloatArray, reached: np.ndarray[Any, Any]) -> None:
        """Count the episodes that ended in a step."""
        self._episodes += (returns.sum(), reached.sum(), len(returns))

    def take(self) -> dict[str, float | None]:
        """Return the averages since the last call and start again."""
        updates, sums = self._updates, self._losses.tolist()
        returns, reached, episodes = self._episodes.tolist()
        self._losses = torch.zeros_like(self._losses)
        self._updates, self._episodes = 0, np.zeros(3)
        return {
            **{n: s / updates if updates else None for n, s in zip(_LOSSES, sums, strict=True)},
            "return": returns / episodes if episodes else None,
            "reached": reached / episodes if episodes else None,
            "episodes": episodes,
        }

    def state_dict(self) -> dict[str, Any]:
        """Return the sums."""
        return {"losses": self._losses, "updates": self._updates, "episodes": self._episodes}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore the sums."""
        self._losses = state["losses"].to(self._losses.device)
        self._updates, self._episodes = state["updates"], state["episodes"]


class Best:
    """The actor that did best on validation so far."""

    def __init__(self) -> None:
        self.score: tuple[float, float, float] = (-1.0, -1.0, -1.0)
        """Completion at 5, 2 and 1 m: compared in this order."""
        self.source = "none validated yet"
        self.network: dict[str, torch.Tensor] = {}

    def offer(self, evaluation: Evaluation, network: ActorNetwork, source: str) -> None:
        """Keep a copy of ``network`` if it did better than any before."""
        score = (evaluation.completion_rate, evaluation.completion_2m, evaluation.completion_1m)
        if score > self.score:
            self.score, self.source = score, source
            self.network = {
                name: value.detach().to("cpu", copy=True)
                for name, value in network.state_dict().items()
            }

    def state_dict(self) -> dict[str, Any]:
        """Return the best actor and its score."""
        return {"score": self.score, "source": self.source, "network": self.network}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore the best actor and its score."""
        self.score, self.source = tuple(state["score"]), state["source"]
        self.network = state["network"]
