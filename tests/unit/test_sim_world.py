import dataclasses
import math
from dataclasses import fields

import numpy as np
import pytest

from companion.policy.action import PAPER_SCALING, TARGET_SCALING
from companion.policy.observation import LAYOUTS, build_observation
from companion.world.maps import load_map
from sim.dynamics import Disturbance, VelocityLag, VerticalLimits
from sim.motion import Dynamics
from sim.reward import Reward
from sim.world import CityWorld

CITY = """
name: tower
size_m: [100, 100, 100]
launch_m: [5, 5, 0]
obstacles:
  - {name: tower, footprint_m: [[40, 40], [60, 40], [60, 60], [40, 60]], height_m: 50}
  - {name: court, footprint_m: [[70, 10], [95, 10], [95, 35], [88, 35], [88, 17], [77, 17],
     [77, 35], [70, 35]], height_m: 80}
"""
EAST = np.array([1.0, 0.0, -1.0])  # rho_max, horizontal, azimuth 0
NORTH = np.array([1.0, 0.0, -0.5])
UP = np.array([1.0, -1.0, -1.0])
STAY = np.array([-1.0, 0.0, 0.0])

FLIGHT = {
    "target_motion": "moving",
    "dynamics": Dynamics(
        lag=VelocityLag(),
        time_constant_s=(0.3, 1.0),
        vertical=VerticalLimits(),
        wind=Disturbance(std=0.5, correlation_s=3.0),
        position_noise=Disturbance(std=0.3, correlation_s=2.0),
        start_speed_mps=5.0,
        substeps=3,
    ),
    "reward": Reward(beta=0.9, arrival_weight=1.0, keep_m=2.0, keep_weight=0.1),
    "end_on_contact": True,
    "end_on_arrival": True,
    "restart_probability": 0.05,
    "horizon": 30,
}
every_world = pytest.mark.parametrize(
    ("layout", "scaling", "options"),
    [
        pytest.param("paper", PAPER_SCALING, {}, id="paper"),
        pytest.param("paper", PAPER_SCALING, {"target_motion": "moving"}, id="moving"),
        pytest.param("relative", TARGET_SCALING, FLIGHT, id="flight"),
        pytest.param("rays", TARGET_SCALING, FLIGHT, id="rays"),
    ],
)


@pytest.fixture
def city(tmp_path):
    path = tmp_path / "tower.yaml"
    path.write_text(CITY)
    return load_map(path)


def make_world(city, num_worlds=1, seed=0, layout="paper", scaling=PAPER_SCALING, **options):
    rng = np.random.default_rng(seed)
    return CityWorld(city, LAYOUTS[layout], scaling, num_worlds, rng, **options)


def without_noise(options):
    """Return options whose worlds draw nothing between two restarts and see where they are."""
    if "dynamics" not in options:
        return options
    still = dataclasses.replace(options["dynamics"], wind=None, position_noise=None)
    return options | {"dynamics": still}


def place(world, position_enu_m, target_enu_m):
    """Put every vehicle and its resting target somewhere."""
    state = world.state_dict()
    state["arrays"]["position_enu_m"][:] = position_enu_m
    state["arrays"]["target_enu_m"][:] = target_enu_m
    state["arrays"]["path_vertex_enu_m"][:] = target_enu_m
    world.load_state_dict(state)


def run(world, actions):
    return [world.step(action) for action in actions]


def random_actions(num_steps, num_worlds, seed=1):
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (num_steps, num_worlds, 3))


def assert_same(one, other):
    for field in fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if field.name == "episode_end":
            assert_same(a, b)
        else:
            np.testing.assert_array_equal(a, b, err_msg=field.name)


