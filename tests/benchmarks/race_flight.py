"""Train Stable-Baselines3's TD3 and SAC in the world of preset ``flight``, and fly what comes out.

``python tests/benchmarks/race_flight.py`` prints a Markdown table. Every learner has the same
world (that of our own trainer, cities and ways and all), observation, actions, reward, hidden
layers, batch, buffer, gamma, steps a transition, gradient steps and steps of the world, learning
rates that fall alike, a free stage first and its networks carried over. What makes the algorithm
is its own, as Stable-Baselines3 has it: exploration, learning rate, tau, delays, entropy.

Of each run the network that did best on validation is tested, in the control loop, on the cases
of ``training evaluate --cities 100``, alone and with the shield. The clock is the processor time
of this process on one thread; it stands still while networks are judged.
"""

import argparse
import json
import multiprocessing
import os
import platform
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

import gymnasium
import numpy as np
import torch
from stable_baselines3 import SAC, TD3
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.vec_env import VecEnv

from sim.guides import Surveyor
from training.evaluate import wilson_interval
from training.loop import evaluate_loop
from training.places import TEST_CITIES, Place
from training.presets import PRESETS
from training.seeds import Purpose
from training.trainer import Trainer, fly_cases, network_policy

CITIES = 64
"""As many as the shipped actor was trained on."""
NOISE = 0.1
"""Standard deviation of TD3's exploration noise, as in its paper."""
FIRST_ENTROPY = "auto_0.1"
"""SAC's first entropy coefficient, adapted from there on. By default it is 1 and would outweigh
this reward, at most 0.4 a step, for most of the free stage."""


class Worlds(VecEnv):
    """Our worlds as Stable-Baselines3 steps them: all at once."""

    def __init__(self, world):
        self.world = world
        low, high = world.layout.bounds()
        super().__init__(
            world.num_worlds,
            gymnasium.spaces.Box(low, high, dtype=np.float32),
            gymnasium.spaces.Box(-1.0, 1.0, (3,), dtype=np.float32),
        )

    def reset(self):
        return self.world.reset()

    def step_async(self, actions):
        self._actions = actions

    def step_wait(self):
        result = self.world.step(self._actions)
        infos = [{} for _ in range(self.num_envs)]
        done = result.terminated | result.truncated
        for row in np.flatnonzero(done):
            infos[row] = {
                "terminal_observation": result.next_observation[row],
                "TimeLimit.truncated": bool(result.truncated[row]),
            }
        return result.observation, result.reward.astype(np.float32), done, infos

    def close(self):
        pass

    def get_attr(self, attr_name, indices=None):
        return [None] * self.num_envs

    def set_attr(self, attr_name, value, indices=None):
        raise NotImplementedError

    def env_method(self, method_name, *method_args, indices=None, **method_kwargs):
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class, indices=None):
        return [False] * self.num_envs


class Judge:
    """Stops the clock, validates, and remembers the best networks."""

    def __init__(self, preset, place, seed, label):
        self.preset, self.maps, self.seed, self.label = preset, place.validation_maps(), seed, label
        self.surveyor = Surveyor()
        self.best, self.networks = (-1.0,), None
        self.spent_s, self._begun_s = 0.0, time.process_time()

    def validate(self, updates, candidates):
        """Fly each policy; ``candidates`` are pairs of it and what to keep should it be best."""
        self.spent_s += time.process_time() - self._begun_s
        for policy, networks in candidates:
            result = fly_cases(
                self.preset,
                5.0,
                policy,
                self.maps,
                episodes=self.preset.validation_episodes,
                seed=self.seed,
                purpose=Purpose.VALIDATION,
                surveyor=self.surveyor,
                now_s=time.perf_counter,
            )
            score = (result.completion_rate, result.completion_2m, result.completion_1m)
            print(
                f"{self.label}, {updates} updates, {self.spent_s:.0f} s: {score[0]:.3f}, "
                f"2 m {score[1]:.3f}, collided {result.collision_rate:.3f}",
                flush=True,
            )
            if score > self.best:
                self.best, self.networks = score, networks()
        self._begun_s = time.process_time()


class Validate(BaseCallback):
    """Lets the judge look every so many updates."""

    def __init__(self, judge):
        super().__init__()
        self._judge, self._next = judge, judge.preset.validate_every

    def _on_step(self):
        return True

    def _on_rollout_start(self):
        # Updates come after a rollout: what was due is seen before the next one.
        updates = self.model._n_updates - self._begun
        if updates >= self._next:
            self._next += self._judge.preset.validate_every
            self._validate(updates)

    def _on_training_start(self):
        self._begun = self.model._n_updates

    def _on_training_end(self):
        self._validate(self.model._n_updates - self._begun)

    def _validate(self, updates):
        kept = self.model.get_parameters
        self._judge.validate(updates, [(policy_of(self.model), lambda: copied(kept()))])


def copied(parameters):
    return {
        name: {k: v.clone() if torch.is_tensor(v) else v for k, v in state.items()}
        if isinstance(state, dict)
        else state.detach().clone()
        for name, state in parameters.items()
    }


def policy_of(model):
    def policy(world, observation):
        return model.predict(observation, deterministic=True)[0]

    return policy


