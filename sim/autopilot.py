"""The modes of a simulated autopilot: what it accepts, what velocity it wants, its failsafe.

After PX4 as far as a companion can tell: external mode needs setpoints younger than a second;
without them a failsafe returns the vehicle, and ends by itself when the stream comes back,
unless somebody chose a mode meanwhile.
"""

import numpy as np

from companion.arrays import FloatArray
from companion.vehicle import FlightMode, RequestKind, RequestState, RequestStatus

TAKEOFF_MPS = 1.5
"""PX4's MPC_TKO_SPEED."""
LAND_MPS = 0.7
"""PX4's MPC_LAND_SPEED."""
RETURN_MPS = 5.0
"""PX4's MPC_XY_CRUISE."""
RETURN_HEIGHT_M = 30.0
"""Above the place of take-off: PX4's RTL_RETURN_ALT on SITL."""
RETURN_NEAR_M = 10.0
"""PX4's RTL_MIN_DIST: closer than this it does not climb first."""
LANDED_DISARM_S = 2.0
"""PX4's COM_DISARM_LAND."""

_WORDS = {
    FlightMode.EXTERNAL: "OFFBOARD",
    FlightMode.HOLD: "AUTO.LOITER",
    FlightMode.TAKEOFF: "AUTO.TAKEOFF",
    FlightMode.LAND: "AUTO.LAND",
    FlightMode.RETURN: "AUTO.RTL",
    FlightMode.OTHER: "POSCTL",
}
_MODES = {
    RequestKind.TAKEOFF: FlightMode.TAKEOFF,
    RequestKind.EXTERNAL: FlightMode.EXTERNAL,
    RequestKind.HOLD: FlightMode.HOLD,
    RequestKind.LAND: FlightMode.LAND,
    RequestKind.RETURN: FlightMode.RETURN,
}


