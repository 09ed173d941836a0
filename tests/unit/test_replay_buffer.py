"""The replay buffer against a list, and multi-step returns against sums done by hand."""

import numpy as np
import pytest

from training.replay_buffer import MultiStep, ReplayBuffer

GAMMA = 0.9
WIDTH = 2 * 2 + 3 + 2


def rows_of(numbers):
    """One row per number, every column holding it."""
    return np.repeat(np.asarray(numbers, dtype=np.float32)[:, None], WIDTH, axis=1)


def test_the_newest_transitions_stay():
    buffer = ReplayBuffer(capacity=5, observation_size=2, batch_size=4)
    for start in range(0, 12, 3):
        buffer.add(rows_of(range(start, start + 3)))
    assert buffer.size == 5
    rng = np.random.default_rng(0)
    seen = {float(r) for _ in range(50) for r in buffer.sample(rng).reward}
    assert seen == {7.0, 8.0, 9.0, 10.0, 11.0}


def test_more_rows_than_fit_keep_the_last():
    buffer = ReplayBuffer(capacity=4, observation_size=2, batch_size=2)
    buffer.add(rows_of([1]))
    buffer.add(rows_of(range(10, 20)))
    rng = np.random.default_rng(0)
    seen = {float(r) for _ in range(50) for r in buffer.sample(rng).reward}
    assert seen == {16.0, 17.0, 18.0, 19.0}


def test_a_batch_has_one_shape_per_field():
    buffer = ReplayBuffer(capacity=8, observation_size=2, batch_size=6)
    row = np.arange(WIDTH, dtype=np.float32)[None]
    buffer.add(row)
    batch = buffer.sample(np.random.default_rng(0))
    assert [tuple(field.shape) for field in batch] == [(6, 2), (6, 3), (6, 2), (6,), (6,)]
    assert batch.observation[0].tolist() == [0, 1]
    assert batch.action[0].tolist() == [2, 3, 4]
    assert batch.next_observation[0].tolist() == [5, 6]
    assert (batch.reward[0], batch.bootstrap[0]) == (7, 8)


def test_an_empty_buffer_says_so():
    buffer = ReplayBuffer(capacity=8, observation_size=2, batch_size=6)
    with pytest.raises(ValueError, match="empty"):
        buffer.sample(np.random.default_rng(0))


@pytest.mark.parametrize("batch_size", [0, 9])
def test_a_batch_larger_than_the_buffer_is_refused(batch_size):
    with pytest.raises(ValueError, match="batch_size"):
        ReplayBuffer(capacity=8, observation_size=2, batch_size=batch_size)


def test_a_restored_buffer_goes_on_alike():
    first = ReplayBuffer(capacity=5, observation_size=2, batch_size=4)
    first.add(rows_of(range(7)))
    second = ReplayBuffer(capacity=5, observation_size=2, batch_size=4)
    second.load_state_dict(first.state_dict())
    for buffer in (first, second):
        buffer.add(rows_of([20, 21]))
    rngs = np.random.default_rng(3), np.random.default_rng(3)
    drawn = [buffer.sample(rng).reward for buffer, rng in zip((first, second), rngs, strict=True)]
    assert drawn[0].tolist() == drawn[1].tolist()


def test_a_state_of_another_shape_is_refused():
    first = ReplayBuffer(capacity=5, observation_size=2, batch_size=4)
    first.add(rows_of(range(5)))
    with pytest.raises(ValueError, match="does not fit"):
        ReplayBuffer(capacity=4, observation_size=2, batch_size=4).load_state_dict(
            first.state_dict()
        )


def push(multi_step, step, reward, terminated, truncated):
    """Push one step of two worlds; observation and action hold the step's number."""
    return multi_step.push(
        np.full((2, 2), step, dtype=np.float32),
        np.full((2, 3), step, dtype=np.float32),
        np.asarray(reward, dtype=np.float64),
        np.full((2, 2), step + 100, dtype=np.float32),
        np.asarray(terminated),
        np.asarray(truncated),
    )


def as_tuples(rows):
    """(observation, next observation, reward, bootstrap) of each row."""
    return sorted(tuple(round(float(r[c]), 4) for c in (0, 5, -2, -1)) for r in rows)


def test_one_step_is_the_papers_transition():
    multi_step = MultiStep(1, GAMMA)
    rows = push(multi_step, 0, [1.0, 2.0], [True, False], [False, True])
    # Terminated: no bootstrap. Truncated: bootstrap.
    assert as_tuples(rows) == as_tuples(
        [[0, 0, 0, 0, 0, 100, 100, 1.0, 0.0], [0, 0, 0, 0, 0, 100, 100, 2.0, GAMMA]]
    )


def test_three_steps_sum_discounted_rewards():
    multi_step = MultiStep(3, GAMMA)
    quiet = [False, False]
    assert len(push(multi_step, 0, [1, 1], quiet, quiet)) == 0
    assert len(push(multi_step, 1, [2, 2], quiet, quiet)) == 0
    rows = push(multi_step, 2, [3, 4], quiet, quiet)
    expected = [1 + GAMMA * 2 + GAMMA**2 * 3, 1 + GAMMA * 2 + GAMMA**2 * 4]
    np.testing.assert_allclose(rows[:, -2], expected, rtol=1e-6)
    np.testing.assert_allclose(rows[:, -1], GAMMA**3, rtol=1e-6)
    assert (rows[:, 0] == 0).all()
    assert (rows[:, 5] == 102).all()


def test_an_episode_that_ends_flushes_shorter_sums_and_starts_clean():
    multi_step = MultiStep(3, GAMMA)
    quiet = [False, False]
    push(multi_step, 0, [1, 1], quiet, quiet)
    ended = push(multi_step, 1, [2, 2], [True, False], quiet)
    assert as_tuples(ended) == as_tuples(
        [
            [0, 0, 0, 0, 0, 101, 101, 1 + GAMMA * 2, 0.0],
            [1, 1, 0, 0, 0, 101, 101, 2.0, 0.0],
        ]
    )
    third = push(multi_step, 2, [3, 3], quiet, quiet)
    # Only the second world completes a sum; the first has begun a new episode.
    assert len(third) == 1
    assert third[0, -2] == pytest.approx(1 + GAMMA * 2 + GAMMA**2 * 3)
    fourth = push(multi_step, 3, [4, 4], quiet, [True, True])
    new_world = [row for row in as_tuples(fourth) if row[0] == 2.0]
    assert len(new_world) == 2
    for row in new_world:
        assert row[2:] == pytest.approx((3 + GAMMA * 4, GAMMA**2), abs=1e-4)


def test_a_truncated_episode_bootstraps_with_its_own_length():
    multi_step = MultiStep(3, GAMMA)
    rows = push(multi_step, 0, [1, 1], [False, False], [True, True])
    np.testing.assert_allclose(rows[:, -1], GAMMA, rtol=1e-6)


def test_every_step_yields_one_transition():
    """Over random episodes, each step begins exactly one transition; none is lost or doubled."""
    rng = np.random.default_rng(5)
    multi_step, started = MultiStep(4, GAMMA), []
    steps = 60
    for step in range(steps):
        terminated = rng.random(2) < 0.2
        truncated = (rng.random(2) < 0.2) & ~terminated
        if step == steps - 1:
            terminated, truncated = np.array([True, False]), np.array([False, True])
        rows = push(multi_step, step, rng.random(2), terminated, truncated)
        started += rows[:, 0].tolist()
    assert sorted(started) == sorted([*range(steps), *range(steps)])
