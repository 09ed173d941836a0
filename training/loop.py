"""What is evaluated is what flies: the actor asked again at every tick of the control loop.

The world is the one of training, stepped at the rate of the loop: a vehicle that lags, climbs and
descends as its autopilot lets it, in gusts, and does not quite know where it is. With a shield,
the same cases are flown through the same two calls that flight makes at every tick: what the
actor wants, then what the shield makes of it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from companion.arrays import BoolArray, Float32Array, FloatArray, IntArray
from companion.policy.action import ActionScaling
from companion.policy.observation import Layout
from companion.world.maps import Map
from sim.dynamics import Disturbance, VelocityLag, VerticalLimits
from sim.episodes import EpisodeEnd
from sim.guides import Surveyor
from sim.imperfections import RECORDED, Imperfections
from sim.motion import Dynamics
from sim.world import CityWorld
from training.evaluate import ARRIVAL_RADIUS_M, Evaluation, Policy, summarise
from training.guard import Guard
from training.parts import Part, parts_of
from training.reach import out_of_reach
from training.seeds import Purpose, generator

RATE_HZ = 20.0
PATIENCE_EDGES = 6.0
"""A case times out after the time to fly so many edges at full speed: 120 s on 100 m at 5 m/s."""
LINGER_S = 5.0
"""How long a vehicle that has arrived may come nearer, for the rates at 2 and 1 m."""
_SHRINK = 0.75
"""Worlds whose case is over are dropped when no more than this share is under way."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """What the vehicle and the air are like."""

    dynamics: Dynamics = field(
        default_factory=lambda: Dynamics(
            lag=VelocityLag(),
            time_constant_s=(0.3, 0.8),
            vertical=VerticalLimits(),
            wind=Disturbance(std=0.5, correlation_s=2.0),
            position_noise=Disturbance(std=0.3, correlation_s=2.0),
        )
    )
    """Time constants around what was measured on ArduCopter and PX4, up to what the shield
    reckons with."""
    start_margin_m: float = 2.0
    """Preflight refuses a take-off nearer to an obstacle than the shield's margin."""
    imperfections: Imperfections | None = RECORDED
    """Of vehicles and links; by default what recordings show, ``None`` for none."""


@dataclass(frozen=True, slots=True)
class LoopFlights:
    """How cases went, in their order."""

    ended: EpisodeEnd
    clearance_m: FloatArray
    """Smallest distance to an obstacle until arrival, ``(N,)``; infinite where not measured."""
    interventions: int
    """Of the shield."""
    out_of_reach: int | None
    """As in ``Evaluation``."""
    seconds: float

    @classmethod
    def joined(cls, parts: Sequence["LoopFlights"]) -> "LoopFlights":
        """Return the flights of all parts, which are given in their order."""
        beyond = [part.out_of_reach for part in parts if part.out_of_reach is not None]
        return cls(
            EpisodeEnd.joined([part.ended for part in parts]),
            np.concatenate([part.clearance_m for part in parts]),
            sum(part.interventions for part in parts),
            sum(beyond) if len(beyond) == len(parts) else None,
            sum(part.seconds for part in parts),
        )

    def evaluation(self) -> Evaluation:
        """Return what came of them."""
        return summarise(
            self.ended,
            self.clearance_m,
            interventions=self.interventions,
            out_of_reach=self.out_of_reach,
            seconds=self.seconds,
        )


def evaluate_loop(
    policy: Policy,
    maps: Sequence[Map],
    layout: Layout,
    scaling: ActionScaling,
    *,
    episodes: int,
    **options: Any,
) -> Evaluation:
    """Fly ``episodes`` cases in the control loop, part by part, and count.

    Args:
        policy: What flies.
        maps: Where; the cases are spread evenly over several.
        layout: What the policy sees.
        scaling: What its actions mean.
        episodes: How many cases.
        options: As for ``fly_part``.
    """
    parts = parts_of(maps, episodes)
    flown = [fly_part(policy, part, layout, scaling, **options) for part in parts]
    return LoopFlights.joined(flown).evaluation()


