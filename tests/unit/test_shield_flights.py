"""Adversarial policies fly a lagging vehicle in wind behind the shield: nothing is ever touched.

What the shield is not told is as bad as it gets: every fifth message lost in either direction, a
position that is wrong by 0.3 m on each axis and a velocity by 0.1 m/s, commands that take up to
two ticks to arrive, ticks that come late, air that moves at 3 m/s and turns round from one moment
to the next, as at the corner of a street. What it is told of the vehicle is true: the vehicle
lags by the given time, or less, and brakes as given, or better, with a quarter of it to spare
against the air. The drift is what the shield's own observer makes of what is told, as in flight.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from companion.arrays import FloatArray
from companion.guidance.drift import CALM, DriftObserver
from companion.guidance.guidance import straight_at_target_mps
from companion.guidance.limits import POSITION_STALE_SOFT_S
from companion.guidance.shield import Shield, ShieldReason
from companion.guidance.shield_limits import ShieldLimits
from companion.world.maps import Map, build_map, load_map
from sim.dynamics import Disturbance, VelocityLag, follow_velocity

PERIOD_S = 0.05
AIR_MPS = 3.0
MOST_PUSH = 0.75
"""Of what the vehicle can accelerate by: so much of it at most goes into leaning on the air."""
Policy = Callable[[FloatArray, np.random.Generator], FloatArray]


@dataclass
class Setting:
    """What the vehicle and the air are really like; the shield is told ``limits``."""

    lag: VelocityLag
    limits: ShieldLimits
    delay_ticks: int = 1
    lost: float = 0.0
    """Share of messages, in either direction."""
    late: float = 0.0
    """Share of ticks that come up to 0.15 s late."""
    noise_m: Disturbance | None = None
    velocity_noise_mps: float = 0.0
    gusts_mps: Disturbance | None = None
    """Velocity over ground that comes and goes beside what the autopilot controls."""
    air_mps: float = 0.0
    """The air moves so fast, half so fast or not at all, in directions that change at once."""
    drag_per_s: float = 0.0
    """Acceleration by every m/s of air; nothing in the autopilot leans against it."""
    air_turns_s: float = 1.0


@dataclass
class Flight:
    reasons: list[ShieldReason]
    arrived: bool
    contacts: int
    least_clearance_m: float
    """From obstacles and ground."""
    outside_m: float
    """How far it got out of the box; negative within."""


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
    shield, reasons, path, arrived = Shield(city, setting.limits), [], [start_enu_m], False
    observer, drift, sent = DriftObserver(), CALM, np.zeros(3)
    position, velocity, held = start_enu_m, np.zeros(3), np.zeros(3)
    error, gust, air = np.zeros(3), np.zeros(3), wind_at_random(setting, rng)
    told, age_s = (position, velocity), 0.0
    on_the_way: list[FloatArray | None] = [np.zeros(3)] * setting.delay_ticks
    for chance in rng.random((round(duration_s / PERIOD_S), 5)):
        if setting.noise_m:
            error = setting.noise_m.advance(error, dt_s=PERIOD_S, rng=rng)
        if setting.gusts_mps:
            gust = setting.gusts_mps.advance(gust, dt_s=PERIOD_S, rng=rng)
            gust = gust * min(1.0, 3.0 / max(float(np.sqrt(gust @ gust)), 1e-9))
        if chance[0] * setting.air_turns_s < PERIOD_S:
            air = wind_at_random(setting, rng)
        if chance[1] >= setting.lost:
            wrong_mps = setting.velocity_noise_mps * rng.standard_normal(3)
            told = (position + error, velocity + gust + wrong_mps)
            drift, age_s = observer.update(told[1], sent, shield.braking, dt_s=age_s), 0.0
        decision = shield.check(
            policy(told[0], rng),
            position_enu_m=told[0],
            velocity_now_enu_mps=told[1],
            drift=drift,
        )
        sent = decision.velocity_enu_mps
        assert np.sqrt(sent @ sent) <= setting.limits.v_max_mps + 1e-9  # a nan is not, either
        reasons.append(decision.reason)
        if age_s > POSITION_STALE_SOFT_S:
            sent = np.zeros(3)  # as the supervisor has it
        on_the_way.append(sent if chance[2] >= setting.lost else None)
        arriving = on_the_way.pop(0)
        held = held if arriving is None else arriving

        tick_s = PERIOD_S + (0.15 * chance[4] if chance[3] < setting.late else 0.0)
        velocity, moved = follow_velocity(velocity, held, setting.lag, dt_s=tick_s)
        velocity = velocity + (air - velocity) * (setting.drag_per_s * tick_s)
        position = position + moved + gust * tick_s
        path.append(position)
        age_s += tick_s
        if target_enu_m is not None:
            arrived = bool(np.linalg.norm(position - target_enu_m) < 5.0)
            stuck = len(reasons) > 80 and set(reasons[-80:]) == {ShieldReason.BLOCKED}
            if arrived or stuck:
                break
    flown = np.array(path)
    clearance_m = city.obstacles.signed_distance_m(flown)
    return Flight(
        reasons=reasons,
        arrived=arrived,
        contacts=int((city.obstacles.crash_depth_m(flown[:-1], flown[1:]) > 0.0).sum()),
        least_clearance_m=float(np.minimum(clearance_m, flown[:, 2]).min()),
        outside_m=float(max((-flown).max(), (flown - city.size_m).max())),
    )


def wind_at_random(setting: Setting, rng: np.random.Generator) -> FloatArray:
    air = rng.normal(size=3) * [1.0, 1.0, 0.4]
    return setting.air_mps * rng.choice([0.0, 0.5, 1.0]) * air / np.linalg.norm(air)


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


def street_city(rng: np.random.Generator) -> Map:
    """Blocks on a grid, streets up to 8 m wide: narrower and wider than twice the margin."""
    width_m = rng.uniform(3.0, 8.0)
    corners = np.arange(2.0, 80.0, 20.0)
    side_m = 20.0 - width_m
    outlines = [
        np.array([[x, y], [x + side_m, y], [x + side_m, y + side_m], [x, y + side_m]])
        for x in corners
        for y in corners
    ]
    return build_map("streets", (100, 100, 60), outlines, list(rng.uniform(15, 50, len(outlines))))


def thin_city(rng: np.random.Generator) -> Map:
    """Walls hardly thicker than a hand, to be gone through within one tick."""
    outlines = [
        turned(
            np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * [rng.uniform(15, 35), rng.uniform(0.2, 1)],
            rng.uniform(0, np.pi),
            rng.uniform(25, 75, 2),
        )
        for _ in range(6)
    ]
    return build_map("thin", (100, 100, 60), outlines, list(rng.uniform(10, 55, 6)))


def convex_city(rng: np.random.Generator) -> Map:
    """Round-ish convex blocks, at least 7 m between them."""
    outlines: list[FloatArray] = []
    places: list[tuple[FloatArray, float]] = []
    while len(outlines) < 6:
        center, radius = rng.uniform(15, 85, 2), rng.uniform(4, 9)
        angle = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(4, 8)))
        widest = np.diff(np.append(angle, angle[0] + 2 * np.pi)).max()
        apart = all(np.linalg.norm(center - c) > radius + r + 7.0 for c, r in places)
        if apart and widest < 2.4:
            places.append((center, radius))
            outlines.append(center + radius * np.stack((np.cos(angle), np.sin(angle)), -1))
    return build_map("convex", (100, 100, 100), outlines, list(rng.uniform(15, 90, len(outlines))))


CITIES = [concave_city, street_city, convex_city, thin_city]


def free_place(city: Map, rng: np.random.Generator, margin_m: float) -> FloatArray:
    while True:
        place = rng.uniform(0, 1, 3) * (city.size_m - 2 * margin_m) + margin_m
        if city.is_free(place, margin_m):
            return place


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
    return lambda seen, _: straight_at_target_mps(seen, target, 8.0)


def moving_target_policy(city: Map, rng: np.random.Generator) -> Policy:
    """A target that goes from inside one obstacle to inside another and back."""
    ends = [city.footprints_m[k].mean(axis=0) for k in rng.integers(len(city.footprints_m), size=2)]
    height_m, turns_per_tick = rng.uniform(0, 30), PERIOD_S * rng.uniform(0.02, 0.2)
    tick = [0]

    def policy(seen: FloatArray, _: np.random.Generator) -> FloatArray:
        tick[0] += 1
        share = 0.5 - 0.5 * np.cos(2 * np.pi * turns_per_tick * tick[0])
        target = np.array([*(ends[0] + share * (ends[1] - ends[0])), height_m])
        return straight_at_target_mps(seen, target, 8.0)

    return policy


def over_policy(city: Map, rng: np.random.Generator) -> Policy:
    """Up and over the roofs, and down behind them as fast as it can, again and again."""
    heading_rad, speed_mps = rng.uniform(0, 2 * np.pi), rng.uniform(0, 8)
    rate, tick = PERIOD_S * rng.uniform(0.1, 1.0), [0]
    ahead = speed_mps * np.array([np.cos(heading_rad), np.sin(heading_rad)])

    def policy(*_: object) -> FloatArray:
        tick[0] += 1
        return np.array([*ahead, -8.0 if np.sin(rate * tick[0]) > -0.3 else 8.0])

    return policy


def border_policy(city: Map, rng: np.random.Generator) -> Policy:
    """Out of the map, over a side, an edge or a corner of its box."""
    way = rng.choice([-9.0, 0.0, 9.0], size=3)
    way[rng.integers(3)] = rng.choice([-9.0, 9.0])
    return lambda *_: way


def pumping_policy(city: Map, rng: np.random.Generator) -> Policy:
    """To the wall and back in step with the lag, sliding along it all the while."""
    rate, tick = PERIOD_S * rng.uniform(0.5, 6.0), [0]

    def policy(seen: FloatArray, _: np.random.Generator) -> FloatArray:
        tick[0] += 1
        toward = city.obstacles.nearest_surface(seen) - seen
        toward = toward / max(float(np.sqrt(toward @ toward)), 1e-6)
        sign = np.sign(np.sin(rate * tick[0]))
        return sign * 9.0 * toward + 4.0 * np.array([toward[1], -toward[0], 0.0])

    return policy


def corner_policy(city: Map, rng: np.random.Generator) -> Policy:
    """Round the nearest corner as tightly as it is let."""
    corner_m, side = np.concatenate(city.footprints_m), rng.choice([-1.0, 1.0])

    def policy(seen: FloatArray, rng: np.random.Generator) -> FloatArray:
        offset_m = corner_m - seen[:2]
        toward = offset_m[np.square(offset_m).sum(axis=1).argmin()]
        toward = 6.0 * toward / max(float(np.hypot(*toward)), 1e-6)
        return np.array([*(toward + side * np.array([toward[1], -toward[0]])), rng.normal()])

    return policy


# fmt: off
POLICIES = [
    random_policy, constant_policy, wall_policy, flip_flop_policy, broken_policy,
    buried_target_policy, moving_target_policy, over_policy, border_policy, pumping_policy,
    corner_policy,
]
# fmt: on


def adversarial_flight(seed: int, *, disturbed: bool, duration_s: float) -> Flight:
    rng = np.random.default_rng(seed)
    city = CITIES[seed % len(CITIES)](rng)
    policy = POLICIES[seed // len(CITIES) % len(POLICIES)](city, rng)
    told_lag_s, told_brake_mps2 = rng.uniform(0.3, 1.0), rng.uniform(1.2, 2.5)
    better = rng.choice([0.0, 1.0])  # every other vehicle is exactly as told
    setting = Setting(
        VelocityLag(
            told_lag_s * (1.0 - better * rng.uniform(0.0, 0.7)),
            told_brake_mps2 * (1.0 + better * rng.uniform(0.0, 2.0)),
        ),
        ShieldLimits(v_max_mps=rng.uniform(3.0, 8.0), lag_s=told_lag_s, brake_mps2=told_brake_mps2),
        delay_ticks=int(rng.integers(0, 3)),
    )
    if disturbed:
        setting.lost, setting.late, setting.velocity_noise_mps = 0.2, 0.02, 0.1
        setting.noise_m = Disturbance(0.3, rng.choice([0.01, 2.0]))
        wind = seed // (len(CITIES) * len(POLICIES)) % 3
        if wind != 1:
            # Air that pushes harder than the vehicle can push back cannot be held against at all.
            most_per_s = MOST_PUSH * setting.lag.acceleration_max_mps2 / AIR_MPS
            setting.air_mps, setting.drag_per_s = AIR_MPS, min(rng.uniform(0.1, 0.5), most_per_s)
            setting.air_turns_s = rng.uniform(0.5, 5.0)
        if wind != 0:
            setting.gusts_mps = Disturbance(0.5, 2.0)
    # In a street, and every fifth time elsewhere, it starts well inside the margin.
    start_margin_m = 1.0 if city.name == "streets" or rng.random() < 0.2 else 2.0
    start = free_place(city, rng, start_margin_m)
    start[2] = min(start[2], 15.0)
    while not city.is_free(start, start_margin_m):
        start = free_place(city, rng, start_margin_m)
    return fly(city, setting, policy, start, rng, duration_s=duration_s)


@pytest.mark.parametrize("seed", range(44))
@pytest.mark.parametrize("disturbed", [False, True], ids=["calm", "wind-noise-and-loss"])
def test_no_policy_makes_it_touch_anything(seed, disturbed):
    flight = adversarial_flight(seed, disturbed=disturbed, duration_s=5.0)
    assert flight.contacts == 0
    assert flight.outside_m <= 0.0
    if not disturbed:
        # It may start 1 m from a wall; nothing is ever worse than that.
        assert flight.least_clearance_m >= 1.0 - 0.1


@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("block", range(100))
def test_ten_thousand_flights_touch_nothing(block):
    for seed in range(1000 + 100 * block, 1100 + 100 * block):
        flight = adversarial_flight(seed, disturbed=True, duration_s=12.0)
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
    assert all(flight.reasons[-1] is ShieldReason.BLOCKED for flight in stuck)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", ["env1", "env2"])
def test_straight_at_the_target_on_the_papers_maps(name):
    city, rng = load_map(name), np.random.default_rng(6)
    flights = [straight_flight(city, rng)[0] for _ in range(300)]
    assert not any(flight.contacts for flight in flights)
    assert np.mean([flight.arrived for flight in flights]) >= 0.75
