"""What the vehicle does if this program dies, and how far it flies blind until then.

Everything is read off the vehicle's own parameters; a parameter that did not answer has its
documented default and is named as assumed. Nothing here, or anywhere, writes one.

Blind travel is ``v * (loss + reaction) + v^2 / (2 * brake)``: on at the last velocity until the
autopilot misses the setpoints, then to a stop. It agrees with what was measured from the last
setpoint on: 12.1 m from 3.07 m/s (ArduCopter 4.6.3), 4.8 m from 2.54 m/s (PX4 1.18).
"""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

REACTION_S = 0.1
"""From the autopilot's time-out to the first loss of speed: 0.05 s seen on ArduCopter 4.6.3,
0.1 s fits PX4 1.18."""
BRAKE_SEEN_MPS2 = 1.6
"""Braking seen at the end of a stream, 1.5 to 1.7 on both; a lower limit of the vehicle wins."""

Number = int | float
_Version = tuple[int | float, ...]

PX4_DEFAULTS: Mapping[str, Number] = {
    "COM_OF_LOSS_T": 1.0,
    "COM_OBL_RC_ACT": 0,
    "NAV_RCL_ACT": 2,
    "COM_RCL_EXCEPT": 0,
    "COM_RC_IN_MODE": 3,
    "RTL_RETURN_ALT": 60.0,
    "MPC_XY_VEL_MAX": 12.0,
    "MPC_ACC_HOR": 3.0,
    "GF_ACTION": 2,
}
"""PX4's parameters that matter here, with the defaults of its documentation."""

ARDUPILOT_DEFAULTS: Mapping[str, Number] = {
    "GUID_TIMEOUT": 3.0,
    "FS_GCS_ENABLE": 0,
    "FS_GCS_TIMEOUT": 5.0,
    "RTL_ALT": 1500,
    "WPNAV_SPEED": 1000.0,
    "WPNAV_ACCEL": 250.0,
    "FENCE_ENABLE": 0,
    "FENCE_ACTION": 1,
}
"""ArduCopter's parameters that matter here, with the defaults of its documentation."""

_ARDUPILOT_MIN_TIMEOUT_S = 0.1

_GIVES_STICKS = {0: "Position", 1: "Altitude", 2: "Stabilized"}
_NO_STICKS = 4  # COM_RC_IN_MODE: stick input disabled
_PX4_LOOKS_FOR_STICKS = (1, 18)
"""Older ones enter the mode of COM_OBL_RC_ACT even where no transmitter is (their #27408): Position
mode finds no sticks and comes down, as flown on 1.16.0; 1.18 does what NAV_RCL_ACT says."""
_EXCEPT_OFFBOARD = 1 << 2
_RETURN = "climbs to {height:g} m above home, flies back and lands"
_LAND = "lands where it is"
_HOLD = "holds where it is until somebody takes it"
_COMES_DOWN = "comes down where it is and lands"
_TERMINATE = "TERMINATES: the motors stop and it falls"
_DISARM = "DISARMS: the motors stop and it falls"
_PX4_OFFBOARD_LOSS = {3: _RETURN, 4: _LAND, 5: _HOLD, 6: _TERMINATE, 7: _DISARM}
_PX4_PILOT_LOSS = {1: _HOLD, 2: _RETURN, 3: _LAND, 5: _TERMINATE, 6: _DISARM}
_PX4_FENCE = {
    0: "nothing happens",
    1: "it only warns",
    2: "it holds",
    3: "it returns",
    4: "it TERMINATES",
    5: "it lands",
}
_ARDUPILOT_GCS_LOSS = {
    1: "it returns and lands",
    2: "it returns and lands",
    3: "it returns the way it came, or straight",
    4: "it returns the way it came, or lands",
    5: "it lands",
    6: "it flies its landing sequence, or returns",
    7: "it brakes, or lands",
}
_ARDUPILOT_FENCE = {
    0: "it only reports",
    1: "it returns, or lands",
    2: "it lands",
    3: "it returns the way it came, or straight, or lands",
    4: "it brakes, or lands",
    5: "it returns the way it came, or lands",
}


