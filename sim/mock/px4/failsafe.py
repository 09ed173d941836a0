"""Which failsafe PX4 puts between the operator's wish and the motors (``failsafe.cpp``)."""

import math
from dataclasses import dataclass, field
from enum import Enum

from sim.mock.dynamics import Vector
from sim.mock.parameters import Parameters
from sim.mock.px4.modes import Mode

_NAV_RCL_ACT = {1: Mode.LOITER, 2: Mode.RTL, 3: Mode.LAND}
_COM_OBL_RC_ACT = {
    0: Mode.POSCTL,
    1: Mode.ALTCTL,
    2: Mode.STABILIZED,
    3: Mode.RTL,
    4: Mode.LAND,
    5: Mode.LOITER,
}
_GF_ACTION = {2: Mode.LOITER, 3: Mode.RTL, 5: Mode.LAND}
EXCEPT_OFFBOARD = 4
EXCEPT_HOLD = 2


class Cause(Enum):
    """Why a failsafe acts; the order is its rank."""

    POSITION_LOST = "position lost"
    BATTERY = "battery"
    GEOFENCE = "geofence"
    PILOT_LOST = "manual control lost"
    SETPOINTS_LOST = "setpoints lost"


@dataclass(frozen=True, slots=True)
class Situation:
    """What the failsafe looks at, once per step."""

    now_s: float
    intention: Mode
    position_valid: bool
    setpoints_fresh: bool
    pilot_present: bool
    battery_fraction: float
    fence_breached: bool


@dataclass(slots=True)
class Failsafe:
    """The failsafe in force, if any."""

    cause: Cause | None = None
    mode: Mode | None = None
    _pilot_expected: bool = False
    _since_s: float = 0.0
    _overruled: set[Cause] = field(default_factory=set)

    @property
    def rests(self) -> bool:
        """Whether nothing acts, and nothing was overruled."""
        return self.cause is None and not self._overruled

    def expects(self, *, pilot_present: bool) -> bool:
        """Note whether the pilot is there; return whether that is as it should be."""
        self._pilot_expected |= pilot_present
        return pilot_present or not self._pilot_expected

    def arm(self, *, pilot_present: bool) -> None:
        """Start afresh: manual control absent at arming is not missed later."""
        self.clear()
        self._pilot_expected = pilot_present

    def clear(self) -> None:
        """Forget everything, as on disarming."""
        self.cause = self.mode = None
        self._overruled.clear()

    def overrule(self) -> None:
        """Note that somebody chose a mode: the causes at hand no longer act until they clear."""
        if self.cause is not None:
            self._overruled.add(self.cause)
        self.cause = self.mode = None

    def update(self, situation: Situation, parameters: Parameters) -> None:
        """Decide anew. ``mode`` is ``None`` when the intention stands."""
        self._pilot_expected |= situation.pilot_present
        present = self._causes(situation, parameters)
        if not present and self.cause is None:
            self._overruled.clear()
            return
        self._overruled &= present.keys()
        causes = [cause for cause in Cause if cause in present and cause not in self._overruled]
        latched = self.cause is Cause.PILOT_LOST and self.mode in (Mode.RTL, Mode.LAND)
        if not causes:
            if not latched:  # the return after RC loss ends with a mode change or disarming only
                self.cause = self.mode = None
            return
        if causes[0] is not self.cause:
            self._since_s = situation.now_s
        self.cause = causes[0]
        self.mode = present[self.cause]
        if self.cause is Cause.PILOT_LOST and not latched:
            waiting = situation.now_s - self._since_s < parameters.number("COM_FAIL_ACT_T")
            self.mode = Mode.LOITER if waiting else self.mode

    def _causes(self, situation: Situation, parameters: Parameters) -> dict[Cause, Mode]:
        causes: dict[Cause, Mode] = {}
        intention = situation.intention
        if not situation.position_valid and intention is not Mode.LAND:
            causes[Cause.POSITION_LOST] = Mode.LAND
        action = int(parameters.number("COM_LOW_BAT_ACT"))
        if action == 3 and situation.battery_fraction < parameters.number("BAT_EMERGEN_THR"):
            causes[Cause.BATTERY] = Mode.LAND
        elif action >= 2 and situation.battery_fraction < parameters.number("BAT_CRIT_THR"):
            causes[Cause.BATTERY] = Mode.LAND if action == 2 else Mode.RTL
        fence = _GF_ACTION.get(int(parameters.number("GF_ACTION")))
        if situation.fence_breached and fence is not None and intention is not Mode.LAND:
            causes[Cause.GEOFENCE] = fence
        without_pilot = _NAV_RCL_ACT.get(int(parameters.number("NAV_RCL_ACT")))
        excepted = int(parameters.number("COM_RCL_EXCEPT")) & (
            EXCEPT_OFFBOARD if intention is Mode.OFFBOARD else EXCEPT_HOLD
        )
        if (
            self._pilot_expected
            and not situation.pilot_present
            and not excepted
            and without_pilot is not None
        ):
            causes[Cause.PILOT_LOST] = without_pilot
        if intention is Mode.OFFBOARD and not situation.setpoints_fresh:
            mode = _COM_OBL_RC_ACT.get(int(parameters.number("COM_OBL_RC_ACT")), Mode.LAND)
            if mode.needs_pilot and not situation.pilot_present:
                mode = without_pilot or Mode.LOITER
            causes[Cause.SETPOINTS_LOST] = mode
        return causes


def fence_breached(parameters: Parameters, position_m: Vector, home_m: Vector | None) -> bool:
    """Return whether the vehicle is outside GF_MAX_HOR_DIST or GF_MAX_VER_DIST of home."""
    reach_m, top_m = parameters.number("GF_MAX_HOR_DIST"), parameters.number("GF_MAX_VER_DIST")
    if home_m is None or (reach_m <= 0.0 and top_m <= 0.0):
        return False
    north, east, down = (here - home for here, home in zip(position_m, home_m, strict=True))
    too_far = 0.0 < reach_m < math.hypot(north, east)
    return too_far or 0.0 < top_m < -down
