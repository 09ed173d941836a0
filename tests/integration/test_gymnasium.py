import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import sim.gym
from companion.errors import UsageError
from companion.policy.observation import PAPER

VARIANTS = [
    pytest.param({}, id="paper"),
    pytest.param({"map": "env2", "layout": "relative", "end_on_contact": True}, id="relative"),
    pytest.param({"map": "free", "target_motion": "moving", "end_on_arrival": True}, id="moving"),
]


@pytest.mark.parametrize("options", VARIANTS)
def test_gymnasiums_own_checker_has_nothing_to_say(options):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        env = gymnasium.make("mavlink-companion/City-v0", **options)
        check_env(env.unwrapped)
        env.close()
    assert [str(warning.message) for warning in caught] == []


def test_the_same_seed_gives_the_same_episode():
    def fly():
        env = gymnasium.make("mavlink-companion/City-v0", map="env1", target_motion="moving")
        env.action_space.seed(3)
        first, _ = env.reset(seed=5)
        return [first] + [env.step(env.action_space.sample())[0] for _ in range(50)]

    np.testing.assert_array_equal(fly(), fly())


def test_the_docstring_is_the_layout():
    table = sim.gym.CityEnv.__doc__.split("## Observation space")[1].split("Other layouts")[0]
    rows = [[cell.strip() for cell in row.split("|")[1:-1]] for row in table.splitlines()]
    rows = [row for row in rows if row and row[0].isdigit()]
    assert [(row[0], float(row[2]), float(row[3])) for row in rows] == [
        (str(number), field.low, field.high) for number, field in enumerate(PAPER.fields)
    ]


def test_an_episode_truncates_at_the_horizon_and_the_next_one_differs():
    env = gymnasium.make("mavlink-companion/City-v0", map="free", horizon=5)
    first, info = env.reset(seed=1)
    assert info["reached"] is False
    ends = [env.step(env.action_space.sample())[2:4] for _ in range(5)]
    assert ends == [(False, False)] * 4 + [(False, True)]
    second, _ = env.reset()
    assert not np.array_equal(first, second)


def test_vector_environments_work():
    envs = gymnasium.make_vec("mavlink-companion/City-v0", num_envs=3, map="env1")
    observation, _ = envs.reset(seed=0)
    assert observation.shape == (3, 6)
    assert len(np.unique(observation[:, 0])) == 3
    envs.close()


def test_unknown_layouts_are_refused():
    with pytest.raises(UsageError, match="layout 'papre' is unknown, there are paper"):
        gymnasium.make("mavlink-companion/City-v0", layout="papre")


def test_without_gymnasium_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    monkeypatch.delitem(sys.modules, "sim.gym")
    with pytest.raises(UsageError, match=r'pip install "mavlink-companion\[training\]"'):
        __import__("sim.gym")


def test_stable_baselines3_accepts_it():
    from stable_baselines3.common.env_checker import check_env as sb3_check_env

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        sb3_check_env(sim.gym.CityEnv(), warn=True)
    assert [str(warning.message) for warning in caught] == []


@pytest.fixture
def one_thread():
    """Networks this small only wait for each other on more threads."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.mark.usefixtures("one_thread")
def test_stable_baselines3_trains_on_it():
    from stable_baselines3 import DDPG

    env = gymnasium.make("mavlink-companion/City-v0", map="free", layout="relative")
    model = DDPG(
        "MlpPolicy",
        env,
        learning_starts=100,
        policy_kwargs={"net_arch": [16, 16]},
        seed=0,
        device="cpu",
    )
    model.learn(total_timesteps=300)
    observation, _ = env.reset(seed=0)
    action, _ = model.predict(observation, deterministic=True)
    assert env.action_space.contains(action)