@dataclass(frozen=True, slots=True)
class Failsafe:
    """What the vehicle does without us."""

    autopilot: str
    """As people write it: ``PX4``, ``ArduPilot``."""
    loss_s: float
    """How long it obeys the last setpoint (COM_OF_LOSS_T, GUID_TIMEOUT)."""
    then: str
    """What it does after that, in words."""
    notes: tuple[str, ...]
    """What else of its failsafes matters to a flight of ours."""
    speed_limit_mps: float
    """Its own (MPC_XY_VEL_MAX, WPNAV_SPEED)."""
    brake_mps2: float
    assumed: tuple[str, ...]
    """Parameters that did not answer or made no sense; their defaults were taken."""

    @property
    def sentence(self) -> str:
        """Return what happens if this program dies."""
        return (
            f"if this program dies, {self.autopilot} flies on for {self.loss_s:.1f} s, "
            f"then {self.then}"
        )

    def blind_travel_m(self, speed_mps: float) -> float:
        """Return how far the vehicle flies without us from ``speed_mps`` until it has stopped."""
        speed_mps = min(speed_mps, self.speed_limit_mps)
        return speed_mps * self._on_s + speed_mps**2 / (2.0 * self.brake_mps2)

    def v_max_safe_mps(self, margin_m: float) -> float:
        """Return the speed whose blind travel is ``margin_m``."""
        rolling_mps = self.brake_mps2 * self._on_s
        return math.sqrt(rolling_mps**2 + 2.0 * self.brake_mps2 * margin_m) - rolling_mps

    def cap(self, v_max_mps: float, margin_m: float, *, obey: bool) -> "SpeedCap":
        """Compare blind travel with the margin, and keep it within if it is to be obeyed."""
        safe_mps, travel_m = self.v_max_safe_mps(margin_m), self.blind_travel_m(v_max_mps)
        if travel_m <= margin_m:
            words = f"blind travel at {v_max_mps:.2g} m/s is {travel_m:.1f} m, within the margin"
            return SpeedCap(v_max_mps, exceeds=False, words=words)
        both = (
            f"blind travel at {v_max_mps:.2g} m/s is {travel_m:.1f} m; "
            f"{safe_mps:.2g} m/s would keep it within the margin of {margin_m:g} m"
        )
        if not obey:
            return SpeedCap(v_max_mps, exceeds=True, words=f"{both} (--cap-by-failsafe)")
        words = f"v_max lowered from {v_max_mps:.2g} to {safe_mps:.2g} m/s: {both}"
        return SpeedCap(safe_mps, exceeds=False, words=words)

    @property
    def _on_s(self) -> float:
        return self.loss_s + REACTION_S


@dataclass(frozen=True, slots=True)
class SpeedCap:
    """The speed to fly with."""

    v_max_mps: float
    exceeds: bool
    """Whether blind travel at that speed leaves the margin."""
    words: str
    """Blind travel and safe speed, for people."""


def parameters_wanted(autopilot: str) -> tuple[str, ...]:
    """Return the names of what ``failsafe_of`` looks at; ``autopilot`` as in VehicleInfo."""
    return tuple(_FIRMWARES[autopilot][0])


def failsafe_of(autopilot: str, parameters: Mapping[str, Number], version: str = "") -> Failsafe:
    """Return what the vehicle does without us.

    Args:
        autopilot: As in VehicleInfo: ``px4`` or ``ardupilot``.
        parameters: What the vehicle answered; whatever is missing, not finite or below zero is
            assumed to have its documented default.
        version: As in VehicleInfo; one that is not known is taken for the newest.
    """
    defaults, explain = _FIRMWARES[autopilot]
    believed = {name: value for name, value in parameters.items() if _is_believable(value)}
    assumed = tuple(name for name in defaults if name not in believed)
    return explain({**defaults, **believed}, assumed, _numbers(version))


def _is_believable(value: Number) -> bool:
    return math.isfinite(value) and value >= 0


def _numbers(version: str) -> _Version:
    """Return ``1.16.0`` as numbers, an unknown version as later than any."""
    numbers = tuple(int(part) for part in re.findall(r"\d+", version)[:3])
    return numbers or (math.inf,)


