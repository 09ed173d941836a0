"""What is evaluated is what flies: the actor asked again at every tick of the control loop.

The world is the one of training, stepped at the rate of the loop: a vehicle that lags, climbs and
descends as its autopilot lets it, in gusts, and does not quite know where it is. With a shield,
the same cases are flown through the same two calls that flight makes at every tick: what the
actor wants, then what the shield makes of it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields

import numpy as np

from companion.arrays import BoolArray, Float32Array, FloatArray, IntArray
from companion.guidance.drift import DriftObserver
from companion.guidance.shield import Shield, ShieldLimits
from companion.policy.action import (
    ActionScaling,
    action_to_velocity_mps,
    bearing_to_target_rad,
    polar_to_target_rad,
)
from companion.policy.observation import Layout
from companion.world.maps import Map
from sim.dynamics import Disturbance, VelocityLag, VerticalLimits
from sim.episodes import EpisodeEnd
from sim.guides import Surveyor
from sim.imperfections import RECORDED, Imperfections
from sim.motion import Dynamics
from sim.world import CityWorld
from training.evaluate import ARRIVAL_RADIUS_M, Evaluation, Policy, summarise
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


def evaluate_loop(
    policy: Policy,
    maps: Sequence[Map],
    layout: Layout,
    scaling: ActionScaling,
    *,
    v_max_mps: float,
    episodes: int,
    seed: int,
    purpose: Purpose = Purpose.TEST,
    moving: bool = False,
    shield: bool = False,
    measure_clearance: bool = False,
    conditions: Conditions | None = None,
    surveyor: Surveyor | None = None,
    begin: Callable[[CityWorld], Float32Array] = CityWorld.reset,
    now_s: Callable[[], float],
) -> Evaluation:
    """Fly ``episodes`` cases in the control loop and count.

    Args:
        policy: What flies.
        maps: Where; the cases are spread evenly over several.
        layout: What the policy sees.
        scaling: What its actions mean.
        v_max_mps: Speed of its longest step.
        episodes: How many cases, all flown at once.
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
    began_s = now_s()
    world = _loop_world(
        maps,
        layout,
        scaling,
        episodes,
        generator(seed, purpose),
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
    return summarise(
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


class Guard:
    """One shield for each world, as flight has one; told the estimates that flight would have."""

    def __init__(self, world: CityWorld, v_max_mps: float) -> None:
        limits = ShieldLimits(v_max_mps=v_max_mps, period_s=1.0 / RATE_HZ)
        shields: dict[str, Shield] = {}
        for number in range(world.num_worlds):
            city = world.map_of(number)
            if city.name not in shields:
                shields[city.name] = Shield(city, limits)
        self._shields = [shields[world.map_of(n).name] for n in range(world.num_worlds)]
        self.margin_m = limits.margin_m
        self._observers = [DriftObserver() for _ in self._shields]
        self._sent_enu_mps = np.zeros((world.num_worlds, 3))
        self.interventions = 0

    def take(self, rows: IntArray) -> None:
        """Keep the shields of some worlds."""
        self._shields = [self._shields[row] for row in rows]
        self._observers = [self._observers[row] for row in rows]
        self._sent_enu_mps = self._sent_enu_mps[rows]

    def check(self, world: CityWorld, action: Float32Array | FloatArray) -> FloatArray:
        """Return the velocities to send, ``(N, 3)``."""
        position_m, velocity_mps = world.estimate_enu_m, world.velocity_enu_mps
        wanted_mps = action_to_velocity_mps(
            action,
            world.scaling,
            world.v_max_mps,
            bearing_to_target_rad(position_m, world.aim_enu_m),
            polar_to_target_rad(position_m, world.aim_enu_m),
        )
        sent_mps = np.empty_like(wanted_mps)
        for row, shield in enumerate(self._shields):
            decision = shield.check(
                wanted_mps[row],
                position_enu_m=position_m[row],
                velocity_now_enu_mps=velocity_mps[row],
                drift=self._observers[row].update(
                    velocity_mps[row], self._sent_enu_mps[row], shield.braking, dt_s=world.dt_s
                ),
            )
            sent_mps[row] = decision.velocity_enu_mps
            self.interventions += decision.intervened
        self._sent_enu_mps = sent_mps
        return sent_mps


class _Books:
    """How the cases ended, in their own order whatever the order they end in."""

    def __init__(self) -> None:
        self._closed: list[EpisodeEnd] = []
        self._cases: list[IntArray] = []

    def close(self, cases: IntArray, books: EpisodeEnd, rows: BoolArray) -> None:
        """Enter the cases of some rows."""
        self._cases.append(cases)
        self._closed.append(
            EpisodeEnd(**{f.name: getattr(books, f.name)[rows] for f in fields(EpisodeEnd)})
        )

    @property
    def closed(self) -> EpisodeEnd:
        """Return all cases."""
        order = np.argsort(np.concatenate(self._cases))
        return EpisodeEnd(
            **{
                f.name: np.concatenate([getattr(end, f.name) for end in self._closed])[order]
                for f in fields(EpisodeEnd)
            }
        )
