"""The shield behind a policy in evaluation: what flight makes of a wish at every tick."""

import numpy as np

from companion.arrays import Float32Array, FloatArray, IntArray
from companion.guidance.drift import DriftObserver
from companion.guidance.shield import Shield
from companion.guidance.shield_limits import ShieldLimits
from companion.policy.action import (
    action_to_velocity_mps,
    bearing_to_target_rad,
    polar_to_target_rad,
)
from sim.world import CityWorld


class Guard:
    """One shield for each world, as flight has one; told the estimates that flight would have."""

    def __init__(self, world: CityWorld, v_max_mps: float) -> None:
        limits = ShieldLimits(v_max_mps=v_max_mps, period_s=world.dt_s)
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
