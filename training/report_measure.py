"""Numbers of a report: policies flown on test cases, with their floor and their ceiling."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch

from companion.arrays import FloatArray
from companion.policy.action import PAPER_SCALING
from companion.policy.observation import LAYOUTS
from companion.world.maps import load_map
from training.baselines import PlanAndTrack
from training.curves import read_log, reward_curve, validation_curve
from training.evaluate import Policy, fly_straight, paper_world, summarise
from training.flights import Flights, fly
from training.networks import ActorNetwork
from training.presets import Preset
from training.report_data import Baseline, RunCurves, RunResult, Score, thinned
from training.reproduce_plan import Job
from training.run_folder import RunFolder
from training.shortest_ways import ShortestWays, way_lengths_m
from training.trainer import network_policy

TEST_SEED = 0
MAPS = ("free", "env1", "env2")

NowS = Callable[[], float]


class Cases:
    """The test cases of the paper's maps, the same for every policy."""

    def __init__(self, count: int, now_s: NowS) -> None:
        self.count = count
        self._now_s = now_s
        self._find_ways = ShortestWays()
        self._shortest_m: dict[str, FloatArray] = {}

    def fly(
        self, policy: Policy, map_name: str, preset: Preset | None = None, *, moving: bool = False
    ) -> tuple[Score, Flights]:
        """Fly all cases of a map.

        Args:
            policy: What flies.
            map_name: Where.
            preset: Whose layout and action it knows; the paper's for policies that know none.
            moving: Let the targets move.
        """
        layout = LAYOUTS["paper"] if preset is None else preset.layout
        scaling = PAPER_SCALING if preset is None else preset.scaling
        began_s = self._now_s()
        world = paper_world(
            [load_map(map_name)],
            layout,
            scaling,
            episodes=self.count,
            seed=TEST_SEED,
            moving=moving,
        )
        flights, ended = fly(world, policy)
        evaluation = summarise(ended, np.full(self.count, np.inf), seconds=self._now_s() - began_s)
        ways: float | None = None
        if not moving:
            shortest_m = self._shortest(map_name, flights)
            longest_m = np.maximum(shortest_m, ended.path_length_m)
            ways = float(np.mean(ended.reached * shortest_m / np.maximum(longest_m, 1e-9)))
        return Score(evaluation, ways, float(ended.reward_sum.mean())), flights

    def baselines(self) -> list[Baseline]:
        """Return floor and ceiling of every map, for targets that rest and that move."""
        return [
            Baseline(
                map=map_name,
                moving=moving,
                straight=self.fly(fly_straight, map_name, moving=moving)[0],
                planner=self.fly(PlanAndTrack(self._find_ways), map_name, moving=moving)[0],
            )
            for map_name in MAPS
            for moving in (False, True)
        ]

    def _shortest(self, map_name: str, flights: Flights) -> FloatArray:
        if map_name not in self._shortest_m:
            start_m, target_m = flights.position_enu_m[0], flights.target_enu_m[0]
            ways = self._find_ways(load_map(map_name), start_m, target_m)
            self._shortest_m[map_name] = way_lengths_m(ways)
        return self._shortest_m[map_name]


def actor_of(preset: Preset, state: Mapping[str, Any]) -> Policy:
    """Return the actor that was best on validation, from a run's checkpoint."""
    network = ActorNetwork(len(preset.layout.fields), preset.ddpg.hidden, torch.Generator())
    network.load_state_dict(state["trainer"]["best"]["network"])
    return network_policy(network)


def measure_run(
    job: Job, folder: RunFolder, cases: Cases
) -> tuple[RunResult, RunCurves, Flights, Flights | None]:
    """Evaluate a finished run.

    Returns:
        Its numbers, its curves, and the flights to resting and to moving targets; runs of the
        ablations fly to resting ones only.
    """
    state = folder.load_checkpoint()
    record, log = folder.read_record(), read_log(folder.log_path)
    policy = actor_of(job.preset, state)
    static, flights = cases.fly(policy, job.map, job.preset)
    moving, chases = None, None
    if job.group != "ablation":
        moving, chases = cases.fly(policy, job.map, job.preset, moving=True)
    world = job.preset.world
    whole = not world.end_on_contact and world.restart_probability == 0.0
    rewards = reward_curve(log, whole_episodes=whole)
    validation = validation_curve(log)
    result = RunResult(
        name=job.name,
        group=job.group,
        variant=job.variant,
        map=job.map,
        seed=job.seed,
        updates=job.preset.updates,
        preset_digest=job.preset.digest,
        init=job.init,
        git_revision=record.git_revision,
        machine=record.machine,
        source=state["trainer"]["best"]["source"],
        train_s=training_s(log),
        static=static,
        moving=moving,
    )
    curves = RunCurves(
        rewards=thinned(rewards.updates, rewards.value),
        validation=thinned(validation.updates, validation.value),
    )
    return result, curves, flights, chases


def training_s(log: Sequence[Mapping[str, Any]]) -> float | None:
    """Return how long a run took: all its updates at the mean rate of its last process.

    The rate counts from the start of a process, validations included; a run that was never
    interrupted had one.
    """
    rates = [
        (entry["updates"], entry["updates_per_s"]) for entry in log if entry["kind"] == "training"
    ]
    if not rates or rates[-1][1] <= 0.0:
        return None
    updates, per_s = rates[-1]
    return float(updates / per_s)