def test_a_crash_by_hand(city):
    world = make_world(city)
    place(world, [30.0, 50.0, 25.0], [90.0, 50.0, 25.0])
    result = world.step(EAST[None])

    np.testing.assert_allclose(result.position_enu_m, [[50.0, 50.0, 25.0]], atol=1e-12)
    np.testing.assert_allclose(result.crash_depth_m, [10.0], atol=1e-9)
    guidance, penalty = math.exp(-5.0 * 0.4**2), math.exp(-100.0 * 0.1) - 1.0
    np.testing.assert_allclose(result.reward, [0.2 * guidance + 0.8 * penalty], rtol=1e-12)
    np.testing.assert_allclose(result.next_observation, [[0.5, 0.5, 0.25, 0.9, 0.5, 0.25]])
    assert result.contact.tolist() == [True]
    assert result.reached.tolist() == [False]
    assert result.terminated.tolist() == [False]
    assert result.truncated.tolist() == [False]


def test_over_the_roof_is_free(city):
    world = make_world(city)
    place(world, [30.0, 50.0, 50.1], [90.0, 50.0, 50.1])
    result = world.step(EAST[None])
    assert result.crash_depth_m.tolist() == [0.0]
    np.testing.assert_allclose(result.reward, 0.2 * math.exp(-5.0 * 0.4**2))


def test_through_two_legs_of_a_courtyard(city):
    world = make_world(city, scaling=PAPER_SCALING)
    place(world, [69.0, 30.0, 10.0], [20.0, 90.0, 10.0])
    depth_m = world.step(EAST[None]).crash_depth_m[0] + world.step(EAST[None]).crash_depth_m[0]
    assert depth_m == pytest.approx(14.0)


def test_contact_terminates_when_asked(city):
    world = make_world(city, end_on_contact=True, horizon=1)
    place(world, [30.0, 50.0, 25.0], [90.0, 50.0, 25.0])
    result = world.step(EAST[None])
    assert result.terminated.tolist() == [True]
    assert result.truncated.tolist() == [False], "not both, even at the horizon"


def test_the_horizon_truncates_and_keeps_the_last_observation(city):
    world = make_world(city, horizon=3)
    place(world, [10.0, 10.0, 10.0], [30.0, 90.0, 90.0])
    results = run(world, [NORTH[None], NORTH[None], UP[None]])
    assert [bool(r.truncated[0]) for r in results] == [False, False, True]
    assert not any(r.terminated[0] for r in results)
    last = results[-1]
    np.testing.assert_allclose(last.next_observation[0], [0.1, 0.5, 0.3, 0.3, 0.9, 0.9], rtol=1e-6)
    assert not np.array_equal(last.observation, last.next_observation)
    np.testing.assert_allclose(last.observation[0, :3], world.position_enu_m[0] / 100.0, rtol=1e-6)
    assert last.episode_end.steps.tolist() == [3]


def test_before_an_end_both_observations_are_one(city):
    world = make_world(city, num_worlds=8)
    result = world.step(random_actions(1, 8)[0])
    np.testing.assert_array_equal(result.observation, result.next_observation)
    assert len(result.episode_end.world) == 0


def test_walls_are_slid_along(city):
    world = make_world(city)
    place(world, [95.0, 50.0, 70.0], [50.0, 10.0, 90.0])
    north_east = np.array([[1.0, 0.0, -0.75]])
    result = world.step(north_east)
    np.testing.assert_allclose(result.position_enu_m, [[100.0, 50.0 + 20.0 * math.sqrt(0.5), 70.0]])


def test_arrival_is_remembered_and_ends_nothing(city):
    world = make_world(city)
    place(world, [10.0, 50.0, 70.0], [28.0, 50.0, 70.0])
    results = run(world, [EAST[None], EAST[None], EAST[None]])
    assert [bool(r.reached[0]) for r in results] == [True, True, True]
    assert not any(r.truncated[0] or r.terminated[0] for r in results)


def test_arrival_truncates_when_asked(city):
    world = make_world(city, end_on_arrival=True)
    place(world, [10.0, 50.0, 70.0], [28.0, 50.0, 70.0])
    result = world.step(EAST[None])
    assert result.truncated.tolist() == [True]
    assert result.terminated.tolist() == [False]
    end = result.episode_end
    assert end.reached.tolist() == [True]
    assert end.min_distance_m[0] == pytest.approx(2.0)


