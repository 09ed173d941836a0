"""A supervisor with a hand-driven vehicle in front of it, for its tests."""

from dataclasses import replace

import numpy as np

from companion.guidance.situation import Phase, Plan, Situation
from companion.guidance.supervisor import Supervisor
from companion.guidance.target import TargetTier
from companion.vehicle import (
    FlightMode,
    LandedState,
    RequestKind,
    RequestState,
    RequestStatus,
    SystemStatus,
    VehicleState,
)

TICK_S = 0.05
NAMES = {
    FlightMode.EXTERNAL: "OFFBOARD",
    FlightMode.HOLD: "AUTO.LOITER",
    FlightMode.TAKEOFF: "AUTO.TAKEOFF",
    FlightMode.LAND: "AUTO.LAND",
    FlightMode.RETURN: "AUTO.RTL",
    FlightMode.OTHER: "POSCTL",
}


class Bench:
    """A supervisor with a hand-driven vehicle in front of it."""

    def __init__(self, plan=None):
        self.now_s = 100.0
        self.asked = []
        self.supervisor = Supervisor(plan or Plan(), now_s=self.now_s)
        self.vehicle = VehicleState(
            time_s=self.now_s,
            position_ned_m=np.zeros(3),
            velocity_ned_mps=np.zeros(3),
            attitude_rad=np.zeros(3),
            heartbeat_time_s=self.now_s,
            mode=FlightMode.HOLD,
            mode_name="AUTO.LOITER",
            armed=False,
            landed=LandedState.ON_GROUND,
            system_status=SystemStatus.STANDBY,
            ready_to_arm=True,
            position_valid=True,
        )
        self.situation = Situation(
            now_s=self.now_s,
            vehicle=self.vehicle,
            request=RequestStatus(),
            target=TargetTier.FRESH,
            distance_m=50.0,
        )

    def set(self, **changes):
        """Change the vehicle's state; the mode's name follows the mode."""
        if "mode" in changes:
            changes.setdefault("mode_name", NAMES[changes["mode"]])
        self.vehicle = replace(self.vehicle, **changes)

    def tick(self, n=1, *, alive=True, **changes):
        """Let ``n`` ticks pass; return the last directive."""
        for _ in range(n):
            self.now_s += TICK_S
            if alive:
                self.set(time_s=self.now_s, heartbeat_time_s=self.now_s)
            self.situation = replace(
                self.situation, now_s=self.now_s, vehicle=self.vehicle, **changes
            )
            directive = self.supervisor.update(self.situation)
            if directive.request is not None:
                self.asked.append(directive.request)
                self.situation = replace(
                    self.situation,
                    request=RequestStatus(directive.request, RequestState.PENDING),
                )
        return directive

    def answer(self, state=RequestState.CONFIRMED, detail=""):
        kind = self.situation.request.kind
        self.situation = replace(self.situation, request=RequestStatus(kind, state, detail))

    def in_the_air(self, mode=FlightMode.HOLD):
        self.set(
            armed=True,
            landed=LandedState.IN_AIR,
            mode=mode,
            system_status=SystemStatus.ACTIVE,
        )
        return self

    def engaged(self):
        """Bring it to ENGAGED the way a pilot does."""
        self.in_the_air()
        self.tick(3)
        self.set(mode=FlightMode.EXTERNAL)
        assert self.tick().phase is Phase.ENGAGED
        return self


def climb(bench):
    """Walk a PX4 vehicle through arm, take-off and external mode; return the requests seen."""
    for _ in range(200):
        directive = bench.tick()
        if directive.request is None:
            continue
        bench.answer()
        if directive.request is RequestKind.ARM:
            bench.set(armed=True, system_status=SystemStatus.ACTIVE)
        elif directive.request is RequestKind.TAKEOFF:
            bench.set(mode=FlightMode.TAKEOFF, landed=LandedState.IN_AIR)
            bench.tick(40, height_m=10.0)
            bench.set(mode=FlightMode.HOLD)
            bench.situation = replace(bench.situation, height_m=19.5)
        elif directive.request is RequestKind.EXTERNAL:
            bench.set(mode=FlightMode.EXTERNAL)
    return bench.asked
