"""The messages we send, built from values. Pure; every number is named where it is not plain."""

import math
import struct

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.arrays import FloatArray
from companion.computer import Computer
from companion.link.autopilots import Command
from companion.vehicle import SystemStatus

VELOCITY_ONLY = 3527
"""POSITION_TARGET_TYPEMASK: velocity obeyed; position, acceleration, yaw, yaw rate ignored."""
VELOCITY_AND_YAW = 2503
"""POSITION_TARGET_TYPEMASK: velocity and yaw obeyed, the rest ignored."""

_FASTEST_MPS = 1000.0
"""ArduPilot stops the vehicle on a component beyond this."""

_AUTOPILOT = dialect.MAV_COMP_ID_AUTOPILOT1
_NO_BYTES = bytes(8)
_V2_HEADER_BYTES = 10
_VELOCITY_END = 28  # in the payload of SET_POSITION_TARGET_LOCAL_NED


def heartbeat(status: SystemStatus) -> dialect.MAVLink_heartbeat_message:
    """Return our HEARTBEAT: an onboard controller, never a ground station."""
    return dialect.MAVLink_heartbeat_message(
        type=dialect.MAV_TYPE_ONBOARD_CONTROLLER,
        autopilot=dialect.MAV_AUTOPILOT_INVALID,
        base_mode=0,
        custom_mode=0,
        system_status=int(status),
        mavlink_version=3,
    )


def velocity_setpoint(
    system_id: int, velocity_ned_mps: FloatArray, yaw_rad: float | None, *, time_boot_ms: int
) -> dialect.MAVLink_set_position_target_local_ned_message:
    """Return SET_POSITION_TARGET_LOCAL_NED with all three axes of velocity.

    Both firmwares obey frame LOCAL_NED with these masks. ArduPilot stops on a NaN, PX4 lets the
    axis go: so neither is ever sent.

    Raises:
        ValueError: If the velocity is not of shape ``(3,)`` or out of all bounds, or anything
            is not finite.
    """
    if velocity_ned_mps.shape != (3,):
        raise ValueError(f"a velocity has shape (3,), got {velocity_ned_mps.shape}")
    north_mps, east_mps, down_mps = map(float, velocity_ned_mps)
    if not all(abs(mps) <= _FASTEST_MPS for mps in (north_mps, east_mps, down_mps)):
        raise ValueError(
            f"a velocity must be finite and within {_FASTEST_MPS:g} m/s, got {velocity_ned_mps}"
        )
    if yaw_rad is not None and not math.isfinite(yaw_rad):
        raise ValueError(f"a yaw must be finite, got {yaw_rad}")
    return dialect.MAVLink_set_position_target_local_ned_message(
        time_boot_ms=time_boot_ms,
        target_system=system_id,
        target_component=_AUTOPILOT,
        coordinate_frame=dialect.MAV_FRAME_LOCAL_NED,
        type_mask=VELOCITY_ONLY if yaw_rad is None else VELOCITY_AND_YAW,
        x=0.0,
        y=0.0,
        z=0.0,
        vx=north_mps,
        vy=east_mps,
        vz=down_mps,
        afx=0.0,
        afy=0.0,
        afz=0.0,
        yaw=0.0 if yaw_rad is None else yaw_rad,
        yaw_rate=0.0,
    )


def velocity_of(frame: bytes) -> FloatArray | None:
    """Return the velocity of a frame of ``velocity_setpoint``, ``None`` for any other frame."""
    message_id = dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED
    if len(frame) < _V2_HEADER_BYTES or int.from_bytes(frame[7:10], "little") != message_id:
        return None
    # zeros at the end of a payload are not sent
    payload = frame[_V2_HEADER_BYTES : _V2_HEADER_BYTES + frame[1]].ljust(_VELOCITY_END, b"\0")
    north_east_down = struct.unpack_from("<3f", payload, _VELOCITY_END - 12)
    return np.array(north_east_down, dtype=np.float64)


def computer_status(
    computer: Computer, since_start_ms: int
) -> dialect.MAVLink_onboard_computer_status_message:
    """Return ONBOARD_COMPUTER_STATUS: load, heat and memory of the computer we run on."""
    no_number, no_temperature, no_fan = 0xFFFFFFFF, 127, 32767
    return dialect.MAVLink_onboard_computer_status_message(
        time_usec=since_start_ms * 1000,
        uptime=since_start_ms & 0xFFFFFFFF,
        type=0,
        cpu_cores=computer.core_percent,
        cpu_combined=[255] * 10,
        gpu_cores=[255] * 4,
        gpu_combined=[255] * 10,
        temperature_board=computer.celsius,
        temperature_core=[computer.celsius] + [no_temperature] * 7,
        fan_speed=[no_fan] * 4,
        ram_usage=computer.ram_used_mib,
        ram_total=computer.ram_total_mib,
        storage_type=[no_number] * 4,
        storage_usage=[no_number] * 4,
        storage_total=[no_number] * 4,
        link_type=[no_number] * 6,
        link_tx_rate=[no_number] * 6,
        link_rx_rate=[no_number] * 6,
        link_tx_max=[no_number] * 6,
        link_rx_max=[no_number] * 6,
    )


def command_long(
    system_id: int, command: Command, confirmation: int = 0
) -> dialect.MAVLink_command_long_message:
    """Return ``command`` for the autopilot of ``system_id``."""
    return dialect.MAVLink_command_long_message(
        system_id, _AUTOPILOT, command.number, confirmation, *command.params
    )


def request_message(system_id: int, message_id: int) -> dialect.MAVLink_command_long_message:
    """Ask for one message, once."""
    params = (float(message_id), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    return command_long(system_id, Command(dialect.MAV_CMD_REQUEST_MESSAGE, params))


def set_message_interval(
    system_id: int, message_id: int, rate_hz: float
) -> dialect.MAVLink_command_long_message:
    """Ask for a message again and again; no parameter of the vehicle changes by it."""
    params = (float(message_id), 1e6 / rate_hz, 0.0, 0.0, 0.0, 0.0, 0.0)
    return command_long(system_id, Command(dialect.MAV_CMD_SET_MESSAGE_INTERVAL, params))


def command_ack(
    command: int, result: int, system_id: int, component_id: int
) -> dialect.MAVLink_command_ack_message:
    """Answer a command that ``system_id`` sent us."""
    return dialect.MAVLink_command_ack_message(
        command, result, target_system=system_id, target_component=component_id
    )


def own_version() -> dialect.MAVLink_autopilot_version_message:
    """Return AUTOPILOT_VERSION of a companion: it takes COMMAND_INT and speaks MAVLink 2."""
    return dialect.MAVLink_autopilot_version_message(
        capabilities=dialect.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        | dialect.MAV_PROTOCOL_CAPABILITY_MAVLINK2,
        flight_sw_version=0,
        middleware_sw_version=0,
        os_sw_version=0,
        board_version=0,
        flight_custom_version=_NO_BYTES,
        middleware_custom_version=_NO_BYTES,
        os_custom_version=_NO_BYTES,
        vendor_id=0,
        product_id=0,
        uid=0,
    )


def timesync_reply(asked_ns: int, now_ns: int) -> dialect.MAVLink_timesync_message:
    """Answer a TIMESYNC: when it was sent by their clock, and now by ours."""
    return dialect.MAVLink_timesync_message(tc1=now_ns, ts1=asked_ns)


def read_param(system_id: int, name: str) -> dialect.MAVLink_param_request_read_message:
    """Ask for one parameter by name."""
    return dialect.MAVLink_param_request_read_message(
        system_id, _AUTOPILOT, name.encode("ascii"), param_index=-1
    )
