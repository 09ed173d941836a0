"""A transport with its codec: packets in and messages out, every frame of both seen by a tap.

Where the link is signed, packets that are not are dropped here, and the tap never sees them:
what is recorded is what was acted upon.
"""

from collections.abc import Callable
from typing import Any

from companion.link.codec import Codec, Parser, Received
from companion.link.signing import Signing
from companion.link.transport import READS_AT_ONCE, Peer, Transport

Tap = Callable[[bool, float, bytes], None]
"""Called with ``(sent, time_s, frame)`` for every complete frame of both directions."""

_LATE_S = 0.1
"""Packets may have lain in the kernel this long before their age is doubted."""
_MAX_PEERS = 64
"""Beyond this the peer heard first is forgotten: anybody can send us UDP."""


class Connection:
    """Packets of all peers of one transport; messages of one sender."""

    def __init__(
        self,
        transport: Transport,
        codec: Codec,
        now: Callable[[], float],
        tap: Tap | None = None,
        signing: Signing | None = None,
    ) -> None:
        self.codec = codec
        self.now = now
        self.signing = signing
        self._transport = transport
        self._tap = tap
        self._parsers: dict[Peer, Parser] = {}
        self._drained_s = now()
        self.drained = False
        """Whether the last ``receive`` took all that was there."""
        self.punctual = True
        """Whether the last ``receive`` stamped packets with the time of reading."""

    @property
    def speaks_first(self) -> bool:
        """Whether the other side hears of us only if we send first."""
        return self._transport.speaks_first

    @property
    def send_errors(self) -> int:
        """Packets that could not be sent."""
        return self._transport.send_errors

    @property
    def bytes_received(self) -> int:
        """All bytes of all peers."""
        return sum(parser.bytes_received for parser in self._parsers.values())

    @property
    def bytes_bad(self) -> int:
        """Bytes that belong to no valid packet."""
        return sum(parser.bytes_bad for parser in self._parsers.values())

    @property
    def packets_refused(self) -> int:
        """Packets of all peers that a signed link dropped."""
        return 0 if self.signing is None else sum(self.signing.refused.values())

    def packets_lost(self, system_id: int, component_id: int) -> int:
        """Return the gaps in one sender's sequence numbers."""
        sender = (system_id, component_id)
        return sum(parser.packets_lost.get(sender, 0) for parser in self._parsers.values())

    def wait(self, timeout_s: float) -> None:
        """Block until bytes may be there, at most ``timeout_s``."""
        start_s = self.now()
        self._transport.wait(timeout_s)
        end_s = self.now()
        if self.drained and end_s - start_s <= timeout_s + _LATE_S:
            self._drained_s = end_s  # what comes next came just now

    def receive(self) -> list[tuple[Peer, Received]]:
        """Return the packets that have come, by peer; never blocks.

        They are stamped with the time of reading, unless the caller has been away: then with
        the time of the last look, because a full buffer keeps the oldest packets and a position
        of two seconds ago must not pass for a new one.

        Raises:
            LinkLostError: If the transport has failed.
        """
        packets: list[tuple[Peer, Received]] = []
        arrived = self._transport.receive()
        now_s = self.now()
        self.punctual = now_s - self._drained_s <= _LATE_S
        time_s = now_s if self.punctual else self._drained_s
        self.drained = len(arrived) < READS_AT_ONCE
        if self.drained:
            self._drained_s = now_s
        for peer, data in arrived:
            for received in self._parser(peer).receive(data, time_s):
                if self._tap is not None:
                    self._tap(False, time_s, received.frame)
                packets.append((peer, received))
        return packets

    def reply_to(self, peer: Peer) -> None:
        """Send to ``peer`` from now on."""
        self._transport.reply_to(peer)

    def send(self, message: Any) -> bytes:
        """Send one message and return its frame."""
        frame = self.codec.encode(message)
        if self.signing is not None:
            frame = self.signing.sign(frame, self.now())
        self._transport.send(frame)
        if self._tap is not None:
            self._tap(True, self.now(), frame)
        return frame

    def close(self) -> None:
        """Release the transport and the codec; sends nothing."""
        self._transport.close()
        self.codec.close()

    def _parser(self, peer: Peer) -> Parser:
        parser = self._parsers.get(peer)
        if parser is None:
            if len(self._parsers) >= _MAX_PEERS:
                del self._parsers[next(iter(self._parsers))]
            admits = None if self.signing is None else self.signing.admits
            parser = self._parsers[peer] = Parser(admits)
        return parser