def fly_part(
    policy: Policy,
    part: Part,
    layout: Layout,
    scaling: ActionScaling,
    *,
    v_max_mps: float,
    seed: int,
    purpose: Purpose = Purpose.TEST,
    moving: bool = False,
    shield: bool = False,
    measure_clearance: bool = False,
    conditions: Conditions | None = None,
    surveyor: Surveyor | None = None,
    begin: Callable[[CityWorld], Float32Array] = CityWorld.reset,
    now_s: Callable[[], float],
) -> LoopFlights:
    """Fly a part of the cases at once in the control loop.

    Args:
        policy: What flies.
        part: Which of the cases.
        layout: What the policy sees.
        scaling: What its actions mean.
        v_max_mps: Speed of its longest step.
        seed: Chooses the cases, together with ``purpose``; a shield changes none of them.
        purpose: ``TEST`` cases are disjoint from those of training and validation.
        moving: Let the targets move.
        shield: Put the shield behind the policy.
        measure_clearance: Measure the distance to obstacles along the way; slower.
        conditions: The vehicle and the air.
        surveyor: Remembers the ways, where the same cases are flown again.
        begin: Starts the cases and returns what is seen first; by default at random places.
        now_s: Clock for ``seconds``.
    """
    began_s, episodes = now_s(), part.episodes
    world = _loop_world(
        part.maps,
        layout,
        scaling,
        episodes,
        generator(seed, purpose, part.number),
        v_max_mps,
        moving,
        conditions or Conditions(),
        surveyor,
    )
    guard = Guard(world, v_max_mps) if shield else None
    books = _Books()
    case: IntArray = np.arange(episodes)
    """Of each world that is still stepped."""
    clearance_m = np.full(episodes, np.inf)
    linger = np.full(episodes, round(LINGER_S * RATE_HZ))
    over: BoolArray = np.zeros(episodes, dtype=np.bool_)
    observation = begin(world)
    beyond = None
    if guard is not None and not moving:
        beyond = out_of_reach(world, margin_m=guard.margin_m, radius_m=ARRIVAL_RADIUS_M)
    for _ in range(world.horizon - 1):
        action = policy(world, observation)
        result = world.step(action) if guard is None else world.follow(guard.check(world, action))
        observation = result.observation
        if measure_clearance:
            # On the way, up to and with the arrival or the first contact.
            distance_m = np.where(over, np.inf, world.clearance_m())
            clearance_m[case] = np.minimum(clearance_m[case], distance_m)
        contact: BoolArray = world.books().contact
        over = result.reached | contact
        linger[case] -= result.reached
        running = ~contact & (linger[case] > 0)
        if running.mean() > _SHRINK:
            continue
        books.close(case[~running], world.books(), ~running)
        if not running.any():
            case = case[running]
            break
        rows = np.flatnonzero(running)
        world, case = world.take(rows), case[rows]
        observation, over = observation[rows], over[rows]
        if guard is not None:
            guard.take(rows)
    if len(case) > 0:
        books.close(case, world.books(), np.ones(len(case), dtype=np.bool_))
    return LoopFlights(
        books.closed,
        clearance_m,
        interventions=0 if guard is None else guard.interventions,
        out_of_reach=None if beyond is None else int(beyond.sum()),
        seconds=now_s() - began_s,
    )


def _loop_world(
    maps: Sequence[Map],
    layout: Layout,
    scaling: ActionScaling,
    episodes: int,
    rng: np.random.Generator,
    v_max_mps: float,
    moving: bool,
    conditions: Conditions,
    surveyor: Surveyor | None,
) -> CityWorld:
    patience_s = PATIENCE_EDGES * maps[0].edge_m / v_max_mps
    return CityWorld(
        maps,
        layout,
        scaling,
        episodes,
        rng,
        # One more than is flown: the worlds never restart by themselves.
        horizon=round(patience_s * RATE_HZ) + 1,
        arrival_radius_m=ARRIVAL_RADIUS_M,
        target_motion="moving" if moving else "static",
        start_margin_m=conditions.start_margin_m,
        v_max_mps=v_max_mps,
        step_s=1.0 / RATE_HZ,
        dynamics=conditions.dynamics,
        imperfections=conditions.imperfections,
        surveyor=surveyor,
    )


class _Books:
    """How the cases ended, in their own order whatever the order they end in."""

    def __init__(self) -> None:
        self._closed: list[EpisodeEnd] = []
        self._cases: list[IntArray] = []

    def close(self, cases: IntArray, books: EpisodeEnd, rows: BoolArray) -> None:
        """Enter the cases of some rows."""
        self._cases.append(cases)
        self._closed.append(books.take(np.flatnonzero(rows)))

    @property
    def closed(self) -> EpisodeEnd:
        """Return all cases."""
        return EpisodeEnd.joined(self._closed).take(np.argsort(np.concatenate(self._cases)))
