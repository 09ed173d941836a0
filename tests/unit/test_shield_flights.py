"""Adversarial policies fly a lagging vehicle behind the shield: nothing is ever touched."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from companion.arrays import FloatArray
from companion.guidance.guidance import straight_at_target_mps
from companion.guidance.shield import Shield, ShieldLimits, ShieldReason
from companion.world.maps import Map, build_map, load_map
from sim.dynamics import Disturbance, VelocityLag, follow_velocity

PERIOD_S = 0.05
Policy = Callable[[FloatArray, np.random.Generator], FloatArray]


@dataclass
class Flight:
    contacts: int = 0
    least_clearance_m: float = np.inf
    arrived: bool = False
    moved_m: float = 0.0
    outside_m: float = 0.0
    last_reason: ShieldReason = ShieldReason.CLEAR
    blocked_ticks: int = 0
    """In a row, at the end."""


@dataclass
class Setting:
    """What the vehicle is really like; the shield is told ``limits``."""

    lag: VelocityLag
    limits: ShieldLimits
    delay_ticks: int = 1
    noise_m: Disturbance | None = None
    gusts_mps: Disturbance | None = None


def fly(
    city: Map,
    setting: Setting,
    policy: Policy,
    start_enu_m: FloatArray,
    rng: np.random.Generator,
    *,
    duration_s: float,
    target_enu_m: FloatArray | None = None,
) -> Flight:
    shield, flight = Shield(city, setting.limits), Flight()
    position, velocity = start_enu_m.copy(), np.zeros(3)
    gust, error = np.zeros(3), np.zeros(3)
    on_the_way = [np.zeros(3)] * setting.delay_ticks
    for _ in range(round(duration_s / PERIOD_S)):
        if setting.noise_m:
            error = setting.noise_m.advance(error, dt_s=PERIOD_S, rng=rng)
        if setting.gusts_mps:
            gust = setting.gusts_mps.advance(gust, dt_s=PERIOD_S, rng=rng)
            gust = gust * min(1.0, 3.0 / max(float(np.linalg.norm(gust)), 1e-9))
        seen = position + error
        decision = shield.check(
            policy(seen, rng), position_enu_m=seen, velocity_now_enu_mps=velocity + gust
        )
        assert np.isfinite(decision.velocity_enu_mps).all()
        assert np.linalg.norm(decision.velocity_enu_mps) <= setting.limits.v_max_mps + 1e-9
        flight.last_reason = decision.reason
        blocked = decision.reason is ShieldReason.BLOCKED
        flight.blocked_ticks = flight.blocked_ticks + 1 if blocked else 0
        on_the_way.append(decision.velocity_enu_mps)
        velocity, moved = follow_velocity(velocity, on_the_way.pop(0), setting.lag, dt_s=PERIOD_S)
        moved = moved + gust * PERIOD_S
        flight.contacts += bool(city.obstacles.crash_depth_m(position, position + moved) > 0.0)
        position = position + moved
        flight.moved_m += float(np.linalg.norm(moved))
        clearance_m = min(float(city.obstacles.signed_distance_m(position)), position[2])
        flight.least_clearance_m = min(flight.least_clearance_m, clearance_m)
        beyond_m = max(float((-position).max()), float((position - city.size_m).max()))
        flight.outside_m = max(flight.outside_m, beyond_m)
        if target_enu_m is not None and np.linalg.norm(position - target_enu_m) < 5.0:
            flight.arrived = True
            break
        if target_enu_m is not None and flight.blocked_ticks * PERIOD_S > 4.0:
            break
    return flight


# -- cities -------------------------------------------------------------------------------------

U_BLOCK = np.array([[0, 0], [30, 0], [30, 25], [22, 25], [22, 8], [8, 8], [8, 25], [0, 25]], float)
L_BLOCK = np.array([[0, 0], [25, 0], [25, 9], [9, 9], [9, 30], [0, 30]], float)


def turned(outline: FloatArray, angle_rad: float, center_m: FloatArray) -> FloatArray:
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    middle = 0.5 * (outline.min(axis=0) + outline.max(axis=0))
    return (outline - middle) @ np.array([[cosine, sine], [-sine, cosine]]) + center_m


def concave_city(rng: np.random.Generator) -> Map:
    """A U, an L and a triangle, turned at random; they may overlap."""
    outlines = [
        turned(shape, rng.uniform(0, 2 * np.pi), rng.uniform(25, 75, 2))
        for shape in (U_BLOCK, L_BLOCK, np.array([[0, 0], [24, 0], [20, 5]], float))
    ]
    return build_map("concave", (100, 100, 60), outlines, list(rng.uniform(10, 60, 3)))


def street_city(rng: np.random.Generator, narrowest_m: float = 3.0) -> Map:
    """Blocks on a grid, streets up to 8 m wide: narrower and wider than twice the margin."""
    width_m = rng.uniform(narrowest_m, 8.0)
    corners = np.arange(2.0, 80.0, 20.0)
    side_m = 20.0 - width_m
    outlines = [
        np.array([[x, y], [x + side_m, y], [x + side_m, y + side_m], [x, y + side_m]])
        for x in corners
        for y in corners
    ]
    return build_map("streets", (100, 100, 60), outlines, list(rng.uniform(15, 50, len(outlines))))


def convex_city(rng: np.random.Generator, num_blocks: int | None = None) -> Map:
    """Round-ish convex blocks, at least 7 m between them."""
    outlines: list[FloatArray] = []
    places: list[tuple[FloatArray, float]] = []
    while len(outlines) < (num_blocks or 6):
        center, radius = rng.uniform(15, 85, 2), rng.uniform(4, 9)
        angle = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(4, 8)))
        widest = np.diff(np.append(angle, angle[0] + 2 * np.pi)).max()
        apart = all(np.linalg.norm(center - c) > radius + r + 7.0 for c, r in places)
        if apart and widest < 2.4:
            places.append((center, radius))
            outlines.append(center + radius * np.stack((np.cos(angle), np.sin(angle)), -1))
    return build_map("convex", (100, 100, 100), outlines, list(rng.uniform(15, 90, len(outlines))))


CITIES = [concave_city, street_city, convex_city]


def free_place(city: Map, rng: np.random.Generator, margin_m: float) -> FloatArray:
    while True:
        place = rng.uniform(0, 1, 3) * (city.size_m - 2 * margin_m) + margin_m
        if city.is_free(place, margin_m):
            return place


# -- policies -----------------------------------------------------------------------------------


def random_policy(city: Map, rng: np.random.Generator) -> Policy:
    return lambda _, rng: rng.normal(size=3) * 5.0


def constant_policy(city: Map, rng: np.random.Generator) -> Policy:
    velocity = rng.normal(size=3) * [5.0, 5.0, 1.0]
    return lambda *_: velocity


def wall_policy(city: Map, rng: np.random.Generator) -> Policy:
    return lambda seen, _: 50.0 * (city.obstacles.nearest_surface(seen) - seen)


def flip_flop_policy(city: Map, rng: np.random.Generator) -> Policy:
    sign = np.ones(1)

    def policy(seen: FloatArray, rng: np.random.Generator) -> FloatArray:
        if rng.random() < 0.05:
            sign[0] = -sign[0]
        toward = city.obstacles.nearest_surface(seen) - seen
        return sign[0] * 5.0 * (toward + np.array([toward[1], -toward[0], 0.0]))

    return policy


def broken_policy(city: Map, rng: np.random.Generator) -> Policy:
    bad = [np.full(3, np.nan), np.array([np.inf, 0, 0]), np.zeros(2), np.array([1e300, 1e300, 0])]

    def policy(seen: FloatArray, rng: np.random.Generator) -> FloatArray:
        if rng.random() < 0.3:
            return bad[rng.integers(len(bad))]
        return 9.0 * (city.obstacles.nearest_surface(seen) - seen)

    return policy


def buried_target_policy(city: Map, rng: np.random.Generator) -> Policy:
    inside = city.footprints_m[0].mean(axis=0)
    target = np.array([*inside, rng.uniform(0, 10)])
    return lambda seen, _: straight_at_target_mps(seen, target, 5.0)


POLICIES = [
    random_policy,
    constant_policy,
    wall_policy,
    flip_flop_policy,
    broken_policy,
    buried_target_policy,
]


def adversarial_flight(
    seed: int, *, disturbed: bool, duration_s: float
) -> tuple[Flight, ShieldLimits]:
    rng = np.random.default_rng(seed)
    city = CITIES[seed % len(CITIES)](rng)
    if disturbed and city.name == "streets":
        city = street_city(rng, narrowest_m=5.0)
    policy = POLICIES[seed // len(CITIES) % len(POLICIES)](city, rng)
    told_lag_s, told_brake_mps2 = rng.uniform(0.3, 1.0), rng.uniform(1.2, 2.5)
    limits = ShieldLimits(
        v_max_mps=rng.uniform(3.0, 8.0), lag_s=told_lag_s, brake_mps2=told_brake_mps2
    )
    setting = Setting(
        VelocityLag(rng.uniform(0.3, 1.0) * told_lag_s, told_brake_mps2 * rng.uniform(1.0, 3.0)),
        limits,
        delay_ticks=int(rng.integers(0, 3)),
        noise_m=Disturbance(0.3, rng.choice([0.01, 2.0])) if disturbed else None,
        gusts_mps=Disturbance(0.5, 2.0) if disturbed else None,
    )
    start_margin_m = 1.0 if city.name == "streets" else 2.0
    start = free_place(city, rng, start_margin_m)
    start[2] = min(start[2], 15.0)
    while not city.is_free(start, start_margin_m):
        start = free_place(city, rng, start_margin_m)
    return fly(city, setting, policy, start, rng, duration_s=duration_s), limits


@pytest.mark.parametrize("seed", range(36))
@pytest.mark.parametrize("disturbed", [False, True], ids=["calm", "noise-and-gusts"])
def test_no_policy_makes_it_touch_anything(seed, disturbed):
    flight, limits = adversarial_flight(seed, disturbed=disturbed, duration_s=5.0)
    assert flight.contacts == 0
    assert flight.outside_m <= 0.0
    if not disturbed:
        # A start in a narrow street is 1 m from its walls; nothing is ever worse than that.
        assert flight.least_clearance_m >= min(1.0, limits.margin_m) - 0.1


@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("block", range(100))
def test_ten_thousand_flights_touch_nothing(block):
    for seed in range(1000 + 100 * block, 1100 + 100 * block):
        flight, _ = adversarial_flight(seed, disturbed=bool(seed % 2), duration_s=12.0)
        assert flight.contacts == 0, f"seed {seed}"
        assert flight.outside_m <= 0.0, f"seed {seed}"


def straight_flight(city: Map, rng: np.random.Generator) -> tuple[Flight, bool]:
    """Return the flight of a policy that only knows straight ahead, and if anything was there."""
    start, target = free_place(city, rng, 2.5), free_place(city, rng, 2.5)
    setting = Setting(VelocityLag(0.5, 1.8), ShieldLimits(v_max_mps=5.0))
    flight = fly(
        city,
        setting,
        lambda seen, _: straight_at_target_mps(seen, target, 5.0),
        start,
        rng,
        duration_s=100.0,
        target_enu_m=target,
    )
    return flight, bool(city.obstacles.crash_depth_m(start, target) > 0.0)


def test_straight_at_the_target_slides_round_most_convex_blocks():
    rng = np.random.default_rng(5)
    results = []
    while len(results) < 12:
        flight, in_the_way = straight_flight(convex_city(rng), rng)
        assert flight.contacts == 0
        if in_the_way:
            results.append(flight)
        else:
            assert flight.arrived
    assert sum(flight.arrived for flight in results) >= 7
    stuck = [flight for flight in results if not flight.arrived]
    assert all(flight.last_reason is ShieldReason.BLOCKED for flight in stuck)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", ["env1", "env2"])
def test_straight_at_the_target_on_the_papers_maps(name):
    city, rng = load_map(name), np.random.default_rng(6)
    flights = [straight_flight(city, rng)[0] for _ in range(300)]
    assert not any(flight.contacts for flight in flights)
    assert np.mean([flight.arrived for flight in flights]) >= 0.75
