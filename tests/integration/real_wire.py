"""The wire between the companion and a real autopilot: seen, cut, and with a pilot on it.

One URL is enough: a pilot, system 255, speaks over the same link, as behind a router. What the
autopilot is told and what it answers is kept with the time at which it passed.
"""

import contextlib
import math
import queue
import select
import socket
import threading
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.errors import LinkLostError, LinkOpenError
from companion.link.address import parse_url
from companion.link.transport import open_transport

PILOT = (255, 190)
VEHICLE_COMPONENT = 1
LOOPBACK = "127.0.0.1"
SETPOINTS = ("SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT")
LOOKED_AT = {
    getattr(dialect, f"MAVLINK_MSG_ID_{name}")
    for name in (
        "HEARTBEAT", "SYS_STATUS", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "COMMAND_ACK",
        "COMMAND_LONG", "PARAM_REQUEST_READ", "TIMESYNC", *SETPOINTS,
    )
}  # fmt: skip
"""Only these are decoded: PX4 sends 420 messages a second. All of them are passed on."""
MODES = {
    dialect.MAV_AUTOPILOT_PX4: {"external": (6, 0), "hold": (4, 3), "land": (4, 6)},
    dialect.MAV_AUTOPILOT_ARDUPILOTMEGA: {"external": (4, 0), "hold": (17, 0), "land": (9, 0)},
}
"""Main and sub mode; on ArduPilot hold is BRAKE."""
RECONNECT_S = 0.5
RESTING_MPS = 0.3


@dataclass(frozen=True, slots=True)
class Passed:
    """One message that passed."""

    time_s: float
    message: Any


