"""How well a policy does on cases it has never seen, by the paper's kinematic step.

What flies a vehicle with a speed is judged in the control loop instead: ``training.loop``.

Success is what the paper leaves open (E9, E10): within 5 m of the target, with no contact on the
way, within T steps. Every case is one episode from its first step to its last; none is
replaced by a quicker one, so slow failures weigh as much as fast arrivals.
"""

from collections.abc import Callable, Sequence

import msgspec
import numpy as np

from companion.arrays import BoolArray, Float32Array, FloatArray, IntArray
from companion.policy.action import (
    ActionScaling,
    bearing_to_target_rad,
    displacement_to_action,
    polar_to_target_rad,
)
from companion.policy.observation import Layout
from companion.world.maps import Map
from sim.episodes import EpisodeEnd
from sim.world import CityWorld
from training.seeds import Purpose, generator

HORIZON = 100
"""T of Table I."""
ARRIVAL_RADIUS_M = 5.0
CLEARANCE_PERCENTILES = (1, 5, 25, 50)
_CLEARANCE_SAMPLES = 8
"""Points on each step at which the clearance is measured: 2.5 m apart at the longest step."""
_Z_95 = 1.959963984540054

Policy = Callable[[CityWorld, Float32Array], Float32Array | FloatArray]
"""From the worlds and their observation ``(N, n)`` to actions ``(N, 3)``."""


class Evaluation(msgspec.Struct, frozen=True):
    """What came of ``episodes`` cases. Rates are shares of all of them."""

    episodes: int
    completion_rate: float
    """Within 5 m without contact."""
    completion_rate_ci95: tuple[float, float]
    """Wilson's interval."""
    completion_5m: float
    completion_2m: float
    completion_1m: float
    collision_rate: float
    """Contact before arrival."""
    timeout_rate: float
    """Neither contact nor arrival within T steps."""
    spl: float
    """Success weighted by path length: mean of success * straight / max(straight, flown)."""
    path_stretch: float | None
    """Mean of flown / straight over the successes; ``None`` without one."""
    min_clearance_m: dict[str, float] | None
    """Percentiles over episodes of the smallest distance to an obstacle until arrival; negative
    inside one. ``None`` on a map without obstacles, or where it was not measured."""
    shield_interventions: int
    seconds: float
    """What it took, in all processes together."""
    out_of_reach: int | None = None
    """Cases that nothing could complete, as there is no way that keeps the shield's margin
    (``training.reach``): failures like the others. ``None`` without a shield."""


def fly_straight(world: CityWorld, observation: Float32Array) -> FloatArray:
    """Fly straight at the target: the floor that says how hard the cases are."""
    position_enu_m, target_enu_m = world.estimate_enu_m, world.known_target_enu_m
    return displacement_to_action(
        target_enu_m - position_enu_m,
        world.scaling,
        world.edge_m,
        bearing_to_target_rad(position_enu_m, world.aim_enu_m),
        polar_to_target_rad(position_enu_m, world.aim_enu_m),
    )


def evaluate_policy(
    policy: Policy,
    maps: Sequence[Map],
    layout: Layout,
    scaling: ActionScaling,
    *,
    episodes: int,
    seed: int,
    purpose: Purpose = Purpose.TEST,
    moving: bool = False,
    measure_clearance: bool = False,
    now_s: Callable[[], float],
) -> Evaluation:
    """Fly ``episodes`` cases in the paper's kinematic world and count.

    Args:
        policy: What flies.
        maps: Where; the cases are spread evenly over several.
        layout: What the policy sees.
        scaling: What its actions mean.
        episodes: How many cases, all flown at once.
        seed: Chooses the cases, together with ``purpose``.
        purpose: ``TEST`` cases are disjoint from those of training and validation.
        moving: Let the targets move.
        measure_clearance: Measure the distance to obstacles along the way; slower.
        now_s: Clock for ``seconds``.
    """
    began_s = now_s()
    world = paper_world(
        maps, layout, scaling, episodes=episodes, seed=seed, purpose=purpose, moving=moving
    )
    observation = world.reset()
    places = maps_with_worlds(world) if measure_clearance else ()
    clearance_m = np.full(episodes, np.inf)
    under_way: BoolArray = np.ones(episodes, dtype=np.bool_)
    for _ in range(HORIZON):
        start_enu_m = world.position_enu_m
        result = world.step(policy(world, observation))
        observation = result.observation
        if measure_clearance:
            for city, worlds in places:
                rows = worlds[under_way[worlds]]
                step_m = _clearance_m(city, start_enu_m[rows], result.position_enu_m[rows])
                clearance_m[rows] = np.minimum(clearance_m[rows], step_m)
            under_way &= ~(result.reached | result.contact)
    return summarise(result.episode_end, clearance_m, seconds=now_s() - began_s)


