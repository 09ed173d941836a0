"""Everything the flying process is told, written down so that a flight can be replayed exactly.

The process is a function of its files and options, of the bytes the link hands it, of the times
the clock shows it, and of a signal to stop. The journal stands between it and the last three and
keeps them in the order in which they were asked for; ``playback`` answers the same again. Nothing
else decides: which bytes belong to which tick follows from the order alone.

The journal goes to the recorder in blocks (``records.Inputs``), each with a number and with the
count of frames given to the recorder before it, so that a replay can tell what is missing.
"""

import struct
from collections.abc import Callable

from companion import clock
from companion.computer import MAX_CORES, Computer
from companion.errors import LinkLostError
from companion.link.transport import Peer, Transport
from companion.session.records import Inputs, Raw, Record

TIME = struct.Struct("<cd")
"""``t``: the clock was read, seconds."""
COUNT = struct.Struct("<cI")
"""``r``: bytes were asked for and so many chunks came. ``e``: so many packets could not be sent
by now. ``f``: whether the other side hears of us only if we send first."""
CHUNK = struct.Struct("<cHI")
"""``c``: a chunk of so many bytes of a peer, by number. ``p``: a new peer, by number, its name
that long. ``l``: the link was lost, the message that long. The bytes follow."""
NOTHING = b"n"
"""Bytes were asked for and none came."""
SENT = b"w"
"""A packet was sent; ``e`` follows if that failed."""
COMPUTER = struct.Struct(f"<c{MAX_CORES}BbII")
"""``h``: the state of this computer was read."""
STOP, GO_ON = b"s", b"g"
"""Whether the program was asked to stop."""

_MAX_PEERS = 1024
"""Anybody can send us UDP, from as many addresses as he likes."""
_BLOCK_BYTES = 16_384
"""A third of a second of PX4; a process that is killed loses no more."""


class Journal:
    """Writes down what the clock and the link say; hands blocks and frames to the recorder."""

    def __init__(
        self, put: Callable[[Record], None], read_clock: Callable[[], float] = clock.now_s
    ) -> None:
        self._put = put
        self._read_clock = read_clock
        self._buffer = bytearray()
        self._blocks = 0
        self._frames = 0
        self.start_s = self.now()
        """Zero of the recorded times."""

    def now(self) -> float:
        """Return the time of the clock."""
        time_s = self._read_clock()
        self._buffer += TIME.pack(b"t", time_s)
        if len(self._buffer) >= _BLOCK_BYTES:
            self.flush()
        return time_s

    def tap(self, sent: bool, time_s: float, frame: bytes) -> None:
        """Record one frame of the link."""
        self._frames += 1
        self._put(Raw(sent, time_s - self.start_s, frame))

    def stop(self, asked: Callable[[], bool]) -> Callable[[], bool]:
        """Return ``asked``, its answers written down."""

        def journaled() -> bool:
            answer = asked()
            self.note(STOP if answer else GO_ON)
            return answer

        return journaled

    def computer(self, read: Callable[[], Computer]) -> Callable[[], Computer]:
        """Return ``read``, its answers written down."""

        def journaled() -> Computer:
            state = read()
            self.note(
                COMPUTER.pack(
                    b"h",
                    *state.core_percent,
                    state.celsius,
                    state.ram_used_mib,
                    state.ram_total_mib,
                )
            )
            return state

        return journaled

    def note(self, entry: bytes) -> None:
        """Add an entry."""
        self._buffer += entry

    def flush(self) -> None:
        """Hand over what there is."""
        self._put(Inputs(self._blocks, self._frames, bytes(self._buffer)))
        self._blocks += 1
        self._buffer.clear()


class JournaledTransport:
    """A transport of which every answer is written down."""

    def __init__(self, transport: Transport, journal: Journal) -> None:
        self._transport = transport
        self._journal = journal
        self._peers: dict[Peer, int] = {}
        self.send_errors = 0
        self.speaks_first = transport.speaks_first
        journal.note(COUNT.pack(b"f", self.speaks_first))

    def wait(self, timeout_s: float) -> None:
        """Block until bytes may be there; only the clock tells of it."""
        self._transport.wait(timeout_s)

    def receive(self) -> list[tuple[Peer, bytes]]:
        """Return what is there, by peer.

        Raises:
            LinkLostError: If the stream has ended or the port is gone.
        """
        try:
            chunks = self._transport.receive()
        except LinkLostError as error:
            self._note_bytes(b"l", 0, str(error).encode())
            raise
        if not chunks:
            self._journal.note(NOTHING)
            return chunks
        self._journal.note(COUNT.pack(b"r", len(chunks)))
        for peer, data in chunks:
            number = self._peers.get(peer)
            if number is None:
                if len(self._peers) == _MAX_PEERS:
                    self._peers.clear()  # numbers are given anew; playback hears the names again
                number = self._peers[peer] = len(self._peers)
                self._note_bytes(b"p", number, str(peer).encode())
            self._note_bytes(b"c", number, data)
        self._note_errors()
        return chunks

    def reply_to(self, peer: Peer) -> None:
        """Send to ``peer`` from now on."""
        self._transport.reply_to(peer)

    def send(self, data: bytes) -> None:
        """Send one packet, or count that it could not be sent."""
        self._transport.send(data)
        self._journal.note(SENT)
        self._note_errors()

    def close(self) -> None:
        """Release the socket or port."""
        self._transport.close()

    def _note_errors(self) -> None:
        errors = self._transport.send_errors
        if errors != self.send_errors:
            self.send_errors = errors
            self._journal.note(COUNT.pack(b"e", errors & 0xFFFFFFFF))

    def _note_bytes(self, kind: bytes, number: int, data: bytes) -> None:
        self._journal.note(CHUNK.pack(kind, number, len(data)) + data)
