"""Race training against Stable-Baselines3's DDPG, and say where the time goes.

``python tests/benchmarks/race.py`` prints Markdown tables. Both learn preset ``paper``'s task in
the same world with the same layers, batch, buffer, gamma, tau, steps a transition, worlds at once
and updates a step of all worlds; theirs sees it as Gymnasium environments, as its users have it.
The clock is the processor time of this process on one thread, so that a busy machine does not
decide; it stands still while the actors are judged, on 500 cases by the same function.
"""

import argparse
import multiprocessing
import os
import platform
import statistics
import time
from collections import defaultdict
from dataclasses import dataclass

import gymnasium
import numpy as np
import torch
from stable_baselines3 import DDPG
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.vec_env import DummyVecEnv

import sim.gym
import training.trainer
from companion.world.maps import load_map
from training.evaluate import evaluate_policy
from training.places import Place
from training.presets import PRESETS
from training.seeds import Purpose
from training.trainer import Trainer, network_policy

CASES = 500
NOISE = 0.1
"""Standard deviation of the exploration noise in Stable-Baselines3's examples."""


@dataclass
class Lap:
    """One run: when it first reached the rate asked for, or what it had when its time was up."""

    reached_s: float | None
    seconds: float
    updates: int
    best: float


def rate_of(policy, preset, map_name):
    maps = [load_map(map_name)]
    return evaluate_policy(
        policy,
        maps,
        preset.layout,
        preset.scaling,
        episodes=CASES,
        seed=0,
        purpose=Purpose.VALIDATION,
        now_s=time.perf_counter,
    ).completion_rate


def race(advance, policy, preset, map_name, *, goal, cap_s, every):
    """Call ``advance`` until ``goal`` is reached or ``cap_s`` of processor time are spent."""
    spent_s, updates, best = 0.0, 0, 0.0
    while True:
        begun_s, before = time.process_time(), updates
        while updates < before + every:
            updates += advance()
        spent_s += time.process_time() - begun_s
        rate = rate_of(policy, preset, map_name)
        best = max(best, rate)
        if rate >= goal:
            return Lap(spent_s, spent_s, updates, best)
        if spent_s >= cap_s:
            return Lap(None, spent_s, updates, best)


def ours(preset, map_name, seed, networks, **limits):
    trainer = Trainer(preset, Place(map=map_name), seed)
    if networks is not None:
        trainer.learner.transfer_from(networks)

    def advance():
        before = trainer.updates
        trainer.advance()
        return trainer.updates - before

    lap = race(advance, network_policy(trainer.learner.actor), preset, map_name, **limits)
    return lap, trainer.learner.state_dict()


def theirs(preset, map_name, seed, networks, **limits):
    options = preset.world

    def make():
        return gymnasium.make(
            sim.gym.ENVIRONMENT_ID,
            map=map_name,
            layout=preset.layout_name,
            scaling=preset.scaling,
            horizon=options.horizon,
            arrival_radius_m=options.arrival_radius_m,
            reward=options.reward,
            end_on_contact=options.end_on_contact,
            restart_probability=options.restart_probability,
            arrived_restart_probability=options.arrived_restart_probability,
        )

    worlds = DummyVecEnv([make] * preset.num_worlds)
    model = DDPG(
        "MlpPolicy",
        worlds,
        learning_rate=preset.ddpg.critic_lr,
        buffer_size=preset.replay_capacity,
        learning_starts=preset.warmup_steps * preset.num_worlds,
        batch_size=preset.batch_size,
        tau=preset.ddpg.tau,
        gamma=preset.ddpg.gamma,
        train_freq=1,
        gradient_steps=preset.updates_per_step,
        n_steps=preset.num_steps,
        action_noise=NormalActionNoise(np.zeros(3), NOISE * np.ones(3)),
        policy_kwargs={"net_arch": list(preset.ddpg.hidden)},
        seed=seed,
        device="cpu",
    )
    if networks is not None:
        model.set_parameters(networks)

    def advance():
        before = model._n_updates
        model.learn(50 * preset.num_worlds, reset_num_timesteps=False)
        return model._n_updates - before

    def policy(world, observation):
        return model.predict(observation, deterministic=True)[0]

    return race(advance, policy, preset, map_name, **limits), model.get_parameters()


LEARNERS = {"ours": ours, "Stable-Baselines3": theirs}


def compete(seeds, stages, processes):
    """Return the laps of both learners with every seed, each in a process of its own."""
    runs = [(seed, name, stages) for seed in seeds for name in LEARNERS]
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        return [row for rows in pool.imap_unordered(run, runs, chunksize=1) for row in rows]


