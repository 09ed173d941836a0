"""A link of ArduCopter: HEARTBEAT alone until somebody asks, texts to everybody."""

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock import telemetry
from sim.mock.ardupilot.streams import BUILDERS, members
from sim.mock.autopilot import Autopilot
from sim.mock.channel import TEXT_CHUNK, Channel, Port

HEARTBEAT_HZ = 1.0
FIRST_HEARTBEAT_S = 1.04
TIMESYNC_S = 10.0


class CopterChannel(Channel):
    """A link between ArduCopter and whoever is at the other end; all ports are alike."""

    def __init__(self, port: Port) -> None:
        self._rates: dict[int, float] = {}
        super().__init__(BUILDERS, self._rates, port)
        self._timesync_due_s = TIMESYNC_S

    def hear_gcs(self, now_s: float) -> None:
        """Note a heartbeat of a ground station: that changes nothing on this link."""

    def request_stream(self, stream: int, rate_hz: float, now_s: float) -> None:
        """Handle REQUEST_DATA_STREAM: all members get the rate, whatever they had (A21)."""
        for id_ in members(stream):
            self._rates[id_] = rate_hz
            self._set_rate(id_, rate_hz, now_s)

    def tell(self, now_s: float, texts: list[tuple[int, str]]) -> None:
        """Queue texts; only one that needs chunks has a number."""
        for severity, text in texts:
            data = text.encode()
            if len(data) <= TEXT_CHUNK:
                self.send(mavlink.MAVLink_statustext_message(severity, data, 0, 0))
                continue
            for message in self._statustext(severity, data):
                self.send(message)

    def restart(self, boot_s: float) -> None:
        """Begin as after power-up: what was asked for is forgotten."""
        self._rates.clear()
        self._rates[mavlink.MAVLINK_MSG_ID_HEARTBEAT] = HEARTBEAT_HZ
        super().restart(boot_s)
        first_s = min(FIRST_HEARTBEAT_S, 0.025 * boot_s)
        self._due_s[mavlink.MAVLINK_MSG_ID_HEARTBEAT] = first_s
        self._timesync_due_s = TIMESYNC_S
        self.shown_mode = None

    def show_changes(self, autopilot: Autopilot) -> None:
        """Queue HEARTBEAT at once if the mode has changed; arming waits for its turn."""
        if self.shown_mode is not None and self.shown_mode is not autopilot.mode:
            self._send_stream(mavlink.MAVLINK_MSG_ID_HEARTBEAT, autopilot)

    def _send_others(self, autopilot: Autopilot) -> None:
        self.show_changes(autopilot)
        if autopilot.home_count != self._home_sent and autopilot.home_true_m is not None:
            self._home_sent = autopilot.home_count
            self._send_stream(mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN, autopilot)
            self._send_stream(mavlink.MAVLINK_MSG_ID_HOME_POSITION, autopilot)
        if autopilot.now_s >= self._timesync_due_s:
            self._timesync_due_s = (math.floor(autopilot.now_s / TIMESYNC_S) + 1.0) * TIMESYNC_S
            self.send(telemetry.timesync(autopilot))