@pytest.mark.parametrize(("gap_m", "reached"), [(4.999, True), (5.0, False)])
def test_the_arrival_radius_is_open(city, gap_m, reached):
    world = make_world(city)
    place(world, [10.0, 90.0, 70.0], [10.0 + gap_m, 90.0, 70.0])
    assert bool(world.step(STAY[None]).reached[0]) is reached


def test_no_arrival_after_a_contact(city):
    world = make_world(city, horizon=2)
    place(world, [30.0, 50.0, 25.0], [70.0, 50.0, 25.0])
    first, second = run(world, [EAST[None], EAST[None]])
    assert second.episode_end.distance_m[0] < 1e-9
    assert not second.reached[0]
    assert not second.episode_end.reached[0]
    assert second.episode_end.contact_first[0]
    assert second.episode_end.min_distance_m[0] == np.inf, "there was a contact at once"
    assert first.contact[0]
    assert second.contact[0]


def test_a_contact_after_the_arrival_is_no_failure(city):
    world = make_world(city, horizon=2)
    place(world, [19.0, 50.0, 25.0], [39.0, 50.0, 25.0])
    end = run(world, [EAST[None], EAST[None]])[-1].episode_end
    assert end.reached.tolist() == [True]
    assert end.contact.tolist() == [True]
    assert end.contact_first.tolist() == [False]
    assert end.path_length_m[0] == pytest.approx(20.0), "the way counts until the arrival"


def test_the_books_of_a_straight_flight(city):
    world = make_world(city, horizon=4)
    place(world, [10.0, 10.0, 90.0], [10.0, 61.0, 90.0])
    results = run(world, [NORTH[None]] * 4)
    end = results[-1].episode_end
    assert end.world.tolist() == [0]
    assert end.min_distance_m[0] == pytest.approx(9.0)
    assert end.distance_m[0] == pytest.approx(29.0)
    assert end.path_length_m[0] == pytest.approx(80.0)
    assert end.reward_sum[0] == pytest.approx(sum(r.reward[0] for r in results))


@every_world
def test_a_restored_state_replays_to_the_same_results(city, layout, scaling, options):
    world = make_world(city, 16, 3, layout, scaling, **options)
    actions = random_actions(130, 16)
    run(world, actions[:20])
    state = world.state_dict()
    first = run(world, actions)
    observation = world.load_state_dict(state)
    second = run(world, actions)
    for one, other in zip(first, second, strict=True):
        assert_same(one, other)
    elsewhere = make_world(city, 16, 99, layout, scaling, **options)
    np.testing.assert_array_equal(elsewhere.load_state_dict(state), observation)
    for one, action in zip(first, actions, strict=True):
        assert_same(one, elsewhere.step(action))


@every_world
def test_the_same_seed_gives_the_same_run(city, layout, scaling, options):
    actions = random_actions(60, 5)
    first = run(make_world(city, 5, 7, layout, scaling, **options), actions)
    second = run(make_world(city, 5, 7, layout, scaling, **options), actions)
    for one, other in zip(first, second, strict=True):
        assert_same(one, other)


@pytest.mark.parametrize(
    "options",
    [
        pytest.param({}, id="paper"),
        pytest.param(
            {"target_motion": "moving", "dynamics": Dynamics(lag=VelocityLag(), substeps=2)},
            id="lag",
        ),
    ],
)
def test_a_batch_is_its_worlds_one_by_one(city, options):
    batch = make_world(city, 12, 5, **options)
    state = batch.state_dict()
    actions = random_actions(40, 12)
    results = run(batch, actions)
    for i in range(12):
        alone = make_world(city, 1, 0, **options)
        row = {name: array[i : i + 1] for name, array in state["arrays"].items()}
        alone.load_state_dict({"arrays": row, "rng": state["rng"]})
        for result, action in zip(results, actions, strict=True):
            one = alone.step(action[i : i + 1])
            np.testing.assert_allclose(one.reward[0], result.reward[i], rtol=1e-9, atol=1e-12)
            np.testing.assert_allclose(
                one.position_enu_m[0], result.position_enu_m[i], rtol=1e-9, atol=1e-9
            )
            np.testing.assert_allclose(
                one.next_observation[0], result.next_observation[i], atol=1e-6
            )
            assert one.contact[0] == result.contact[i]


