"""The reward of one step: guidance towards the target, a penalty for the crash depth.

The paper's equation (2)::

    f_r(D, sigma) = (1 - beta) f_gui(D) + beta f_obp(sigma)
    f_gui(D)      = exp(-5 D^2)
    f_obp(sigma)  = exp(-100 sigma) - 1

``D`` is the distance to the target and ``sigma`` the crash depth, both as fractions of the
map's edge. Every function takes arrays of any shape.
"""

from dataclasses import dataclass

import numpy as np

from companion.arrays import FloatArray

BETA = 0.8
"""The paper's "beta = 4", read as the ratio beta / (1 - beta) (erratum E4)."""


def guidance_reward(distance: FloatArray) -> FloatArray:
    """Return ``f_gui`` in (0, 1], largest on the target.

    Args:
        distance: Distance to the target as a fraction of the edge.
    """
    reward: FloatArray = np.exp(-5.0 * np.square(distance))
    return reward


def arrival_reward(distance: FloatArray) -> FloatArray:
    """Return ``exp(-2500 D^2)`` in (0, 1]: 0.37 at 2 % of the edge, 0.78 at 1 %.

    Not the paper's. ``f_gui`` is flat at the target (0.99 at 5 %): a vehicle that hovers at the
    edge of the arrival radius loses next to nothing by it. This term makes it come in.

    Args:
        distance: Distance to the target as a fraction of the edge.
    """
    reward: FloatArray = np.exp(-2500.0 * np.square(distance))
    return reward


def obstacle_penalty(crash_depth: FloatArray) -> FloatArray:
    """Return ``f_obp`` in (-1, 0], zero without a crash.

    Args:
        crash_depth: Length of the step's segment inside obstacles, as a fraction of the edge.
    """
    penalty: FloatArray = np.expm1(-100.0 * crash_depth)
    return penalty


def step_reward(distance: FloatArray, crash_depth: FloatArray, *, beta: float) -> FloatArray:
    """Return ``f_r``, in (-beta, 1 - beta].

    Args:
        distance: Distance to the target after the step, as a fraction of the edge.
        crash_depth: Crash depth of the step, as a fraction of the edge.
        beta: Weight of the penalty; see ``check_beta``.
    """
    return (1.0 - beta) * guidance_reward(distance) + beta * obstacle_penalty(crash_depth)


@dataclass(frozen=True, slots=True)
class Reward:
    """The paper's reward, and what may be added to it; by default nothing is."""

    beta: float = BETA
    """Weight of the obstacle penalty (E4)."""
    arrival_weight: float = 0.0
    """Weight of ``arrival_reward`` beside the paper's guidance reward."""
    keep_m: float = 0.0
    """Distance from obstacles within which a way costs reward; it ends nothing."""
    keep_weight: float = 0.0
    """What it costs, as a share of a crash of the same depth."""

    def __post_init__(self) -> None:
        check_beta(self.beta)
        if min(self.arrival_weight, self.keep_m, self.keep_weight) < 0.0:
            raise ValueError("weights of the reward and keep_m must not be negative")

    @property
    def keeps_off(self) -> bool:
        """Whether ways near to obstacles cost anything."""
        return self.keep_m * self.keep_weight > 0.0

    def of(
        self, distance: FloatArray, crash_depth: FloatArray, near: FloatArray | None
    ) -> FloatArray:
        """Return the reward of a step; all arguments as fractions of the edge.

        Args:
            distance: Distance to the target after the step.
            crash_depth: Length of the step inside obstacles.
            near: Length of the step within ``keep_m`` of obstacles or inside; ``None`` where
                ``keeps_off`` says that nobody asks.
        """
        reward = step_reward(distance, crash_depth, beta=self.beta)
        if self.arrival_weight > 0.0:
            reward = reward + (1.0 - self.beta) * self.arrival_weight * arrival_reward(distance)
        if near is not None:
            reward = reward + self.beta * self.keep_weight * obstacle_penalty(near)
        return reward


def check_beta(beta: float) -> float:
    """Return ``beta`` if the reward makes sense with it.

    Raises:
        ValueError: If ``beta`` lies outside [0, 1); the paper's literal 4 among them.
    """
    if 0.0 <= beta < 1.0:
        return beta
    if beta >= 1.0:
        raise ValueError(
            f"beta = {beta:g} gives reaching the target the weight 1 - beta = {1.0 - beta:g}, "
            f"which is not positive; the paper's beta = 4 is the ratio beta / (1 - beta): "
            f"ask for beta = {BETA}"
        )
    raise ValueError(f"beta must be in [0, 1), got {beta:g}")
