"""ArduCopter's failsafes: what has tripped, what it says, and which mode it asks for."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from sim.mock.ardupilot.modes import Mode
from sim.mock.autopilot import CRITICAL, WARNING
from sim.mock.dynamics import Vector
from sim.mock.health import Battery
from sim.mock.parameters import Parameters

EKF_CHECK_S = 0.9
"""The estimator has to be bad, or good, for so long before the failsafe trips, or clears."""
GCS_CHECK_S = 0.1
"""How late the ground station's silence is noticed (measured: 5.1 s)."""
CONTINUE_IN_GUIDED = 4
"""Bit of FS_OPTIONS: a lost transmitter does not end GUIDED."""
FENCE_TOP, FENCE_CIRCLE = 1, 2
"""Bits of FENCE_TYPE."""

_FS_THR = {1: Mode.RTL, 3: Mode.LAND}
_FS_GCS = {1: Mode.RTL, 2: Mode.RTL, 5: Mode.LAND, 7: Mode.BRAKE}
_FS_EKF = {1: Mode.LAND, 2: Mode.ALT_HOLD, 3: Mode.LAND}
_BATT_LOW = {1: Mode.LAND, 2: Mode.RTL}
_FENCE = {1: Mode.RTL, 2: Mode.LAND, 4: Mode.BRAKE}


@dataclass(frozen=True, slots=True)
class Situation:
    """What the failsafes look at, once per step."""

    now_s: float
    mode: Mode
    position_good: bool
    battery: Battery
    position_m: Vector
    home_true_m: Vector | None


@dataclass(slots=True)
class Failsafes:
    """Those in force; what they say goes to ``say`` with its severity."""

    parameters: Parameters
    say: Callable[[int, str], None]
    radio: bool = False
    gcs: bool = False
    ekf: bool = False
    battery: bool = False
    fence: bool = False
    gcs_heard_s: float | None = None
    _ekf_wrong_since_s: float | None = None

    @property
    def tripped(self) -> list[str]:
        """The names of those that make the vehicle CRITICAL (A19)."""
        return [name for name in ("radio", "gcs", "ekf", "battery") if getattr(self, name)]

    def disarm(self) -> None:
        """Forget what a new flight begins without."""
        self.ekf = self.battery = self.fence = False
        self._ekf_wrong_since_s = None

    def lose_radio(self, *, lost: bool, mode: Mode) -> Mode | None:
        """Note that the transmitter falls silent or returns; return the mode to change to."""
        action = int(self.parameters.number("FS_THR_ENABLE"))
        if action == 0 or lost is self.radio:
            return None
        self.radio = lost
        self.say(WARNING, "Radio Failsafe" if lost else "Radio Failsafe Cleared")
        if not lost or (mode is Mode.GUIDED and self._option(CONTINUE_IN_GUIDED)):
            return None
        return _FS_THR.get(action, Mode.RTL)

    def update(self, situation: Situation) -> Mode | None:
        """Look at an armed vehicle; return the mode to change to, if one has just tripped."""
        wanted = (
            self._watch_ekf(situation),
            self._watch_gcs(situation),
            self._watch_battery(situation),
            self._watch_fence(situation),
        )
        return next((mode for mode in wanted if mode is not None), None)

    def _watch_gcs(self, situation: Situation) -> Mode | None:
        action = int(self.parameters.number("FS_GCS_ENABLE"))
        if action == 0 or self.gcs_heard_s is None:
            return None
        allowed_s = self.parameters.number("FS_GCS_TIMEOUT") + GCS_CHECK_S
        silent = situation.now_s - self.gcs_heard_s > allowed_s
        if silent is self.gcs:
            return None
        self.gcs = silent
        self.say(WARNING, "GCS Failsafe" if silent else "GCS Failsafe Cleared")
        return _FS_GCS.get(action, Mode.RTL) if silent else None

    def _watch_ekf(self, situation: Situation) -> Mode | None:
        if situation.position_good is not self.ekf:  # as it should be
            self._ekf_wrong_since_s = None
            return None
        if self._ekf_wrong_since_s is None:
            self._ekf_wrong_since_s = situation.now_s
        if situation.now_s - self._ekf_wrong_since_s < EKF_CHECK_S:
            return None
        self.ekf = not self.ekf
        self._ekf_wrong_since_s = None
        if not self.ekf:
            self.say(CRITICAL, "EKF Failsafe Cleared")
            return None
        self.say(CRITICAL, "EKF variance")
        mode = _FS_EKF.get(int(self.parameters.number("FS_EKF_ACTION")))
        if mode is None or not (situation.mode.requires_position or situation.mode is Mode.LAND):
            return None
        self.say(CRITICAL, f"EKF Failsafe: changed to {mode.name} Mode")
        return mode

    def _watch_battery(self, situation: Situation) -> Mode | None:
        low_mah = self.parameters.number("BATT_LOW_MAH")
        capacity_mah = self.parameters.number("BATT_CAPACITY")
        left_mah = situation.battery.fraction * capacity_mah
        if self.battery or left_mah >= low_mah:
            return None
        volts, used = situation.battery.voltage_v, capacity_mah - left_mah
        self.say(WARNING, f"Battery 1 is low {volts:.2f}V used {used:.0f} mAh")
        mode = _BATT_LOW.get(int(self.parameters.number("BATT_FS_LOW_ACT")))
        self.battery = mode is not None
        return mode

    def _watch_fence(self, situation: Situation) -> Mode | None:
        outside = self._outside_fence(situation)
        if outside is self.fence:
            return None
        self.fence = outside
        self.say(WARNING, "Fence breached" if outside else "Fence breach cleared")
        return _FENCE.get(int(self.parameters.number("FENCE_ACTION"))) if outside else None

    def _outside_fence(self, situation: Situation) -> bool:
        home = situation.home_true_m
        if home is None or not self.parameters.number("FENCE_ENABLE"):
            return False
        north, east, down = (
            here - there for here, there in zip(situation.position_m, home, strict=True)
        )
        kinds = int(self.parameters.number("FENCE_TYPE"))
        far = math.hypot(north, east) > self.parameters.number("FENCE_RADIUS")
        high = -down > self.parameters.number("FENCE_ALT_MAX")
        return bool((kinds & FENCE_CIRCLE and far) or (kinds & FENCE_TOP and high))

    def _option(self, bit: int) -> bool:
        return bool(int(self.parameters.number("FS_OPTIONS")) & bit)