@every_world
def test_starts_and_targets_are_never_inside_obstacles(city, layout, scaling, options):
    world = make_world(city, 400, 11, layout, scaling, **options)
    for _ in range(5):
        world.reset()
        assert city.is_free(world.position_enu_m).all()
        assert city.is_free(world.target_enu_m).all()


def test_moving_targets_never_enter_obstacles(city):
    world = make_world(city, 200, 2, target_motion="moving", target_speed=(0.5, 1.0))
    for action in random_actions(150, 200):
        result = world.step(action)
        assert city.is_free(result.target_enu_m).all()
        assert city.is_free(world.target_enu_m).all()


def test_the_way_from_start_to_target_is_on_the_books(city):
    world = make_world(city, 50, horizon=1)
    straight_m = np.linalg.norm(world.target_enu_m - world.position_enu_m, axis=1)
    end = world.step(random_actions(1, 50)[0]).episode_end
    np.testing.assert_allclose(end.straight_m, straight_m)


def test_starts_fill_the_free_space(city):
    position_enu_m = make_world(city, 20_000, 1).position_enu_m
    low, high = position_enu_m.min(axis=0), position_enu_m.max(axis=0)
    np.testing.assert_allclose(low, 0.0, atol=0.5)
    np.testing.assert_allclose(high, 100.0, atol=0.5)
    above_tower = (np.abs(position_enu_m[:, :2] - 50.0) < 10.0).all(axis=1)
    assert above_tower.mean() == pytest.approx(0.04 * 0.5 / 0.94, rel=0.2)


@every_world
def test_results_stay_as_they_were(city, layout, scaling, options):
    world = make_world(city, 6, 1, layout, scaling, **options)
    actions = random_actions(40, 6)
    results, copies = [], []
    for action in actions:
        result = world.step(action)
        results.append(result)
        copies.append({f.name: np.copy(getattr(result, f.name)) for f in fields(result)[:-1]})
    world.load_state_dict(world.state_dict())
    world.reset()
    for result, copy in zip(results, copies, strict=True):
        for name, array in copy.items():
            np.testing.assert_array_equal(getattr(result, name), array, err_msg=name)


@every_world
def test_observations_are_those_of_flight(city, layout, scaling, options):
    world = make_world(city, 6, 1, layout, scaling, **without_noise(options))
    for action in random_actions(40, 6):
        result = world.step(action)
        expected = build_observation(
            LAYOUTS[layout],
            position_enu_m=result.position_enu_m,
            velocity_enu_mps=result.velocity_enu_mps,
            target_enu_m=result.target_enu_m,
            map=city,
        )
        np.testing.assert_array_equal(result.next_observation, expected)


def test_restarts_come_as_often_as_asked(city):
    world = make_world(city, 500, 4, restart_probability=0.02)
    truncated = [world.step(a).truncated for a in np.zeros((40, 500, 3))]
    assert np.mean(truncated) == pytest.approx(0.02, rel=0.15)


def test_a_lagging_vehicle_falls_short_of_the_kinematic_one(city):
    start, target = [10.0, 10.0, 70.0], [10.0, 95.0, 70.0]
    lagged = make_world(city, dynamics=Dynamics(lag=VelocityLag()), v_max_mps=5.0)
    place(lagged, start, target)
    result = lagged.step(NORTH[None])
    assert lagged.dt_s == pytest.approx(4.0)
    assert 14.0 < result.position_enu_m[0, 1] - 10.0 < 18.5
    assert result.velocity_enu_mps[0, 1] == pytest.approx(5.0, abs=0.02)