def paper_world(
    maps: Sequence[Map],
    layout: Layout,
    scaling: ActionScaling,
    *,
    episodes: int,
    seed: int,
    purpose: Purpose = Purpose.TEST,
    moving: bool = False,
) -> CityWorld:
    """Return the paper's kinematic world with one case in each of ``episodes`` worlds.

    The cases begin with its next ``reset``, the same ones for the same seed and purpose,
    whatever the layout.
    """
    return CityWorld(
        maps,
        layout,
        scaling,
        episodes,
        generator(seed, purpose),
        horizon=HORIZON,
        arrival_radius_m=ARRIVAL_RADIUS_M,
        target_motion="moving" if moving else "static",
    )


def completion_of(ended: EpisodeEnd, radius_m: float) -> float:
    """Return the share of cases that came within ``radius_m`` before any contact."""
    return float(np.mean(ended.min_distance_m < radius_m))


def wilson_interval(rate: float, count: int) -> tuple[float, float]:
    """Return the 95 % Wilson score interval of a rate observed over ``count`` cases."""
    z2 = _Z_95**2
    centre = (rate + z2 / (2 * count)) / (1 + z2 / count)
    half = _Z_95 * np.sqrt(rate * (1 - rate) / count + z2 / (4 * count**2)) / (1 + z2 / count)
    return max(0.0, float(centre - half)), min(1.0, float(centre + half))


def maps_with_worlds(world: CityWorld) -> list[tuple[Map, IntArray]]:
    """Return every map with the worlds that lie on it."""
    worlds: dict[str, list[int]] = {}
    maps: dict[str, Map] = {}
    for index in range(world.num_worlds):
        city = world.map_of(index)
        maps[city.name] = city
        worlds.setdefault(city.name, []).append(index)
    return [(maps[name], np.array(rows)) for name, rows in worlds.items()]


def _clearance_m(city: Map, start_enu_m: FloatArray, end_enu_m: FloatArray) -> FloatArray:
    """Return the smallest signed distance along each step, shape ``(N,)``."""
    share = np.linspace(0.0, 1.0, _CLEARANCE_SAMPLES + 1)[1:, None, None]
    points_enu_m = start_enu_m + share * (end_enu_m - start_enu_m)
    distance_m: FloatArray = city.obstacles.signed_distance_m(points_enu_m).min(axis=0)
    return distance_m


def summarise(
    ended: EpisodeEnd,
    clearance_m: FloatArray,
    *,
    interventions: int = 0,
    out_of_reach: int | None = None,
    seconds: float,
) -> Evaluation:
    """Return what came of cases.

    Args:
        ended: Every case once.
        clearance_m: Smallest distance to an obstacle until arrival, ``(N,)``; infinite where it
            was not measured.
        interventions: Of the shield.
        out_of_reach: Cases that a vehicle with the shield could not complete.
        seconds: What it took.
    """
    episodes = len(ended.reached)
    reached = ended.reached
    rate = float(reached.mean())
    straight_m = ended.straight_m
    shortest = straight_m / np.maximum(np.maximum(straight_m, ended.path_length_m), 1e-9)
    stretch = ended.path_length_m[reached] / np.maximum(straight_m[reached], 1e-9)
    percentiles: dict[str, float] | None = None
    if np.isfinite(clearance_m).all():
        values = np.percentile(clearance_m, CLEARANCE_PERCENTILES)
        percentiles = {
            f"p{p}": float(v) for p, v in zip(CLEARANCE_PERCENTILES, values, strict=True)
        }
    return Evaluation(
        episodes=episodes,
        completion_rate=rate,
        completion_rate_ci95=wilson_interval(rate, episodes),
        completion_5m=completion_of(ended, 5.0),
        completion_2m=completion_of(ended, 2.0),
        completion_1m=completion_of(ended, 1.0),
        collision_rate=float(ended.contact_first.mean()),
        timeout_rate=float((~reached & ~ended.contact_first).mean()),
        spl=float(np.mean(reached * shortest)),
        path_stretch=float(stretch.mean()) if reached.any() else None,
        min_clearance_m=percentiles,
        shield_interventions=interventions,
        seconds=seconds,
        out_of_reach=out_of_reach,
    )
