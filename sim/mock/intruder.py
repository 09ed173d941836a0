"""A second companion that nobody invited: it streams setpoints to the same autopilot."""

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock.setpoints import MAV_FRAME_LOCAL_NED

VELOCITY_ONLY = 0xDC7
PERIOD_S = 0.1


class Intruder:
    """A companion of the vehicle's own system that flies north at 10 Hz and has a heartbeat.

    Args:
        system: Its system id and that of the vehicle.
        component: Its component id.
        speed_mps: What it asks for.
        start_s: When it begins.
    """

    def __init__(self, system: int, component: int, speed_mps: float, start_s: float) -> None:
        self._codec: Any = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
        self._system = system
        self._speed_mps = speed_mps
        self._start_s = self._due_s = self._heartbeat_due_s = start_s

    def tick(self, now_s: float) -> list[bytes]:
        """Return the packets that are due."""
        packets = []
        if now_s >= self._heartbeat_due_s - 1e-9:
            self._heartbeat_due_s += 1.0
            kind, autopilot = mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID
            packets.append(
                self._pack(mavlink.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 4, 3))
            )
        if now_s >= self._due_s - 1e-9:
            self._due_s += PERIOD_S
            clock_ms = round((now_s - self._start_s) * 1e3)
            packets.append(
                self._pack(
                    mavlink.MAVLink_set_position_target_local_ned_message(
                        clock_ms, self._system, 1, MAV_FRAME_LOCAL_NED, VELOCITY_ONLY,
                        0.0, 0.0, 0.0, self._speed_mps, *(0.0,) * 7,
                    )
                )
            )  # fmt: skip
        return packets

    def _pack(self, message: Any) -> bytes:
        packet: bytes = message.pack(self._codec)
        self._codec.seq = (self._codec.seq + 1) % 256
        return packet
