"""The setpoints that GUIDED follows: the newest one, and how long it is good for."""

import math
from dataclasses import dataclass

from sim.mock.ardupilot.flight import Flight, Guided
from sim.mock.ardupilot.ground import Ground
from sim.mock.dynamics import ZERO
from sim.mock.estimator import Estimator
from sim.mock.parameters import Parameters
from sim.mock.setpoints import Setpoint

SHORTEST_TIMEOUT_S = 0.1


@dataclass(slots=True)
class Steering:
    """Turns setpoints into what ``flight`` does in GUIDED."""

    flight: Flight
    ground: Ground
    estimator: Estimator
    parameters: Parameters
    setpoint: Setpoint | None = None
    _received_s: float = -math.inf

    def follow(self, now_s: float, setpoint: Setpoint | None) -> None:
        """Begin to follow a setpoint, whatever GUIDED did before: a take-off ends (A9).

        Args:
            now_s: Time.
            setpoint: ``None`` is one that made no sense: it stops the vehicle.
        """
        self.setpoint, self._received_s = setpoint, now_s
        if self.flight.guided is Guided.TAKEOFF:
            self.ground.cancel_take_off()
            self.flight.hold_true_m = None
        if setpoint is None:
            self.flight.stop()
        else:
            has_position = all(map(math.isfinite, setpoint.position_m))
            self.flight.guided = Guided.POSITION if has_position else Guided.VELOCITY

    def steer(self, now_s: float) -> None:
        """Hand the newest setpoint to the flight; an old velocity or turn rate is zero (A6)."""
        setpoint = self.setpoint
        if setpoint is None or self.flight.guided is Guided.TAKEOFF:
            return
        timeout_s = max(SHORTEST_TIMEOUT_S, self.parameters.number("GUID_TIMEOUT"))
        fresh = now_s - self._received_s <= timeout_s
        finite = all(map(math.isfinite, setpoint.velocity_mps))
        self.flight.velocity_mps = setpoint.velocity_mps if fresh and finite else ZERO
        if self.flight.velocity_mps != ZERO:
            self.flight.hold_true_m = None
        if self.flight.guided is Guided.POSITION:
            self.flight.target_true_m = self.estimator.to_true(setpoint.position_m)
        if not fresh and math.isfinite(setpoint.yaw_rate_radps):
            self.setpoint = Setpoint(setpoint.position_m, setpoint.velocity_mps)
