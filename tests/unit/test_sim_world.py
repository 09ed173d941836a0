"""What holds for every world: the same results again, alone, in batches and over several maps."""

from dataclasses import fields

import numpy as np
import pytest

from companion.policy.action import PAPER_SCALING, TARGET_SCALING
from companion.policy.observation import LAYOUTS, build_observation
from companion.world.maps import load_map
from sim.dynamics import Disturbance, VelocityLag, VerticalLimits
from sim.motion import Dynamics
from sim.reward import Reward
from tests.unit.world_bench import (
    EAST,
    STAY,
    TOWER_AND_COURT,
    assert_same,
    make_world,
    place,
    random_actions,
    run,
    without_noise,
)

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
def city():
    return TOWER_AND_COURT


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