class RealWire(threading.Thread):
    """Passes frames between a real autopilot and the companion, and lets a pilot speak."""

    def __init__(self, url):
        super().__init__(daemon=True)
        self._address = parse_url(url)
        self._transport = open_transport(self._address)
        self._listening = threading.Event()
        self._over = threading.Event()
        self._pilot = dialect.MAVLink(None, *PILOT)
        self._to_say = queue.SimpleQueue()
        self._newest = {}
        self._back = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._back.bind((LOOPBACK, 0))
        self._companion = None
        self._frames = [_Frames(), _Frames()]
        self.cut = False
        """Whether nothing passes between autopilot and companion; the pilot's link stays."""
        self.of_vehicle = []
        self.of_companion = []
        self.system_id = None
        self.autopilot = None

    # -- the wire ------------------------------------------------------------------------------

    def lead_to(self, port):
        """Let the companion on this port be the one at the other end; forget what passed."""
        self._companion = (LOOPBACK, port)
        self.of_vehicle, self.of_companion, self.cut = [], [], False

    def run(self):
        heartbeat_s = 0.0
        while not self._over.is_set():
            ready, _, _ = select.select([self._transport, self._back], [], [], 0.02)
            if self._back in ready:
                self._take_from_companion()
            if self._transport in ready:
                self._take_from_vehicle()
            while not self._to_say.empty():
                self._transport.send(self._to_say.get())
            if time.monotonic() >= heartbeat_s and self.system_id is not None:
                heartbeat_s = time.monotonic() + 1.0
                self.say(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))

    def _take_from_companion(self):
        with contextlib.suppress(ConnectionError):
            for frame in self._frames[1].take(self._back.recv(65536)):
                if not self.cut:
                    self._transport.send(frame)
                    self.of_companion.append(Passed(time.monotonic(), _decoded(frame)))

    def _take_from_vehicle(self):
        try:
            chunks = self._transport.receive()
        except LinkLostError:
            self._reconnect()
            return
        for peer, data in chunks:
            self._transport.reply_to(peer)
            frames = self._frames[0].take(data)
            if self._companion is not None and not self.cut:
                with contextlib.suppress(OSError):
                    self._back.sendto(b"".join(frames), self._companion)
            for frame in frames:
                if frame[5] == PILOT[0] or frame[6] != VEHICLE_COMPONENT:
                    continue
                if int.from_bytes(frame[7:10], "little") in LOOKED_AT:
                    with contextlib.suppress(dialect.MAVError):  # bad bytes at connecting
                        self._take(_decoded(frame))

    def _take(self, message):
        if message.get_type() == "HEARTBEAT" and self.system_id is None:
            self.system_id, self.autopilot = message.get_srcSystem(), message.autopilot
        passed = Passed(time.monotonic(), message)
        self._newest[message.get_type()] = passed
        self.of_vehicle.append(passed)

    def _reconnect(self):
        self._transport.close()
        while not self._over.wait(RECONNECT_S):
            with contextlib.suppress(LinkOpenError):
                self._transport = open_transport(self._address)
                return

    def close(self):
        self._over.set()
        self.join()
        self._transport.close()
        self._back.close()

    # -- who looks ------------------------------------------------------------------------------

    def newest(self, name):
        """Return the newest message of the autopilot by name, ``None`` before the first."""
        passed = self._newest.get(name)
        return None if passed is None else passed.message

    def heard(self, name, since_s=0.0):
        found = []
        for each in reversed(list(self.of_vehicle)):
            if each.time_s < since_s:
                break
            if each.message.get_type() == name:
                found.append(each)
        return found[::-1]

    def setpoints(self, since_s=0.0):
        """Return the companion's setpoints that passed."""
        return [each for each in list(self.of_companion) if each.time_s >= since_s
                and each.message.get_type() in SETPOINTS]  # fmt: skip

    @property
    def battery_percent(self):
        return self.newest("SYS_STATUS").battery_remaining

    @property
    def armed(self):
        return bool(self.newest("HEARTBEAT").base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)

    @property
    def mode(self):
        """Main and sub mode as in ``MODES``."""
        return self._mode_of(self.newest("HEARTBEAT"))

    def _mode_of(self, heartbeat):
        number = heartbeat.custom_mode
        if self.autopilot == dialect.MAV_AUTOPILOT_PX4:
            return number >> 16 & 0xFF, number >> 24 & 0xFF
        return number, 0

    def is_in(self, name):
        return self.mode == MODES[self.autopilot][name]

    @property
    def position_ned_m(self):
        seen = self.newest("LOCAL_POSITION_NED")
        return np.array((seen.x, seen.y, seen.z))

    @property
    def speed_mps(self):
        seen = self.newest("LOCAL_POSITION_NED")
        return math.hypot(seen.vx, seen.vy, seen.vz)

    def left_mode_s(self, name):
        """Return when a HEARTBEAT first showed another mode after this one, ``inf`` if none."""
        seen_it = False
        for passed in self.heard("HEARTBEAT"):
            is_it = self._mode_of(passed.message) == MODES[self.autopilot][name]
            if seen_it and not is_it:
                return passed.time_s
            seen_it |= is_it
        return math.inf

    @staticmethod
    def wait(until, timeout_s=30.0, what=""):
        end_s = time.monotonic() + timeout_s
        while not until():
            assert time.monotonic() < end_s, what or "it did not happen"
            time.sleep(0.02)
        return time.monotonic()

    # -- who flies ------------------------------------------------------------------------------

    def say(self, message, sender=PILOT):
        """Send a message to the autopilot as the pilot, or as somebody else."""
        self._to_say.put(self._packed(message, sender))

    def tell_companion(self, message, sender=PILOT):
        """Send a message to the companion as if it had come by the autopilot's link."""
        self._back.sendto(self._packed(message, sender), self._companion)

    def _packed(self, message, sender):
        self._pilot.srcSystem, self._pilot.srcComponent = sender
        frame = message.pack(self._pilot)
        self._pilot.seq = (self._pilot.seq + 1) % 256
        return bytes(frame)

    def command(self, number, *params):
        """Send a command as the pilot until it is acknowledged; return the result."""
        params = (*params, *(0.0,) * (7 - len(params)))
        asked_s = time.monotonic()

        def answers():
            return [each.message.result for each in self.heard("COMMAND_ACK", asked_s)
                    if each.message.command == number
                    and each.message.target_system in (0, PILOT[0])]  # fmt: skip

        for attempt in range(3):
            self.say(
                dialect.MAVLink_command_long_message(
                    self.system_id, VEHICLE_COMPONENT, number, attempt, *params
                )
            )
            with contextlib.suppress(AssertionError):
                self.wait(answers, 1.5)
                return answers()[-1]
        raise AssertionError(f"no answer to command {number}")

    def set_mode(self, name):
        return self.command(dialect.MAV_CMD_DO_SET_MODE, 1.0, *MODES[self.autopilot][name])

    def take_off(self, altitude_m=12.0):
        """Arm, climb, and wait there in the autopilot's own hold, nobody streaming."""
        is_px4 = self.autopilot == dialect.MAV_AUTOPILOT_PX4
        assert self.set_mode("hold" if is_px4 else "external") == 0
        self.wait(lambda: self.command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == 0, 90.0)
        start_m = self.position_ned_m[2]
        height_m, here = altitude_m, 0.0
        if is_px4:
            height_m, here = self.newest("GLOBAL_POSITION_INT").alt / 1e3 + altitude_m, math.nan
        params = (0.0, 0.0, 0.0, here, here, here, height_m)
        assert self.command(dialect.MAV_CMD_NAV_TAKEOFF, *params) == 0
        self.wait(lambda: start_m - self.position_ned_m[2] > altitude_m - 1.5, 40.0, "no climb")
        self.wait(lambda: self.speed_mps < RESTING_MPS, 20.0, "never at rest")
        assert self.set_mode("hold") == 0
        self.wait(lambda: self.is_in("hold"), 3.0)

    def land(self):
        """Land where it is and wait until it is disarmed."""
        if self.armed:
            self.set_mode("land")
            self.wait(lambda: not self.armed, 90.0, "it did not land")
        self._leave_external()

    def _leave_external(self):
        """PX4 on the ground is back in OFFBOARD if it was flown there: not to be armed in."""
        if self.autopilot == dialect.MAV_AUTOPILOT_PX4 and not self.armed:
            assert self.set_mode("hold") == 0

    def listen(self):
        """Ask for what this wire looks at, and wait until the autopilot may be armed."""
        self.wait(lambda: self.system_id is not None, 20.0, "no autopilot is heard")
        self._leave_external()
        for number, rate_hz in ((32, 20), (33, 4), (1, 2), (245, 4), (85, 10)):
            self.command(dialect.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e6 / rate_hz)

        def ready():
            status, position = self.newest("SYS_STATUS"), self.newest("LOCAL_POSITION_NED")
            checks = dialect.MAV_SYS_STATUS_PREARM_CHECK
            return None not in (status, position) and status.onboard_control_sensors_health & checks

        self.wait(ready, 90.0, "the autopilot's pre-arm checks do not pass")


class _Frames:
    """Cuts MAVLink 2 frames out of bytes; what is neither is skipped."""

    def __init__(self):
        self._rest = b""

    def take(self, data):
        frames, data = [], self._rest + data
        while (at := data.find(0xFD)) >= 0:
            data = data[at:]
            signature = 13 if len(data) > 2 and data[2] & 1 else 0
            if len(data) < 2 or len(data) < (size := 12 + data[1] + signature):
                break
            frames.append(data[:size])
            data = data[size:]
        self._rest = data if at >= 0 else b""
        return frames


def _decoded(frame):
    return dialect.MAVLink(None).decode(bytearray(frame))