def test_substeps_change_the_chords_not_the_way(city):
    ways = []
    for substeps in (1, 8):
        world = make_world(city, dynamics=Dynamics(lag=VelocityLag(), substeps=substeps))
        place(world, [10.0, 10.0, 70.0], [10.0, 95.0, 70.0])
        world.step(NORTH[None])
        ways.append(world.step(EAST[None]).position_enu_m)
    np.testing.assert_allclose(ways[0], ways[1], atol=1e-9)


@every_world
def test_worlds_on_several_maps_are_those_on_one(city, layout, scaling, options):
    options = without_noise(options) | {"restart_probability": 0.0, "horizon": 100}
    maps = [city, load_map("env1"), load_map("env2")]
    together = make_world(maps, 9, 5, layout, scaling, **options)
    state = together.state_dict()
    actions = random_actions(15, 9)
    running = np.ones(9, dtype=bool)
    alone = []
    for i in range(9):
        world = make_world(together.map_of(i), 1, 0, layout, scaling, **options)
        row = {name: array[i : i + 1] for name, array in state["arrays"].items()}
        world.load_state_dict({"arrays": row, "rng": state["rng"]})
        alone.append(world)
    for action in actions:
        result = together.step(action)
        for i in np.flatnonzero(running):
            one = alone[i].step(action[i : i + 1])
            np.testing.assert_allclose(one.reward[0], result.reward[i], rtol=1e-9, atol=1e-12)
            np.testing.assert_allclose(
                one.next_observation[0], result.next_observation[i], atol=1e-6
            )
        running &= ~(result.terminated | result.truncated)
    assert running.any()


def test_several_maps_each_under_its_own_worlds(city, tmp_path):
    free = load_map("free")
    world = make_world([free, city], 7, 0, horizon=5)
    assert [world.map_of(i).name for i in range(7)] == ["free"] * 4 + ["tower"] * 3
    place(world, [30.0, 50.0, 25.0], [90.0, 50.0, 25.0])
    result = world.step(np.tile(EAST, (7, 1)))
    assert result.contact.tolist() == [False] * 4 + [True] * 3
    for action in random_actions(30, 7):
        world.step(action)
        assert city.is_free(world.target_enu_m[4:]).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"horizon": 0}, "horizon"),
        ({"restart_probability": 1.0}, "restart_probability"),
        ({"arrival_radius_m": 0.0}, "arrival_radius_m"),
        ({"v_max_mps": -1.0}, "v_max_mps"),
        ({"target_speed": (0.5, 0.1)}, "target_speed"),
        ({"step_s": 0.05}, "lag"),
        ({"arrived_restart_probability": -0.1}, "restart_probability"),
        ({"target_motion": "dancing"}, "dancing"),
    ],
    ids=lambda value: value if isinstance(value, str) else None,
)
def test_impossible_options_are_refused(city, options, message):
    with pytest.raises(ValueError, match=message):
        make_world(city, **options)


def test_what_cannot_be_stepped_is_refused(city):
    world = make_world(city, 4)
    with pytest.raises(ValueError, match=r"action must be \(4, 3\)"):
        world.step(np.zeros((3, 3)))
    with pytest.raises(ValueError, match="finite"):
        world.step(np.full((4, 3), np.nan))
    with pytest.raises(ValueError, match="maps"):
        make_world([city, city], 1)
    with pytest.raises(ValueError, match="must be"):
        world.load_state_dict(make_world(city, 5).state_dict())


def test_a_step_of_another_length_is_asked_more_often(city):
    world = make_world(city, dynamics=Dynamics(lag=VelocityLag()), step_s=0.05, v_max_mps=5.0)
    place(world, [10.0, 10.0, 70.0], [10.0, 95.0, 70.0])
    north_m = [world.step(NORTH[None]).position_enu_m[0, 1] for _ in range(80)]
    once = make_world(city, dynamics=Dynamics(lag=VelocityLag()), v_max_mps=5.0)
    place(once, [10.0, 10.0, 70.0], [10.0, 95.0, 70.0])
    assert north_m[-1] == pytest.approx(once.step(NORTH[None]).position_enu_m[0, 1])


