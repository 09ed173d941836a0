"""What an actor is measured against in the control loop: policies that nobody had to train.

Like the actor they know the estimate, not the truth, and like it they fly with any map. Straight
at the target, the floor, is ``evaluate.fly_straight``.
"""

from dataclasses import dataclass

import numpy as np

from companion.arrays import Float32Array, FloatArray
from companion.policy.action import (
    bearing_to_target_rad,
    displacement_to_action,
    polar_to_target_rad,
)
from sim.world import CityWorld
from training.evaluate import Policy

SLOW_M = 5.0
"""Nearer to the target than this, speed falls with the distance, as autopilots' own position
controllers let it."""
_TOUCH_M = 1e-3
_FAR_M = 1e6
"""Where there are no obstacles, their surface is infinitely far away."""


def fly_the_way(world: CityWorld, observation: Float32Array) -> FloatArray:
    """Fly at the aim: planner plus tracking, and no learning.

    The aim is the farthest point in sight on the shortest way over the map's grid, what layout
    ``ways`` shows the actor; in worlds of other layouts it is the target.
    """
    position_m = world.estimate_enu_m
    return _toward(world, _unit(world.aim_enu_m - position_m) * _speed_share(world))


@dataclass(frozen=True, slots=True)
class PotentialField:
    """An artificial potential field on the signed distance to the obstacles.

    Khatib, *Real-Time Obstacle Avoidance for Manipulators and Mobile Robots* (IJRR 1986): the
    target attracts, the nearest surface repels within ``influence_m`` by
    ``eta (1/d - 1/influence) / d**2``. As in Ge and Cui, *New Potential Functions for Mobile
    Robot Path Planning* (IEEE T-RA 2000), repulsion fades with the squared distance to the target,
    here from ``SLOW_M`` on: else a target beside a wall could not be reached. The gradient is flown
    as a velocity, at full speed where its length is 1.

    The two lengths completed most of 150 cases on validation cities of those that were tried:
    8, 12 and 16 m, and 3 to 6 m; of two that completed as many, the one with shorter ways.
    """

    influence_m: float = 12.0
    balance_m: float = 4.0
    """Where repulsion is as strong as the attraction of a target far away; it fixes eta."""

    def __call__(self, world: CityWorld, observation: Float32Array) -> FloatArray:
        """Return the actions of one step, ``(N, 3)``."""
        position_m = world.estimate_enu_m
        share = _speed_share(world)
        attraction = _unit(world.known_target_enu_m - position_m) * share
        away_m = np.clip(position_m - world.nearest_surface(position_m), -_FAR_M, _FAR_M)
        distance_m = np.maximum(_length(away_m), _TOUCH_M)
        eta = self.balance_m**2 / (1.0 / self.balance_m - 1.0 / self.influence_m)
        strength = eta * np.maximum(1.0 / distance_m - 1.0 / self.influence_m, 0.0) / distance_m**2
        repulsion = strength * share**2 * away_m / distance_m
        field = attraction + repulsion
        return _toward(world, field / np.maximum(_length(field), 1.0))


BASELINES: dict[str, Policy] = {"planner": fly_the_way, "potential_field": PotentialField()}
"""By name; all of them need a world whose layout shows the way."""


def _speed_share(world: CityWorld) -> FloatArray:
    """Return what share of full speed is flown at this distance from the target, ``(N, 1)``."""
    left_m = _length(world.known_target_enu_m - world.estimate_enu_m)
    return np.minimum(left_m / SLOW_M, 1.0)


def _toward(world: CityWorld, velocity_share: FloatArray) -> FloatArray:
    """Return the actions for velocities ``(N, 3)`` as shares of full speed."""
    longest_m = world.scaling.rho_max * world.edge_m
    seen_from_m, aim_m = world.estimate_enu_m, world.aim_enu_m
    return displacement_to_action(
        longest_m * velocity_share,
        world.scaling,
        world.edge_m,
        bearing_to_target_rad(seen_from_m, aim_m),
        polar_to_target_rad(seen_from_m, aim_m),
    )


def _unit(vector: FloatArray) -> FloatArray:
    return vector / np.maximum(_length(vector), 1e-9)


def _length(vector: FloatArray) -> FloatArray:
    """Return lengths, shape ``(N, 1)``."""
    length: FloatArray = np.sqrt(np.square(vector).sum(axis=1, keepdims=True))
    return length
