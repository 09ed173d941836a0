"""What ``training reproduce`` trains: every stage, seed and ablation, and what starts from what."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

from training.ablations import Ablation
from training.presets import PRESETS, Preset

Group = Literal["free", "obstacles", "coordinates", "ablation"]

RECIPE = "paper"
"""The recipe as it is, among the ablations."""
SCRATCH = "scratch"
"""The recipe as it is, from random networks."""
ACTOR_ONLY = "actor-only"
"""The recipe as it is, from the actor of the free stage and a random critic."""
OBSTACLE_MAPS = ("env1", "env2")
ABLATION_MAP = "env1"
_VALIDATIONS = 10
"""Of each shortened run."""


@dataclass(frozen=True, slots=True)
class Budget:
    """How much is trained and tested."""

    free_updates: int | None = None
    """Of each run of the free stage; the preset's where none is given,"""
    obstacle_updates: int | None = None
    """and of each run among obstacles, likewise."""
    coordinates_updates: int | None = None
    """Of each run from the paper's six coordinates alone, likewise."""
    ablation_updates: int = 5_000
    coordinates_seeds: int = 3
    """How many of the seeds learn from six coordinates,"""
    transfer_seeds: int = 3
    """how many compare transfer with scratch,"""
    ablation_seeds: int = 3
    """and how many train each ablation."""
    cases: int = 1_000


FULL = Budget()
QUICK = Budget(
    free_updates=4_000,
    obstacle_updates=12_000,
    ablation_updates=3_000,
    coordinates_seeds=0,
    transfer_seeds=1,
    ablation_seeds=1,
    cases=500,
)


def _with_beta_04(preset: Preset) -> Preset:
    reward = replace(preset.world.reward, beta=0.4)
    return replace(preset, world=replace(preset.world, reward=reward))


BETA = Ablation("beta-0.4", "half the price of flying through obstacles (E4)", _with_beta_04)
"""The second value of E4, trained as the ablations are."""


@dataclass(frozen=True, slots=True)
class Job:
    """One training run."""

    name: str
    group: Group
    variant: str
    """``paper`` for a recipe as it is, ``scratch``, ``actor-only`` or an ablation's name."""
    preset: Preset
    map: str
    seed: int
    init: str | None
    """Name of the job whose networks it starts from."""

    @property
    def label(self) -> str:
        """Return the name of its folder: another preset is another folder."""
        return f"{self.name}-{self.preset.digest[:6]}"


def plan(
    budget: Budget, seeds: tuple[int, ...], ablations: Mapping[str, Ablation]
) -> tuple[Job, ...]:
    """Return all runs, each after the one it starts from; what matters most comes first.

    Args:
        budget: How much is trained.
        seeds: Training seeds.
        ablations: Changes of the recipe, by name.
    """
    free = shortened(PRESETS["paper", "free"], budget.free_updates)
    obstacles = shortened(PRESETS["paper", "obstacles"], budget.obstacle_updates)
    jobs = [_job("free", RECIPE, free, "free", seed) for seed in seeds]
    jobs += [
        _job("obstacles", RECIPE, obstacles, city, seed, init=f"free-seed{seed}")
        for seed in seeds
        for city in OBSTACLE_MAPS
    ]
    coordinates = shortened(PRESETS["coordinates", "obstacles"], budget.coordinates_updates)
    jobs += [
        _job("coordinates", RECIPE, coordinates, city, seed)
        for seed in seeds[: budget.coordinates_seeds]
        for city in OBSTACLE_MAPS
    ]
    short = shortened(PRESETS["paper", "obstacles"], budget.ablation_updates)
    for seed in seeds[: budget.transfer_seeds]:
        jobs += [
            _job("ablation", variant, short, ABLATION_MAP, seed, init=init)
            for variant, init in (
                (RECIPE, f"free-seed{seed}"),
                (ACTOR_ONLY, f"free-seed{seed}"),
                (SCRATCH, None),
            )
        ]
    changed = [
        _ablation_jobs(name, ablation, budget, free, short, seed)
        for seed in seeds[: budget.ablation_seeds]
        for name, ablation in ablations.items()
    ]
    for ablation_jobs in sorted(changed, key=_updates):  # what takes longest comes last
        jobs += ablation_jobs
    return _without_doubles(jobs)


def shortened(preset: Preset, updates: int | None) -> Preset:
    """Return a preset with another number of updates, validated as often as makes a curve."""
    if updates is None or updates == preset.updates:
        return preset
    return replace(preset, updates=updates, validate_every=max(1, updates // _VALIDATIONS))


def _ablation_jobs(
    name: str, ablation: Ablation, budget: Budget, free: Preset, short: Preset, seed: int
) -> list[Job]:
    """Return an ablation's run, after a free stage of its own where it cannot use the recipe's."""
    changed = ablation.change(short)
    if not ablation.transfer:
        return [_job("ablation", name, changed, ABLATION_MAP, seed)]
    if _meaning(changed) == _meaning(short):
        return [_job("ablation", name, changed, ABLATION_MAP, seed, init=f"free-seed{seed}")]
    own_free = shortened(ablation.change(free), budget.free_updates)
    source = _job("free", name, own_free, "free", seed)
    return [source, _job("ablation", name, changed, ABLATION_MAP, seed, init=source.name)]


def _updates(jobs: list[Job]) -> int:
    return sum(job.preset.updates for job in jobs)


def _without_doubles(jobs: list[Job]) -> tuple[Job, ...]:
    """Return the jobs without free stages that are another one under another name."""
    first: dict[tuple[str, int], str] = {}
    kept: list[Job] = []
    for job in jobs:
        if job.group == "free":
            same = first.setdefault((job.preset.digest, job.seed), job.name)
            if same != job.name:
                continue
        elif job.init is not None and job.init not in {other.name for other in kept}:
            source = next(other for other in jobs if other.name == job.init)
            job = replace(job, init=first[source.preset.digest, source.seed])
        kept.append(job)
    return tuple(kept)


def _meaning(preset: Preset) -> tuple[object, ...]:
    """Return what decides whether the networks of one preset mean the same in another."""
    options = preset.ddpg
    return (
        preset.layout_name,
        preset.scaling,
        preset.world.reward,
        options.hidden,
        options.gamma,
        options.twin_critics,
    )


def _job(
    group: Group, variant: str, preset: Preset, city: str, seed: int, init: str | None = None
) -> Job:
    words = [city] if variant == RECIPE and group != "ablation" else [city, "short", variant]
    if group == "free" and variant != RECIPE:
        words = [city, variant]
    if group == "coordinates":
        words = [city, group]
    return Job("-".join((*words, f"seed{seed}")), group, variant, preset, city, seed, init)
