"""Which packets are the vehicle's, and the address it speaks from."""

import math
from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.link.codec import Received
from companion.link.connection import Connection
from companion.link.transport import Peer
from companion.vehicle import EventKind, Severity, VehicleEvent

_SILENT_S = 2.0
"""A vehicle silent for this long at one address may be heard at another."""
_TELL_AGAIN_S = 1.0


class Route:
    """Tells the vehicle by its ids, and by its address as long as it speaks from one.

    Two vehicles with the same system id on one port must never be mixed; a vehicle that fell
    silent may come back from another address.
    """

    def __init__(
        self,
        connection: Connection,
        system_id: int,
        peer: Peer,
        tell: Callable[[VehicleEvent], None],
    ) -> None:
        """Send to ``peer`` from now on; ``tell`` is called about another vehicle of that id."""
        self._connection = connection
        self._sender = (system_id, dialect.MAV_COMP_ID_AUTOPILOT1)
        self._peer = peer
        self._tell = tell
        self._heard_s = -math.inf
        self._rival_told_s = -math.inf
        connection.reply_to(peer)

    def carries(self, peer: Peer, received: Received) -> bool:
        """Return whether the packet is the vehicle's; answers go where it came from."""
        if (received.system_id, received.component_id) != self._sender:
            return False
        now_s = received.time_s
        if peer != self._peer:
            if now_s - self._heard_s <= _SILENT_S:
                self._tell_rival(peer, now_s)
                return False
            self._peer = peer
            self._connection.reply_to(peer)
        self._heard_s = now_s
        return True

    def _tell_rival(self, peer: Peer, now_s: float) -> None:
        if now_s - self._rival_told_s < _TELL_AGAIN_S:
            return
        self._rival_told_s = now_s
        text = f"another vehicle with system id {self._sender[0]} speaks from {peer}; ignored"
        self._tell(VehicleEvent(now_s, EventKind.LINK_ERROR, text, Severity.CRITICAL))
