"""Find the vehicle: exactly one autopilot, or the one that was named. Never the first heard.

A target, a ground station or a neighbour may well be heard first; latching onto it would fly the
wrong vehicle.
"""

import math
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.errors import AmbiguousVehicleError, LinkLostError, UsageError
from companion.link.autopilots import Autopilot, autopilot_of
from companion.link.codec import Received
from companion.link.connection import Connection
from companion.link.messages import heartbeat
from companion.link.transport import Peer
from companion.vehicle import SystemStatus

SECOND_AUTOPILOT_S = 1.5
"""How long to listen for another autopilot after the first: heartbeats come once a second."""
_HEARTBEAT_PERIOD_S = 1.0
_KEPT_PACKETS = 2000


@dataclass(frozen=True, slots=True)
class Found:
    """The vehicle, and what was heard while looking for it."""

    system_id: int
    autopilot: Autopilot
    peer: Peer
    heard: tuple[tuple[Peer, Received], ...]


def discover(
    connection: Connection,
    *,
    url: str,
    vehicle_sysid: int | None,
    target_sysids: Collection[int],
    timeout_s: float,
) -> Found:
    """Listen until the vehicle is known.

    Args:
        connection: Where to listen. Where the other side must hear of us first, our HEARTBEAT
            is sent once a second.
        url: For messages.
        vehicle_sysid: Which vehicle; ``None`` for the only one.
        target_sysids: Systems that are targets, and so never the vehicle.
        timeout_s: How long to wait for the first autopilot.

    Raises:
        UsageError: If the vehicle is named as a target too.
        AmbiguousVehicleError: If two autopilots are heard and none was named, or two with the
            same id.
        LinkLostError: If no autopilot, or not the named one, is heard in time.
        RefusedError: If its firmware or kind is not one the companion flies.
    """
    if vehicle_sysid is not None and vehicle_sysid in target_sysids:
        raise UsageError(
            f"system id {vehicle_sysid} is both vehicle and target; give the target another"
        )
    search = _Search(vehicle_sysid, target_sysids)
    deadline_s = connection.now() + timeout_s
    next_heartbeat_s = connection.now() if connection.speaks_first else math.inf
    while True:
        now_s = connection.now()
        if now_s >= next_heartbeat_s:
            connection.send(heartbeat(SystemStatus.BOOT))
            next_heartbeat_s = now_s + _HEARTBEAT_PERIOD_S
        for peer, received in connection.receive():
            search.take(peer, received, connection)
        end_s = search.decided_s if search.decided_s is not None else deadline_s
        if connection.now() >= end_s:
            break
        if connection.drained:
            connection.wait(min(end_s, next_heartbeat_s) - connection.now())
    return search.result(connection, url, timeout_s)


class _Search:
    def __init__(self, vehicle_sysid: int | None, target_sysids: Collection[int]) -> None:
        self._wanted = vehicle_sysid
        self._targets = target_sysids
        self._autopilots: dict[int, tuple[int, int]] = {}
        self._peers: dict[int, set[Peer]] = {}
        self._senders: set[tuple[int, int]] = set()
        self._heard: deque[tuple[Peer, Received]] = deque(maxlen=_KEPT_PACKETS)
        self.decided_s: float | None = None
        """When enough has been heard; ``None`` while there is nobody."""

    def take(self, peer: Peer, received: Received, connection: Connection) -> None:
        """Take in one packet."""
        self._heard.append((peer, received))
        self._senders.add((received.system_id, received.component_id))
        if (
            received.message_id != dialect.MAVLINK_MSG_ID_HEARTBEAT
            or received.component_id != dialect.MAV_COMP_ID_AUTOPILOT1
        ):
            return
        message = connection.codec.decode(received)
        if (
            message is None
            or message.autopilot == dialect.MAV_AUTOPILOT_INVALID
            or message.type == dialect.MAV_TYPE_GCS
        ):
            return
        system_id = received.system_id
        self._autopilots[system_id] = (message.autopilot, message.type)
        self._peers.setdefault(system_id, set()).add(peer)
        if system_id == self._wanted:
            self.decided_s = received.time_s
        elif self._wanted is None and self.decided_s is None and system_id not in self._targets:
            self.decided_s = received.time_s + SECOND_AUTOPILOT_S

    def result(self, connection: Connection, url: str, timeout_s: float) -> Found:
        """Name the vehicle, or say why there is none."""
        candidates = sorted(set(self._autopilots) - set(self._targets))
        if self._wanted is not None:
            candidates = [system_id for system_id in candidates if system_id == self._wanted]
        if len(candidates) > 1:
            listed = ", ".join(map(str, candidates))
            raise AmbiguousVehicleError(
                f"more than one autopilot on {url}: system ids {listed}; choose with "
                f"--vehicle-sysid, e.g. --vehicle-sysid {candidates[0]}"
            )
        if not candidates:
            raise self._nobody(connection, url, timeout_s)
        system_id = candidates[0]
        peers = self._peers[system_id]
        if len(peers) > 1:
            listed = " and ".join(sorted(map(str, peers)))
            raise AmbiguousVehicleError(
                f"system id {system_id} is heard from {listed} on {url}: give the vehicles ids of "
                "their own, or each a port"
            )
        autopilot = autopilot_of(*self._autopilots[system_id])
        return Found(system_id, autopilot, next(iter(peers)), tuple(self._heard))

    def _nobody(
        self, connection: Connection, url: str, timeout_s: float
    ) -> LinkLostError | UsageError:
        waited = f"within {timeout_s:g} s"
        signing = connection.signing
        if not self._autopilots and signing is not None and connection.packets_refused:
            return LinkLostError(
                f"no autopilot that signs with this key heard on {url} {waited}; packets dropped: "
                f"{signing.refused_in_words()}; same key on both sides, and both clocks right?"
            )
        if self._autopilots and self._wanted is not None:
            listed = ", ".join(map(str, sorted(self._autopilots)))
            return LinkLostError(
                f"vehicle {self._wanted} not heard on {url} {waited}; heard the autopilots of "
                f"system ids {listed}"
            )
        if self._autopilots:
            listed = ", ".join(map(str, sorted(self._autopilots)))
            return UsageError(
                f"the only autopilots on {url} are targets: system ids {listed}; a vehicle "
                "cannot be its own target"
            )
        if self._senders:
            senders = sorted(self._senders)[:8]
            listed = ", ".join(f"{system}/{component}" for system, component in senders)
            return LinkLostError(
                f"no autopilot heard on {url} {waited}; MAVLink comes only from {listed}"
            )
        if connection.bytes_received:
            return LinkLostError(
                f"{connection.bytes_received} bytes came on {url} {waited}, but no MAVLink in "
                "them; wrong baud rate, or not a MAVLink port?"
            )
        return LinkLostError(
            f"no autopilot heard on {url} {waited}; is it running, and does it send there?"
        )
