"""The parameters ArduCopter obeys or is asked for here, as they travel on the wire.

ArduPilot sends every value as a float, integers cast; PARAM_SET is taken whatever type it names,
and PARAM_VALUE answers with the type that the parameter has (recorded: FS_OPTIONS set with type
9, answered with type 6). An answer to a name has no index.
"""

import math
import struct

from sim.mock.parameters import NO_INDEX, Parameters

INT8, INT16, INT32, REAL32 = 2, 4, 6, 9
"""MAV_PARAM_TYPE."""

COPTER_DEFAULTS: dict[str, int | float] = {
    "ANGLE_MAX": 3000,
    "ARMING_CHECK": 1,
    "ATC_SLEW_YAW": 6000.0,
    "AVOID_ENABLE": 3,
    "AVOID_MARGIN": 2.0,
    "BATT_CAPACITY": 3300,
    "BATT_FS_LOW_ACT": 0,
    "BATT_LOW_MAH": 0.0,
    "BATT_LOW_VOLT": 10.5,
    "BRD_OPTIONS": 0,
    "DISARM_DELAY": 10,
    "EK3_ENABLE": 1,
    "FENCE_ACTION": 1,
    "FENCE_ALT_MAX": 100.0,
    "FENCE_ENABLE": 0,
    "FENCE_MARGIN": 2.0,
    "FENCE_RADIUS": 300.0,
    "FENCE_TYPE": 7,
    "FLTMODE1": 7,
    "FLTMODE2": 9,
    "FLTMODE3": 6,
    "FLTMODE4": 3,
    "FLTMODE5": 5,
    "FLTMODE6": 0,
    "FLTMODE_CH": 5,
    "FLTMODE_GCSBLOCK": 0,
    "FRAME_CLASS": 1,
    "FS_EKF_ACTION": 1,
    "FS_EKF_THRESH": 0.8,
    "FS_GCS_ENABLE": 0,
    "FS_GCS_TIMEOUT": 5.0,
    "FS_OPTIONS": 16,
    "FS_THR_ENABLE": 1,
    "GUID_OPTIONS": 0,
    "GUID_TIMEOUT": 3.0,
    "LAND_ALT_LOW": 1000,
    "LAND_SPEED": 50,
    "LAND_SPEED_HIGH": 0,
    "LOIT_SPEED": 1250.0,
    "PILOT_SPEED_DN": 0,
    "PILOT_SPEED_UP": 250,
    "RC_OVERRIDE_TIME": 3.0,
    "RTL_ALT": 1500,
    "RTL_ALT_FINAL": 0,
    "RTL_CONE_SLOPE": 3.0,
    "RTL_LOIT_TIME": 5000,
    "RTL_SPEED": 0,
    "PSC_VELXY_P": 2.0,
    "SCHED_LOOP_RATE": 400,
    "SERIAL0_PROTOCOL": 2,
    "SERIAL1_PROTOCOL": 2,
    "SERIAL2_PROTOCOL": 2,
    "SIM_GPS_DISABLE": 0,
    "SIM_SPEEDUP": 1.0,
    "SR0_EXTRA1": 0,
    "SR0_EXT_STAT": 0,
    "SR0_POSITION": 0,
    "SR1_EXTRA1": 0,
    "SR1_EXT_STAT": 0,
    "SR1_POSITION": 0,
    "SR2_EXTRA1": 0,
    "SR2_EXT_STAT": 0,
    "SR2_POSITION": 0,
    "SYSID_ENFORCE": 0,
    "SYSID_MYGCS": 255,
    "SYSID_THISMAV": 1,
    "WPNAV_ACCEL": 250.0,
    "WPNAV_ACCEL_Z": 100.0,
    "WPNAV_SPEED": 1000.0,
    "WPNAV_SPEED_DN": 150.0,
    "WPNAV_SPEED_UP": 250.0,
    "WP_YAW_BEHAVIOR": 2,
}
_SMALL = frozenset(
    {
        "AVOID_ENABLE", "BATT_FS_LOW_ACT", "DISARM_DELAY", "EK3_ENABLE",
        "FENCE_ACTION", "FENCE_ENABLE", "FENCE_TYPE", "FLTMODE1", "FLTMODE2", "FLTMODE3",
        "FLTMODE4", "FLTMODE5", "FLTMODE6", "FLTMODE_CH", "FRAME_CLASS", "SERIAL0_PROTOCOL",
        "SERIAL1_PROTOCOL", "SERIAL2_PROTOCOL", "SIM_GPS_DISABLE",
        "FS_EKF_ACTION", "FS_GCS_ENABLE", "FS_THR_ENABLE", "SYSID_ENFORCE", "WP_YAW_BEHAVIOR",
    }
)  # fmt: skip
_LARGE = frozenset(
    {"BATT_CAPACITY", "BRD_OPTIONS", "FLTMODE_GCSBLOCK", "FS_OPTIONS", "GUID_OPTIONS",
     "RTL_LOIT_TIME", "RTL_ALT", "ARMING_CHECK"}
)  # fmt: skip
_LIMITS = {INT8: 2**7, INT16: 2**15, INT32: 2**31}


class CopterParameters(Parameters):
    """A table of int8, int16, int32 and float32, all of which travel as floats."""

    def __init__(self, defaults: dict[str, int | float] = COPTER_DEFAULTS) -> None:
        super().__init__(defaults)

    def index_when_named(self, name: str) -> int:
        """Return 65535: an answer to a name has no index."""
        return NO_INDEX

    def wire_type(self, name: str) -> int | None:
        """Return MAV_PARAM_TYPE, ``None`` for a parameter that does not exist."""
        value = self._values.get(name)
        if not isinstance(value, int):
            return None if value is None else REAL32
        return INT8 if name in _SMALL else INT32 if name in _LARGE else INT16

    def wire_bytes(self, name: str) -> bytes:
        """Return PARAM_VALUE.param_value, cast to float."""
        return struct.pack("<f", self._values[name])

    def store(self, name: str, wire_type: int, raw: bytes) -> bool:
        """Take a value from PARAM_SET; an unknown name or a NaN changes nothing.

        Integers are rounded and kept within their type.

        Returns:
            Whether PARAM_VALUE answers.
        """
        (value,) = struct.unpack("<f", raw)
        own_type = self.wire_type(name)
        if own_type is None or not math.isfinite(value):
            return False
        if own_type == REAL32:
            self._values[name] = value
        else:
            limit = _LIMITS[own_type]
            self._values[name] = max(-limit, min(limit - 1, round(value)))
        return True