class Autopilot:
    """Modes, arming and setpoints of one vehicle. Positions are map ENU.

    Args:
        home_enu_m: The place of take-off, shape ``(3,)``.
        airborne: Start armed and in the air.
        setpoint_timeout_s: PX4's COM_OF_LOSS_T.
        on_setpoint_loss: The mode of the failsafe.
    """

    def __init__(
        self,
        home_enu_m: FloatArray,
        *,
        airborne: bool,
        setpoint_timeout_s: float,
        on_setpoint_loss: FlightMode,
    ) -> None:
        self._home_enu_m = home_enu_m
        self._timeout_s = setpoint_timeout_s
        self._on_setpoint_loss = on_setpoint_loss
        self._setpoint_enu_mps: FloatArray = np.zeros(3)
        self._setpoint_time_s = -np.inf
        self._mode_since_s = 0.0
        self._landed_since_s = 0.0
        self._climb_m = 0.0
        self.mode = FlightMode.HOLD
        self.armed = airborne
        self.landed = not airborne
        self.in_failsafe = False
        self.request_status = RequestStatus()

    @property
    def mode_name(self) -> str:
        """Return PX4's word for the mode."""
        return _WORDS[self.mode]

    def ready_to_arm(self, now_s: float) -> bool:
        """Return whether arming would be accepted."""
        return self.mode is not FlightMode.EXTERNAL or self._has_stream(now_s)

    def take_setpoint(self, velocity_enu_mps: FloatArray, now_s: float) -> None:
        """Accept a velocity; it counts as a sign of life in every mode."""
        self._setpoint_enu_mps = velocity_enu_mps
        self._setpoint_time_s = now_s

    def request(self, kind: RequestKind, altitude_m: float | None) -> None:
        """Take a request; ``update`` decides on it."""
        self.request_status = RequestStatus(kind, RequestState.PENDING)
        if altitude_m is not None:
            self._climb_m = altitude_m

    def choose(self, mode: FlightMode, now_s: float) -> None:
        """Enter a mode because somebody chose it; that ends a failsafe for good."""
        self.mode = mode
        self._mode_since_s = now_s
        self.in_failsafe = False

    def touch_down(self, now_s: float) -> None:
        """Take note that the vehicle stands."""
        self.landed = True
        self._landed_since_s = now_s

    def update(self, now_s: float) -> bool:
        """Decide on requests, the failsafe and disarming; return whether a failsafe began."""
        if self.request_status.state is RequestState.PENDING:
            self._answer(now_s)
        if self.landed and self.armed and self.mode in (FlightMode.LAND, FlightMode.RETURN):
            self.armed = now_s - self._landed_since_s < LANDED_DISARM_S
        if self.in_failsafe and self._has_stream(now_s):
            self.choose(FlightMode.EXTERNAL, now_s)
        silent = now_s - max(self._setpoint_time_s, self._mode_since_s) > self._timeout_s
        if self.mode is FlightMode.EXTERNAL and self.armed and silent:
            self.choose(self._on_setpoint_loss, now_s)
            self.in_failsafe = True
            return True
        return False

    def wanted_velocity_enu_mps(self, position_enu_m: FloatArray, now_s: float) -> FloatArray:
        """Return the velocity that the mode asks for at ``position_enu_m``, shape ``(3,)``."""
        if not self.armed:
            return np.zeros(3)
        if self.mode is FlightMode.EXTERNAL:
            return self._setpoint_enu_mps if self._has_stream(now_s) else np.zeros(3)
        if self.mode is FlightMode.TAKEOFF:
            return self._climb(position_enu_m, now_s)
        if self.mode is FlightMode.LAND:
            return np.array((0.0, 0.0, -LAND_MPS))
        if self.mode is FlightMode.RETURN:
            return self._return(position_enu_m)
        return np.zeros(3)

    def _has_stream(self, now_s: float) -> bool:
        return bool(now_s - self._setpoint_time_s <= self._timeout_s)

    def _answer(self, now_s: float) -> None:
        kind = self.request_status.kind
        refusal = ""
        if kind is RequestKind.ARM and not self.ready_to_arm(now_s):
            refusal = "TEMPORARILY_REJECTED: Resolve system health failures first"
        elif kind is RequestKind.EXTERNAL and self.armed and not self._has_stream(now_s):
            refusal = "TEMPORARILY_REJECTED: Switching to Offboard is currently not available"
        elif kind is RequestKind.TAKEOFF and not self.armed:
            refusal = "TEMPORARILY_REJECTED: not armed"
        elif kind is RequestKind.DISARM and not self.landed:
            refusal = "TEMPORARILY_REJECTED: not landed"
        if refusal:
            self.request_status = RequestStatus(kind, RequestState.REJECTED, refusal)
            return
        if kind in (RequestKind.ARM, RequestKind.DISARM):
            self.armed = kind is RequestKind.ARM
        elif kind is not None:
            self.choose(_MODES[kind], now_s)
        self.request_status = RequestStatus(kind, RequestState.CONFIRMED, "ACCEPTED")

    def _climb(self, position_enu_m: FloatArray, now_s: float) -> FloatArray:
        missing_m = self._home_enu_m[2] + self._climb_m - position_enu_m[2]
        if missing_m < 0.1:
            self.choose(FlightMode.HOLD, now_s)
            return np.zeros(3)
        return np.array((0.0, 0.0, min(TAKEOFF_MPS, missing_m + 0.1)))

    def _return(self, position_enu_m: FloatArray) -> FloatArray:
        to_home_enu_m = self._home_enu_m - position_enu_m
        away_m = float(np.hypot(to_home_enu_m[0], to_home_enu_m[1]))
        if away_m < 0.5:
            return np.array((0.0, 0.0, -LAND_MPS))
        if away_m > RETURN_NEAR_M and -to_home_enu_m[2] < RETURN_HEIGHT_M - 0.5:
            return np.array((0.0, 0.0, RETURN_MPS))
        speed_mps = min(RETURN_MPS, away_m)
        east_mps, north_mps = to_home_enu_m[:2] / away_m * speed_mps
        return np.array((east_mps, north_mps, 0.0))