def theirs(algorithm, preset, place, seed, networks, judge):
    trainer = Trainer(preset, place, seed)
    first_lr, options = (1e-3, {}) if algorithm is TD3 else (3e-4, {"ent_coef": FIRST_ENTROPY})
    if algorithm is TD3:
        options["action_noise"] = NormalActionNoise(np.zeros(3), NOISE * np.ones(3))
    model = algorithm(
        "MlpPolicy",
        Worlds(trainer.world),
        learning_rate=lambda left: first_lr * (preset.lr_final + left * (1.0 - preset.lr_final)),
        buffer_size=preset.replay_capacity,
        learning_starts=preset.warmup_steps * preset.num_worlds,
        batch_size=preset.batch_size,
        gamma=preset.ddpg.gamma,
        train_freq=1,
        gradient_steps=preset.updates_per_step,
        n_steps=preset.num_steps,
        policy_kwargs={"net_arch": list(preset.ddpg.hidden)},
        seed=seed,
        device="cpu",
        **options,
    )
    if networks is not None:
        model.set_parameters(networks)
    steps = preset.warmup_steps + preset.updates // preset.updates_per_step
    model.learn(steps * preset.num_worlds, callback=Validate(judge))
    model.set_parameters(judge.networks)
    return policy_of(model), judge.networks


def ours(preset, place, seed, networks, judge):
    trainer = Trainer(preset, place, seed)
    learner = trainer.learner
    if networks is not None:
        learner.transfer_from(networks)
    due = preset.validate_every
    while not trainer.finished:
        trainer.advance()
        if trainer.updates >= due or trainer.finished:
            due += preset.validate_every
            judge.validate(
                trainer.updates,
                [
                    (network_policy(network), lambda network=network: carried(learner, network))
                    for network in (learner.actor, learner.actor_average)
                ],
            )
    learner.transfer_from(judge.networks)
    return network_policy(learner.actor), judge.networks


def carried(learner, best):
    """Return copies of the networks, with the best actor for all three of them."""
    state = copied({k: v for k, v in learner.state_dict().items() if k != "noise_generator"})
    actor = {name: value.clone() for name, value in best.state_dict().items()}
    return state | dict.fromkeys(("actor", "actor_target", "actor_average"), actor)


LEARNERS = {
    "ours": ours,
    "td3": lambda *arguments: theirs(TD3, *arguments),
    "sac": lambda *arguments: theirs(SAC, *arguments),
}


def run(name, seed, episodes, shielded_episodes):
    """Train through both stages and return what came of it."""
    torch.set_num_threads(1)
    networks, seconds = None, 0.0
    for stage, place in (("free", Place(map="free")), ("obstacles", Place(cities=CITIES))):
        preset = PRESETS["flight", stage]
        judge = Judge(preset, place, seed, f"{name} seed {seed} {stage}")
        policy, networks = LEARNERS[name](preset, place, seed, networks, judge)
        seconds += judge.spent_s
    surveyor, tested = Surveyor(), {}
    for key, shield, count in (("alone", False, episodes), ("shield", True, shielded_episodes)):
        if count > 0:
            tested[key] = evaluate_loop(
                policy,
                Place(cities=TEST_CITIES).test_maps(),
                preset.layout,
                preset.scaling,
                v_max_mps=5.0,
                episodes=count,
                seed=0,
                shield=shield,
                surveyor=surveyor,
                now_s=time.perf_counter,
            )
    return {
        "learner": name,
        "seed": seed,
        "seconds": round(seconds),
        "validation": judge.best[0],
        **{
            key: {
                "episodes": result.episodes,
                "completion_rate": result.completion_rate,
                "collision_rate": result.collision_rate,
                "completion_2m": result.completion_2m,
                "spl": result.spl,
            }
            for key, result in tested.items()
        },
    }


def table(rows):
    print("\n| Learner | Seed | Processor seconds | Validation | Test, alone | Collided | SPL |")
    print("|---|---|---|---|---|---|---|")
    for row in rows:
        alone = row["alone"]
        low, high = wilson_interval(alone["completion_rate"], alone["episodes"])
        print(
            f"| {row['learner']} | {row['seed']} | {row['seconds']} | {row['validation']:.1%} "
            f"| {alone['completion_rate']:.1%} [{100 * low:.1f}, {100 * high:.1f}] "
            f"| {alone['collision_rate']:.1%} | {alone['spl']:.2f} |"
        )
    print("\n| Learner | Seed | With shield | Collided | Cases |\n|---|---|---|---|---|")
    for row in rows:
        if "shield" in row:
            shield = row["shield"]
            print(
                f"| {row['learner']} | {row['seed']} | {shield['completion_rate']:.1%} "
                f"| {shield['collision_rate']:.1%} | {shield['episodes']} |"
            )


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--learners", nargs="+", choices=LEARNERS, default=list(LEARNERS))
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--shielded-episodes", type=int, default=400)
    parser.add_argument("--processes", type=int, default=1, help="so many runs at a time")
    parser.add_argument("--out", type=Path, help="file to which results are appended as they come")
    options = parser.parse_args()
    print(
        f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, "
        f"torch {torch.__version__}, load average {os.getloadavg()[0]:.1f}\n",
        flush=True,
    )
    rows = []
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(options.processes, context) as pool:
        racing = [
            pool.submit(run, name, seed, options.episodes, options.shielded_episodes)
            for seed in options.seeds
            for name in options.learners
        ]
        for over in as_completed(racing):
            rows.append(over.result())
            if options.out is not None:
                with options.out.open("a") as file:
                    file.write(json.dumps(rows[-1]) + "\n")
    table(sorted(rows, key=lambda row: (row["learner"], row["seed"])))


if __name__ == "__main__":
    main()
