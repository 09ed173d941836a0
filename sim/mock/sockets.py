"""Sockets of the mock: one small class per transport, and the URLs that name them."""

import contextlib
import socket
from dataclasses import dataclass
from typing import Protocol

from companion.errors import LinkOpenError, UsageError

GROUND_PORT = 14550
"""Links on this port get the rates of a ground-station link, as on PX4 SITL."""
MAX_PEERS = 8
MAX_DATAGRAM = 2048
SCHEMES = ("udpout", "udpin", "udp", "tcpin", "tcp", "tcpout")


@dataclass(frozen=True, slots=True)
class Address:
    """A parsed ``--connect`` URL."""

    scheme: str
    host: str
    port: int

    @property
    def ground(self) -> bool:
        """Whether this is the ground-station port."""
        return self.port == GROUND_PORT


def parse_url(url: str) -> Address:
    """Parse ``SCHEME:HOST:PORT``; ``SCHEME://HOST:PORT`` means the same.

    Raises:
        UsageError: If the URL names no transport, host or port.
    """
    scheme, _, rest = url.partition(":")
    host, _, port = rest.removeprefix("//").rpartition(":")
    if scheme not in SCHEMES or not port.isdecimal() or not 0 < int(port) < 65536:
        raise UsageError(
            f"--connect {url}: expected {'|'.join(SCHEMES[:4])}|tcp:HOST:PORT, "
            "for example udpout:127.0.0.1:14540"
        )
    scheme = {"udp": "udpin", "tcpout": "tcp"}.get(scheme, scheme)
    return Address(scheme, host or "0.0.0.0", int(port))


class Link(Protocol):
    """Something that moves bytes."""

    def fileno(self) -> int:
        """Return the descriptor to wait on."""
        ...

    def receive(self) -> list[bytes]:
        """Return everything that has arrived; never blocks."""
        ...

    def send(self, packet: bytes) -> None:
        """Send one packet; what cannot be sent is lost, as on a radio."""
        ...

    def close(self) -> None:
        """Release the socket."""
        ...


class UdpLink:
    """UDP: listening (answers everyone heard, the newest eight) or calling one address."""

    def __init__(self, address: Address) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._learns = address.scheme == "udpin"
        self._peers: dict[tuple[str, int], None] = {}
        if self._learns:
            self._socket.bind((address.host, address.port))
        else:
            self._peers[(socket.gethostbyname(address.host), address.port)] = None

    def fileno(self) -> int:
        """Return the descriptor to wait on."""
        return self._socket.fileno()

    def receive(self) -> list[bytes]:
        """Return the datagrams that have arrived."""
        data: list[bytes] = []
        while True:
            try:
                datagram, peer = self._socket.recvfrom(MAX_DATAGRAM)
            except BlockingIOError:
                return data
            except OSError:
                continue  # somebody's port is closed: an ICMP answer to what we sent
            data.append(datagram)
            if self._learns and peer not in self._peers:
                self._peers[peer] = None
                if len(self._peers) > MAX_PEERS:
                    del self._peers[next(iter(self._peers))]

    def send(self, packet: bytes) -> None:
        """Send one packet to every peer."""
        for peer in self._peers:
            with contextlib.suppress(OSError):
                self._socket.sendto(packet, peer)

    def close(self) -> None:
        """Release the socket."""
        self._socket.close()


class TcpLink:
    """TCP: listening (one client at a time) or calling."""

    def __init__(self, address: Address) -> None:
        self._stream: socket.socket | None = None
        self._server: socket.socket | None = None
        where = (address.host, address.port)
        if address.scheme == "tcpin":
            self._server = socket.create_server(where)
            self._server.setblocking(False)
        else:
            self._adopt(socket.create_connection(where, timeout=3.0))

    def fileno(self) -> int:
        """Return the descriptor to wait on: the client's, or the server's while alone."""
        waiting = self._stream or self._server
        return -1 if waiting is None else waiting.fileno()

    def receive(self) -> list[bytes]:
        """Accept a client, or return what it sent."""
        if self._stream is None:
            if self._server is not None:
                with contextlib.suppress(BlockingIOError):
                    self._adopt(self._server.accept()[0])
            return []
        try:
            data = self._stream.recv(65536)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data:
            self._stream.close()
            self._stream = None
            return []
        return [data]

    def send(self, packet: bytes) -> None:
        """Send one packet to the client, if there is one and it keeps up."""
        if self._stream is not None:
            with contextlib.suppress(OSError):
                self._stream.send(packet)

    def close(self) -> None:
        """Release the sockets."""
        for end in (self._stream, self._server):
            if end is not None:
                end.close()

    def _adopt(self, stream: socket.socket) -> None:
        stream.setblocking(False)
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._stream = stream


def open_link(address: Address) -> Link:
    """Open the socket of an address.

    Raises:
        LinkOpenError: If that is not possible.
    """
    try:
        return UdpLink(address) if address.scheme.startswith("udp") else TcpLink(address)
    except OSError as error:
        where = f"{address.scheme}:{address.host}:{address.port}"
        raise LinkOpenError(f"cannot open {where}: {error.strerror or error}") from error
