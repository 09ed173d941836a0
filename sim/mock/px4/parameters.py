"""The parameters the PX4 personality obeys or is asked for, as they travel on the wire.

PX4 sends an integer parameter byte-wise: the four bytes of the int32 stand where the float
should be (MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE). Going through a Python float would
change bit patterns that look like signalling NaNs, so raw bytes are kept all the way.
"""

import math
import struct
import zlib

from sim.mock.parameters import NO_INDEX, Parameters

MAV_PARAM_TYPE_UINT32 = 5
MAV_PARAM_TYPE_INT32 = 6
MAV_PARAM_TYPE_REAL32 = 9

HASH_NAME = "_HASH_CHECK"

PX4_DEFAULTS: dict[str, int | float] = {
    "BAT1_N_CELLS": 4,
    "BAT_CRIT_THR": 0.07,
    "BAT_EMERGEN_THR": 0.05,
    "BAT_LOW_THR": 0.15,
    "COM_ARM_WO_GPS": 1,
    "COM_DISARM_LAND": 2.0,
    "COM_DISARM_PRFLT": 10.0,
    "COM_DL_LOSS_T": 10,
    "COM_FAIL_ACT_T": 5.0,
    "COM_FLTMODE1": -1,
    "COM_LOW_BAT_ACT": 3,
    "COM_OBL_RC_ACT": 0,
    "COM_OF_LOSS_T": 1.0,
    "COM_RCL_EXCEPT": 0,
    "COM_RC_IN_MODE": 1,
    "COM_RC_LOSS_T": 0.5,
    "COM_SPOOLUP_TIME": 1.0,
    "EKF2_HGT_REF": 1,
    "GF_ACTION": 2,
    "GF_MAX_HOR_DIST": 0.0,
    "GF_MAX_VER_DIST": 0.0,
    "MAN_OVERRIDE_SPD": 1.0,
    "MAV_COMP_ID": 1,
    "MAV_SYS_ID": 1,
    "MAV_TYPE": 2,
    "MIS_TAKEOFF_ALT": 2.5,
    "MPC_ACC_DOWN_MAX": 3.0,
    "MPC_ACC_HOR": 3.0,
    "MPC_ACC_HOR_MAX": 5.0,
    "MPC_ACC_UP_MAX": 4.0,
    "MPC_JERK_AUTO": 4.0,
    "MPC_LAND_SPEED": 0.7,
    "MPC_TKO_RAMP_T": 3.0,
    "MPC_TKO_SPEED": 1.5,
    "MPC_VEL_MANUAL": 10.0,
    "MPC_XY_CRUISE": 5.0,
    "MPC_XY_P": 0.95,
    "MPC_XY_VEL_MAX": 12.0,
    "MPC_Z_P": 1.0,
    "MPC_Z_VEL_MAX_DN": 1.5,
    "MPC_Z_VEL_MAX_UP": 3.0,
    "MPC_Z_V_AUTO_DN": 1.5,
    "MPC_Z_V_AUTO_UP": 3.0,
    "NAV_DLL_ACT": 0,
    "NAV_RCL_ACT": 2,
    "RTL_DESCEND_ALT": 30.0,
    "RTL_MIN_DIST": 10.0,
    "RTL_RETURN_ALT": 30.0,
    "SYS_AUTOSTART": 10040,
}


class Px4Parameters(Parameters):
    """A table of int32 and float32."""

    def __init__(self, defaults: dict[str, int | float] = PX4_DEFAULTS) -> None:
        super().__init__(defaults)

    def index_of(self, name: str) -> int:
        """Return the index of a parameter that exists; the hash has none."""
        return NO_INDEX if name == HASH_NAME else super().index_of(name)

    def index_when_named(self, name: str) -> int:
        """Return the same index as in the list."""
        return self.index_of(name)

    def wire_type(self, name: str) -> int | None:
        """Return MAV_PARAM_TYPE, ``None`` for a parameter that does not exist."""
        if name == HASH_NAME:
            return MAV_PARAM_TYPE_UINT32
        if name not in self._values:
            return None
        is_int = isinstance(self._values[name], int)
        return MAV_PARAM_TYPE_INT32 if is_int else MAV_PARAM_TYPE_REAL32

    def wire_bytes(self, name: str) -> bytes:
        """Return the four bytes of PARAM_VALUE.param_value."""
        if name == HASH_NAME:
            return struct.pack("<I", self._hash())
        value = self._values[name]
        return struct.pack("<i" if isinstance(value, int) else "<f", value)

    def store(self, name: str, wire_type: int, raw: bytes) -> bool:
        """Take a value from PARAM_SET; an unknown name, a wrong type or a NaN changes nothing.

        Returns:
            Whether the value was stored.
        """
        if name == HASH_NAME or self.wire_type(name) != wire_type:
            return False
        (value,) = struct.unpack("<i" if wire_type == MAV_PARAM_TYPE_INT32 else "<f", raw)
        if not math.isfinite(value):
            return False
        self._values[name] = value
        return True

    def _hash(self) -> int:
        crc = 0
        for name in self._names:
            crc = zlib.crc32(self.wire_bytes(name), zlib.crc32(name.encode(), crc))
        return crc
