"""Messages that PX4 sends and pymavlink 2.4.50 has in no dialect it bundles by default.

A companion built on pymavlink gets them as ``UNKNOWN_290`` and must step over them; one built on
newer definitions can read them. Layouts and checksum seeds are those of the recorded packets.
"""

import struct
from typing import Any

from sim.mock.packet import Definition
from sim.mock.px4.commander import Px4
from sim.mock.telemetry import boot_us

ESC_INFO = Definition(290, crc_extra=251)
ESC_STATUS = Definition(291, crc_extra=10)
PROTOCOL_VERSION = Definition(300, crc_extra=217)
CURRENT_MODE = Definition(436, crc_extra=193)
MOTORS = 4


def esc_info(px4: Px4) -> Any:
    """ESC_INFO: four motors, all well."""
    fields = struct.pack(
        "<Q4IH4H4h4B",
        boot_us(px4),
        *(0,) * MOTORS,
        0,
        *(0,) * MOTORS,
        *(5000,) * MOTORS,
        0,
        4,
        0,
        15,
    )
    return ESC_INFO, fields


def esc_status(px4: Px4) -> Any:
    """ESC_STATUS: the speed of four motors."""
    rpm = 0 if not px4.armed else 2000 if px4.landed else 7100
    fields = struct.pack(
        "<Q4i4f4fB", boot_us(px4), *(rpm,) * MOTORS, *(0.0,) * MOTORS, *(0.0,) * MOTORS, 0
    )
    return ESC_STATUS, fields


def current_mode(px4: Px4) -> Any:
    """CURRENT_MODE: the mode that flies and the one that was asked for."""
    fields = struct.pack("<IIB", px4.mode.custom_mode, px4.intention.custom_mode, 0)
    return CURRENT_MODE, fields


def protocol_version(px4: Px4) -> Any:
    """PROTOCOL_VERSION: MAVLink 2, from 1 to 2; the hashes of the definitions say nothing."""
    fields = struct.pack("<3H16x", 200, 100, 200)
    return PROTOCOL_VERSION, fields