def run(arguments):
    seed, name, stages = arguments
    torch.set_num_threads(1)
    rows, networks = [], None
    for stage, map_name, goal, cap_s in stages:
        lap, networks = LEARNERS[name](
            PRESETS["paper", stage], map_name, seed, networks, goal=goal, cap_s=cap_s, every=500
        )
        rows.append((map_name, goal, name, seed, lap))
        said = f"{lap.reached_s:.0f} s" if lap.reached_s else f"not in {lap.seconds:.0f} s"
        print(f"{map_name} seed {seed} {name}: {said}, best {lap.best:.3f}", flush=True)
    return rows


def table(rows):
    print("\n| Task | Learner | Seeds that reached it | Processor seconds to it | Updates | Best |")
    print("|---|---|---|---|---|---|")
    for map_name, goal in dict.fromkeys((row[0], row[1]) for row in rows):
        for name in LEARNERS:
            laps = [r[4] for r in rows if (r[0], r[2]) == (map_name, name)]
            there = [lap.reached_s for lap in laps if lap.reached_s is not None]
            times = (
                f"{statistics.mean(there):.0f} ({min(there):.0f} - {max(there):.0f})"
                if there
                else f"not in {min(lap.seconds for lap in laps):.0f}"
            )
            print(
                f"| {map_name} to {goal:.0%} | {name} | {len(there)} of {len(laps)} | {times} "
                f"| {statistics.mean(lap.updates for lap in laps):,.0f} "
                f"| {max(lap.best for lap in laps):.1%} |"
            )


def profile(updates):
    """Print the share of each part of training on env1, after a warm-up that is not counted."""
    preset = PRESETS["paper", "obstacles"]
    trainer = Trainer(preset, Place(map="env1"), 0)
    spent, learner = defaultdict(float), trainer.learner
    marks = {}

    def timed(owner, name, part):
        function = getattr(owner, name)

        def wrapper(*arguments, **options):
            begun_s = time.perf_counter()
            try:
                return function(*arguments, **options)
            finally:
                spent[part] += time.perf_counter() - begun_s

        setattr(owner, name, wrapper)

    def marked(optimizer, mark):
        step = optimizer.step

        def wrapper(*arguments, **options):
            result = step(*arguments, **options)
            marks[mark] = time.perf_counter()
            return result

        optimizer.step = wrapper

    timed(trainer.world, "step", "world")
    timed(training.trainer, "act", "inference")
    for owner, name in (
        (trainer.buffer, "add"),
        (trainer.buffer, "sample"),
        (trainer.multi_step, "push"),
    ):
        timed(owner, name, "buffer")
    timed(learner, "_distance_to_best", "sampled actions")
    marked(learner.critic_optimizer, "critic")
    marked(learner.actor_optimizer, "actor")
    update = learner.update

    def timed_update(batch):
        begun_s = time.perf_counter()
        sampled_s = spent["sampled actions"]
        losses = update(batch)
        ended_s = time.perf_counter()
        spent["critic, with its target values"] += marks["critic"] - begun_s
        sampled_s = spent["sampled actions"] - sampled_s
        spent["actor"] += marks["actor"] - marks["critic"] - sampled_s
        spent["target networks and norms"] += ended_s - marks["actor"]
        return losses

    learner.update = timed_update
    while trainer.updates < 200:
        trainer.advance()
    spent.clear()
    begun_s = time.perf_counter()
    while trainer.updates < 200 + updates:
        trainer.advance()
    total_s = time.perf_counter() - begun_s
    spent["the rest"] = total_s - sum(spent.values())
    print(f"Where {updates} updates on env1 spent {total_s:.0f} s:\n")
    print("| Part | Share | Milliseconds an update |")
    print("|---|---|---|")
    for part, seconds in sorted(spent.items(), key=lambda entry: -entry[1]):
        print(f"| {part} | {seconds / total_s:.0%} | {1e3 * seconds / updates:.2f} |")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--free-cap-s", type=float, default=300.0)
    parser.add_argument("--env1-cap-s", type=float, default=900.0)
    parser.add_argument("--processes", type=int, default=1, help="runs at a time")
    parser.add_argument("--profile-updates", type=int, default=1_000)
    options = parser.parse_args()
    torch.set_num_threads(1)
    print(
        f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, "
        f"torch {torch.__version__}, load average {os.getloadavg()[0]:.1f}\n"
    )
    profile(options.profile_updates)
    print()
    stages = [("free", "free", 0.95, options.free_cap_s)]
    if options.env1_cap_s > 0.0:
        stages.append(("obstacles", "env1", 0.84, options.env1_cap_s))
    table(compete(options.seeds, stages, options.processes))


if __name__ == "__main__":
    main()
