"""A clock, a link and a signal that answer as a journal says they once did."""

from struct import Struct
from typing import Any

from companion.computer import Computer
from companion.errors import LinkLostError
from companion.journal import CHUNK, COMPUTER, COUNT, GO_ON, NOTHING, SENT, STOP, TIME
from companion.link.transport import Peer


class PlaybackOver(BaseException):
    """The journal has ended, or the program asks for something else than it did then.

    Not an ``Exception``: the control loop must not take it for a fault of its own.
    """

    def __init__(self, *, diverged: bool) -> None:
        super().__init__("the journal diverged" if diverged else "the journal has ended")
        self.diverged = diverged


class Playback:
    """Transport and clock of a replay; ``companion.link.transport.Transport``."""

    def __init__(self, journal: bytes) -> None:
        self._journal = journal
        self._at = 0
        self._peers: dict[int, Peer] = {}
        self.send_errors = 0
        self.speaks_first = False
        self.now_s = 0.0
        """The newest time that was read."""

    def start(self) -> float:
        """Return the zero of the recorded times, as ``Journal`` read it at first."""
        return self.now()

    def open(self) -> "Playback":
        """Return the transport, as it was opened then."""
        self.speaks_first = bool(self._number(b"f"))
        return self

    def now(self) -> float:
        """Return the next time the clock showed."""
        _, self.now_s = self._take(TIME, b"t")
        return self.now_s

    def stop_requested(self) -> bool:
        """Return whether the program was asked to stop here."""
        return self._mark(STOP, GO_ON) == STOP

    def computer(self) -> Computer:
        """Return the state of the computer that flew."""
        _, *cores, celsius, used_mib, total_mib = self._take(COMPUTER, b"h")
        return Computer(tuple(cores), celsius, used_mib, total_mib)

    def wait(self, timeout_s: float) -> None:
        """Return at once: the clock tells how long it was."""

    def receive(self) -> list[tuple[Peer, bytes]]:
        """Return what came here.

        Raises:
            LinkLostError: If the link was lost here.
        """
        if self._peek() == NOTHING:
            self._mark(NOTHING)
            return []
        if self._peek() == b"l":
            raise LinkLostError(self._chunk(b"l")[1].decode())
        chunks: list[tuple[Peer, bytes]] = []
        for _ in range(self._number(b"r")):
            if self._peek() == b"p":
                number, name = self._chunk(b"p")
                self._peers[number] = name.decode()
            number, data = self._chunk(b"c")
            if number not in self._peers:
                raise PlaybackOver(diverged=True)
            chunks.append((self._peers[number], data))
        self._take_errors()
        return chunks

    def reply_to(self, peer: Peer) -> None:
        """Nobody is there."""

    def send(self, data: bytes) -> None:
        """Nobody is there; what is sent is seen by the tap."""
        self._mark(SENT)
        self._take_errors()

    def close(self) -> None:
        """Nothing is open."""

    def _take_errors(self) -> None:
        if self._at < len(self._journal) and self._peek() == b"e":
            self.send_errors = self._number(b"e")

    def _mark(self, *expected: bytes) -> bytes:
        mark = self._peek()
        if mark not in expected:
            raise PlaybackOver(diverged=True)
        self._at += 1
        return mark

    def _number(self, kind: bytes) -> int:
        return int(self._take(COUNT, kind)[1])

    def _chunk(self, kind: bytes) -> tuple[int, bytes]:
        _, number, size = self._take(CHUNK, kind)
        data = self._journal[self._at : self._at + size]
        if len(data) < size:
            raise PlaybackOver(diverged=False)
        self._at += size
        return number, data

    def _peek(self) -> bytes:
        if self._at >= len(self._journal):
            raise PlaybackOver(diverged=False)
        return self._journal[self._at : self._at + 1]

    def _take(self, layout: Struct, kind: bytes) -> tuple[Any, ...]:
        if self._peek() != kind:
            raise PlaybackOver(diverged=True)
        if self._at + layout.size > len(self._journal):
            raise PlaybackOver(diverged=False)
        values = layout.unpack_from(self._journal, self._at)
        self._at += layout.size
        return values
