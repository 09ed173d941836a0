"""The paper's replay buffer b of size B, and the multi-step returns that may feed it."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from companion.arrays import BoolArray, Float32Array, FloatArray
from training.networks import ACTION_SIZE


class Batch(NamedTuple):
    """``N`` transitions; valid until the next sample."""

    observation: Tensor  # (N, n)
    action: Tensor  # (N, 3)
    next_observation: Tensor  # (N, n)
    reward: Tensor  # (N,)
    """Discounted sum over the steps of the transition."""
    bootstrap: Tensor  # (N,)
    """Weight of the value of what follows: gamma to the power of the steps, 0 where the episode
    terminated. A truncated episode bootstraps."""


class ReplayBuffer:
    """The newest ``capacity`` transitions, one row each.

    One preallocated float32 table holds all columns, so that a batch is one gather into memory
    that is reused, and the fields are views of it, or of its copy on another device.
    """

    def __init__(
        self,
        capacity: int,
        observation_size: int,
        batch_size: int,
        device: torch.device | str = "cpu",
    ) -> None:
        if not 1 <= batch_size <= capacity:
            raise ValueError(f"need 1 <= batch_size <= capacity, got {batch_size}, {capacity}")
        self.capacity = capacity
        self.size = 0
        self._device = torch.device(device)
        self._next_row = 0
        n = observation_size
        self._cuts = (n, n + ACTION_SIZE, 2 * n + ACTION_SIZE)
        width = 2 * n + ACTION_SIZE + 2
        self._table = np.zeros((capacity, width), dtype=np.float32)
        self._batch = np.zeros((batch_size, width), dtype=np.float32)
        self._batch_tensor = torch.from_numpy(self._batch)

    def add(self, transitions: Float32Array) -> None:
        """Store rows as ``Transitions.rows`` builds them, shape ``(K, width)``; the oldest go."""
        rows = transitions[-self.capacity :]
        first = min(len(rows), self.capacity - self._next_row)
        self._table[self._next_row : self._next_row + first] = rows[:first]
        self._table[: len(rows) - first] = rows[first:]
        self._next_row = (self._next_row + len(rows)) % self.capacity
        self.size = min(self.size + len(rows), self.capacity)

    def sample(self, rng: np.random.Generator) -> Batch:
        """Return a random batch, drawn with replacement; overwritten by the next call.

        Raises:
            ValueError: If nothing is stored yet.
        """
        if self.size == 0:
            raise ValueError("the replay buffer is empty")
        rows = rng.integers(self.size, size=len(self._batch))
        np.take(self._table, rows, axis=0, out=self._batch, mode="clip")
        # No copy where the device is the CPU.
        columns = self._batch_tensor.to(self._device)
        a, b, c = self._cuts
        return Batch(
            columns[:, :a], columns[:, a:b], columns[:, b:c], columns[:, c], columns[:, c + 1]
        )

    @property
    def observations(self) -> Float32Array:
        """What was acted on, ``(size, n)``; a view, in no order of time."""
        return self._table[: self.size, : self._cuts[0]]

    def state_dict(self) -> dict[str, Any]:
        """Return the stored rows and the place of the next one."""
        return {"table": self._table[: self.size].copy(), "next_row": self._next_row}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore what ``state_dict`` returned, from a buffer of the same shape.

        Raises:
            ValueError: If the shapes differ.
        """
        table = state["table"]
        if len(table) > self.capacity or table.shape[1] != self._table.shape[1]:
            raise ValueError(f"saved table {table.shape} does not fit {self._table.shape}")
        self.size, self._next_row = len(table), state["next_row"]
        self._table[: self.size] = table


@dataclass(slots=True)
class _Pending:
    """Transitions begun in one step of all worlds and not yet complete."""

    observation: Float32Array  # (N, n)
    action: Float32Array  # (N, 3)
    reward: FloatArray  # (N,)
    running: BoolArray  # (N,)


class MultiStep:
    """Turn steps of ``N`` worlds into rows whose reward spans up to ``num_steps`` steps.

    ``num_steps = 1`` is the paper's one-step transition. A transition ends early with its
    episode; no reward crosses into the next one.
    """

    def __init__(self, num_steps: int, gamma: float) -> None:
        if num_steps < 1:
            raise ValueError(f"num_steps must be at least 1, got {num_steps}")
        self.num_steps = num_steps
        self.gamma = gamma
        self._pending: deque[_Pending] = deque()

    def push(
        self,
        observation: Float32Array,
        action: Float32Array,
        reward: FloatArray,
        next_observation: Float32Array,
        terminated: BoolArray,
        truncated: BoolArray,
    ) -> Float32Array:
        """Take in one step of every world.

        Args:
            observation: Acted on, shape ``(N, n)``.
            action: Shape ``(N, 3)``.
            reward: Shape ``(N,)``.
            next_observation: Of the step itself, before any reset, shape ``(N, n)``.
            terminated: Ended for good: no bootstrap, shape ``(N,)``.
            truncated: Cut short: bootstrap, shape ``(N,)``.

        Returns:
            The completed transitions as rows for ``ReplayBuffer.add``, shape ``(K, width)``.
        """
        self._pending.append(
            _Pending(observation, action, np.zeros_like(reward), np.ones_like(terminated))
        )
        ended = terminated | truncated
        completed: list[Float32Array] = []
        age = len(self._pending)
        for pending in self._pending:
            age -= 1
            pending.reward = pending.reward + self.gamma**age * reward
            full = age == self.num_steps - 1
            done = pending.running if full else pending.running & ended
            if done.any():
                bootstrap = np.where(terminated, 0.0, self.gamma ** (age + 1))
                completed.append(_rows(pending, next_observation, bootstrap, done))
            pending.running = pending.running & ~ended
        if len(self._pending) == self.num_steps:
            self._pending.popleft()
        if not completed:
            width = 2 * observation.shape[1] + ACTION_SIZE + 2
            return np.empty((0, width), dtype=np.float32)
        return np.concatenate(completed)

    def state_dict(self) -> dict[str, Any]:
        """Return the incomplete transitions."""
        return {"pending": [(p.observation, p.action, p.reward, p.running) for p in self._pending]}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore what ``state_dict`` returned."""
        self._pending = deque(_Pending(*columns) for columns in state["pending"])


def _rows(
    pending: _Pending, next_observation: Float32Array, bootstrap: FloatArray, done: BoolArray
) -> Float32Array:
    n = pending.observation.shape[1]
    rows = np.empty((int(done.sum()), 2 * n + ACTION_SIZE + 2), dtype=np.float32)
    rows[:, :n] = pending.observation[done]
    rows[:, n : n + ACTION_SIZE] = pending.action[done]
    rows[:, n + ACTION_SIZE : 2 * n + ACTION_SIZE] = next_observation[done]
    rows[:, -2] = pending.reward[done]
    rows[:, -1] = bootstrap[done]
    return rows