def _px4(parameters: Mapping[str, Number], assumed: tuple[str, ...], version: _Version) -> Failsafe:
    def word(table: Mapping[int, str], name: str) -> str:
        known = table.get(int(parameters[name]), f"does what {name} {parameters[name]} means")
        return known.format(height=parameters["RTL_RETURN_ALT"])

    without_pilot = word(_PX4_PILOT_LOSS, "NAV_RCL_ACT")
    sticks = _GIVES_STICKS.get(int(parameters["COM_OBL_RC_ACT"]))
    alone = without_pilot
    if version < _PX4_LOOKS_FOR_STICKS:
        alone = _COMES_DOWN
        if sticks == "Stabilized":
            alone = "is in Stabilized mode with nobody at the sticks"
    if sticks is None:
        then = word(_PX4_OFFBOARD_LOSS, "COM_OBL_RC_ACT")
    elif int(parameters["COM_RC_IN_MODE"]) == _NO_STICKS:
        then = alone
    else:
        then = f"{alone} (with a pilot's transmitter: {sticks} mode, the sticks fly)"
    lost_pilot = f"it {without_pilot}"
    if int(parameters["COM_RCL_EXCEPT"]) & _EXCEPT_OFFBOARD:
        lost_pilot = "it flies on in OFFBOARD (COM_RCL_EXCEPT)"
    return Failsafe(
        autopilot="PX4",
        loss_s=float(parameters["COM_OF_LOSS_T"]),
        then=then,
        notes=(
            f"if the pilot's transmitter is lost in flight, {lost_pilot}",
            f"at PX4's own geofence {word(_PX4_FENCE, 'GF_ACTION')}",
        ),
        speed_limit_mps=float(parameters["MPC_XY_VEL_MAX"] or PX4_DEFAULTS["MPC_XY_VEL_MAX"]),
        brake_mps2=_brake_mps2(float(parameters["MPC_ACC_HOR"])),
        assumed=assumed,
    )


def _ardupilot(
    parameters: Mapping[str, Number], assumed: tuple[str, ...], _version: _Version
) -> Failsafe:
    gcs, fence = int(parameters["FS_GCS_ENABLE"]), int(parameters["FENCE_ACTION"])
    no_gcs = "nothing happens (FS_GCS_ENABLE 0)"
    if gcs:
        no_gcs = _ARDUPILOT_GCS_LOSS.get(gcs, f"it does what FS_GCS_ENABLE {gcs} means")
        no_gcs += f" after {parameters['FS_GCS_TIMEOUT']:g} s"
    at_fence = "nothing happens (FENCE_ENABLE 0)"
    if parameters["FENCE_ENABLE"]:
        at_fence = _ARDUPILOT_FENCE.get(fence, f"it does what FENCE_ACTION {fence} means")
    return Failsafe(
        autopilot="ArduPilot",
        loss_s=max(_ARDUPILOT_MIN_TIMEOUT_S, float(parameters["GUID_TIMEOUT"])),
        then="hovers in GUIDED until a person or a low battery ends it; nothing tells of it",
        notes=(
            f"if the ground station is lost, {no_gcs}",
            f"at ArduPilot's own fence {at_fence}",
            f"a return climbs to {float(parameters['RTL_ALT']) / 100:g} m above home",
        ),
        speed_limit_mps=float(parameters["WPNAV_SPEED"] or ARDUPILOT_DEFAULTS["WPNAV_SPEED"]) / 100,
        brake_mps2=_brake_mps2(float(parameters["WPNAV_ACCEL"]) / 100),
        assumed=assumed,
    )


def _brake_mps2(limit_mps2: float) -> float:
    """Return the braking to reckon with; 0 in a parameter means the firmware's own choice."""
    return min(limit_mps2, BRAKE_SEEN_MPS2) or BRAKE_SEEN_MPS2


_Explain = Callable[[Mapping[str, Number], tuple[str, ...], _Version], Failsafe]
_FIRMWARES: Mapping[str, tuple[Mapping[str, Number], _Explain]] = {
    "px4": (PX4_DEFAULTS, _px4),
    "ardupilot": (ARDUPILOT_DEFAULTS, _ardupilot),
}