def test_climb_and_descent_stay_within_the_limits_of_the_autopilot(city):
    dynamics = Dynamics(lag=VelocityLag(), vertical=VerticalLimits(3.0, 1.5))
    world = make_world(city, 2, dynamics=dynamics, v_max_mps=5.0)
    place(world, [10.0, 10.0, 50.0], [10.0, 95.0, 50.0])
    up_or_down = np.array([UP, [1.0, 1.0, 0.0]])
    for _ in range(3):
        up_mps = world.step(up_or_down).velocity_enu_mps[:, 2]
    np.testing.assert_allclose(up_mps, [3.0, -1.5], atol=1e-3)


def test_the_actor_sees_the_estimate_and_the_referee_the_truth(city):
    dynamics = Dynamics(lag=VelocityLag(), position_noise=Disturbance(0.3, 2.0))
    world = make_world(city, 200, 3, "relative", TARGET_SCALING, dynamics=dynamics)
    result = world.step(np.tile(STAY, (200, 1)))
    seen_m = 0.5 * 100.0 * (result.next_observation[:, :3] + 1.0)
    error_m = seen_m - result.position_enu_m
    inside = np.all((seen_m > 0.0) & (seen_m < 100.0), axis=1)
    assert np.std(error_m[inside]) == pytest.approx(0.3, rel=0.1)
    np.testing.assert_allclose(seen_m[inside], world.estimate_enu_m[inside], atol=1e-4)


def test_episodes_begin_as_varied_as_asked(city):
    dynamics = Dynamics(lag=VelocityLag(), time_constant_s=(0.3, 1.0), start_speed_mps=4.0)
    world = make_world(city, 400, 3, dynamics=dynamics, start_margin_m=3.0)
    speed_mps = np.linalg.norm(world.velocity_enu_mps, axis=1)
    assert speed_mps.max() <= 4.0
    assert np.mean(speed_mps) == pytest.approx(2.0, rel=0.1)
    slow_s = world.state_dict()["arrays"]["time_constant_s"]
    assert 0.3 <= slow_s.min() < 0.35 < 0.95 < slow_s.max() <= 1.0
    assert world.clearance_m().min() > 3.0


def test_ways_near_obstacles_cost_reward_and_end_nothing(city):
    rewards = []
    for keep_weight in (0.0, 0.5):
        reward = Reward(keep_m=3.0, keep_weight=keep_weight)
        world = make_world(city, reward=reward, end_on_contact=True)
        place(world, [38.0, 30.0, 25.0], [38.0, 70.0, 25.0])
        result = world.step(NORTH[None])
        assert not result.contact.any()
        assert not result.terminated.any()
        rewards.append(float(result.reward[0]))
    assert rewards[0] - rewards[1] == pytest.approx(0.8 * 0.5, abs=0.01)


def test_worlds_taken_out_go_on_as_if_nothing_had_happened(city):
    options = {"dynamics": Dynamics(lag=VelocityLag(), time_constant_s=(0.3, 1.0))}
    maps = [city, load_map("env1")]
    whole = make_world(maps, 6, 1, "rays", TARGET_SCALING, **options)
    rows = np.array([1, 4, 5])
    for action in random_actions(3, 6):
        whole.step(action)
    taken = whole.take(rows)
    assert [taken.map_of(i).name for i in range(3)] == [whole.map_of(i).name for i in rows]
    for action in random_actions(10, 6):
        expected, result = whole.step(action), taken.step(action[rows])
        np.testing.assert_allclose(result.position_enu_m, expected.position_enu_m[rows])
        np.testing.assert_allclose(result.reward, expected.reward[rows])
        np.testing.assert_allclose(result.observation, expected.observation[rows], atol=1e-6)
    np.testing.assert_allclose(taken.books().min_distance_m, whole.books().min_distance_m[rows])


def test_a_kinematic_point_follows_no_velocity(city):
    with pytest.raises(ValueError, match="lag"):
        make_world(city).follow(np.zeros((1, 3)))
