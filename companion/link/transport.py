"""Move bytes between a socket or serial port and the link. All decisions live elsewhere.

Every transport is opened ready to use, never blocks except in ``wait``, and counts what it
could not send instead of raising: a companion must outlive a full buffer and a closed peer port.
"""

import errno
import os
import select
import socket
from collections.abc import Hashable
from typing import Any, Protocol

import serial

from companion.clock import now_s
from companion.errors import LinkLostError, LinkOpenError
from companion.link.address import Address, SerialLine, TcpCall, UdpCall, UdpListen

Peer = Hashable
"""Who sent some bytes: a socket address for UDP in, always the same value elsewhere."""

_THE_PEER: Peer = "peer"
READS_AT_ONCE = 64
"""Reads before the clock is looked at again, so that a flood cannot hold the loop."""
_READ_BYTES = 65536
_CONNECT_TIMEOUT_S = 5.0
_AWAKE_S = 1e-4
"""So long before the end of a wait the processor stays awake: out of sleep it comes 0.06 ms late,
and slow."""
_KERNEL_BUFFER_BYTES = 1 << 20
"""PX4's 400 packets a second fill the default buffer in half a second."""


class Transport(Protocol):
    """What the link needs of a socket, a port, or a test."""

    speaks_first: bool
    """Whether the other side hears of us only if we send first."""
    send_errors: int
    """Packets that could not be sent."""

    def wait(self, timeout_s: float) -> None:
        """Block until bytes may be there, at most ``timeout_s``; the only call that blocks."""
        ...

    def receive(self) -> list[tuple[Peer, bytes]]:
        """Return all that is there, by peer, oldest first, in at most ``READS_AT_ONCE`` chunks.

        Raises:
            LinkLostError: If the stream has ended or the port is gone.
        """
        ...

    def reply_to(self, peer: Peer) -> None:
        """Send to ``peer`` from now on; means nothing where there is only one."""
        ...

    def send(self, data: bytes) -> None:
        """Send one packet, or count that it could not be sent."""
        ...

    def close(self) -> None:
        """Release the socket or port; may be called twice."""
        ...


def open_transport(address: Address) -> Transport:
    """Open the socket or port of ``address``.

    Raises:
        LinkOpenError: If that fails; the message says what to do.
    """
    match address:
        case UdpListen():
            return _UdpIn(address)
        case UdpCall():
            return _UdpOut(address)
        case TcpCall():
            return _Tcp(address)
        case SerialLine():
            return _Serial(address)


class _Waiting:
    """Waiting on a file descriptor, for all transports."""

    def __init__(self) -> None:
        self.send_errors = 0

    def fileno(self) -> int:
        raise NotImplementedError

    def wait(self, timeout_s: float) -> None:
        # select, because epoll rounds the timeout up to whole milliseconds
        waited_on, end_s = [self.fileno()], now_s() + timeout_s
        readable, _, _ = select.select(waited_on, [], [], max(0.0, timeout_s - _AWAKE_S))
        while not readable and now_s() < end_s:
            readable, _, _ = select.select(waited_on, [], [], 0.0)


class _Socket(_Waiting):
    def __init__(self, opened: socket.socket) -> None:
        super().__init__()
        self._socket = opened
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _KERNEL_BUFFER_BYTES)

    def fileno(self) -> int:
        return self._socket.fileno()

    def close(self) -> None:
        self._socket.close()


class _UdpIn(_Socket):
    """Listens; answers the peer it was told to answer."""

    speaks_first = False

    def __init__(self, address: UdpListen) -> None:
        family, where = _resolve(address.host, address.port, socket.SOCK_DGRAM)
        opened = socket.socket(family, socket.SOCK_DGRAM)
        try:
            opened.bind(where)
        except OSError as error:
            opened.close()
            raise _cannot_listen(address, error) from error
        super().__init__(opened)
        self._peer: Peer | None = None

    def receive(self) -> list[tuple[Peer, bytes]]:
        datagrams: list[tuple[Peer, bytes]] = []
        for _ in range(READS_AT_ONCE):
            try:
                data, peer = self._socket.recvfrom(_READ_BYTES)
            except BlockingIOError:
                break
            except OSError:  # the ICMP answer to something sent before
                self.send_errors += 1
                continue
            datagrams.append((peer, data))
        return datagrams

    def reply_to(self, peer: Peer) -> None:
        self._peer = peer

    def send(self, data: bytes) -> None:
        if self._peer is None:
            self.send_errors += 1
            return
        try:
            self._socket.sendto(data, self._peer)  # type: ignore[call-overload]
        except OSError:
            self.send_errors += 1


class _UdpOut(_Socket):
    """Sends to one host and port and hears only that."""

    speaks_first = True

    def __init__(self, address: UdpCall) -> None:
        family, where = _resolve(address.host, address.port, socket.SOCK_DGRAM)
        opened = socket.socket(family, socket.SOCK_DGRAM)
        try:
            opened.connect(where)
        except OSError as error:
            opened.close()
            raise _cannot_call("udpout", address, error) from error
        super().__init__(opened)

    def receive(self) -> list[tuple[Peer, bytes]]:
        datagrams: list[tuple[Peer, bytes]] = []
        for _ in range(READS_AT_ONCE):
            try:
                data = self._socket.recv(_READ_BYTES)
            except BlockingIOError:
                break
            except OSError:  # ECONNREFUSED by ICMP: nobody listens there yet; they may come
                self.send_errors += 1
                continue
            datagrams.append((_THE_PEER, data))
        return datagrams

    def reply_to(self, peer: Peer) -> None:
        pass

    def send(self, data: bytes) -> None:
        try:
            self._socket.send(data)
        except OSError:
            self.send_errors += 1


class _Stream(_Waiting):
    """Bytes without borders from the one that is there."""

    speaks_first = True

    def _read(self) -> bytes:
        """Return some of what is there, nothing if nothing is; raise if the stream has ended."""
        raise NotImplementedError

    def receive(self) -> list[tuple[Peer, bytes]]:
        chunks: list[tuple[Peer, bytes]] = []
        try:
            while len(chunks) < READS_AT_ONCE and (data := self._read()):
                chunks.append((_THE_PEER, data))
        except LinkLostError:
            if not chunks:  # else what came before the end counts, and the next call tells
                raise
        return chunks

    def reply_to(self, peer: Peer) -> None:
        pass


class _Tcp(_Socket, _Stream):
    """A TCP client. Half a packet is finished before the next; while it waits, others drop."""

    def __init__(self, address: TcpCall) -> None:
        try:
            opened = socket.create_connection(
                (address.host, address.port), timeout=_CONNECT_TIMEOUT_S
            )
        except OSError as error:
            raise _cannot_call("tcp", address, error) from error
        opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        super().__init__(opened)
        self._unsent = b""

    def _read(self) -> bytes:
        try:
            data = self._socket.recv(_READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise LinkLostError(f"the TCP link broke: {_reason(error)}") from error
        if not data:
            raise LinkLostError("the other side closed the TCP link")
        return data

    def send(self, data: bytes) -> None:
        if self._unsent:
            self._unsent = self._unsent[self._push(self._unsent) :]
        if self._unsent:
            self.send_errors += 1
            return
        sent = self._push(data)
        if sent == 0:
            self.send_errors += 1
        else:
            self._unsent = data[sent:]

    def _push(self, data: bytes) -> int:
        try:
            return self._socket.send(data)
        except OSError:  # full, or broken: then ``receive`` says so
            return 0


class _Serial(_Stream):
    """A serial port. pyserial opens and sets it up; bytes move over its descriptor."""

    def __init__(self, address: SerialLine) -> None:
        super().__init__()
        self._device = address.device
        try:
            self._port = serial.Serial(
                address.device, address.baud, timeout=0, write_timeout=0, exclusive=True
            )
        except (OSError, ValueError) as error:  # SerialException is an OSError
            raise _cannot_open_serial(address, error) from error
        os.set_blocking(self._port.fileno(), False)

    def fileno(self) -> int:
        return int(self._port.fileno())

    def _read(self) -> bytes:
        try:
            if not select.select([self.fileno()], [], [], 0.0)[0]:
                return b""
            data = os.read(self.fileno(), _READ_BYTES)
        except OSError as error:
            raise LinkLostError(f"serial port {self._device} failed: {_reason(error)}") from error
        if not data:  # ready, and yet nothing: that is how an unplugged port looks
            raise LinkLostError(f"serial port {self._device} is gone; is it unplugged?")
        return data

    def send(self, data: bytes) -> None:
        try:
            sent = os.write(self.fileno(), data)
        except OSError:
            sent = 0
        if sent < len(data):  # the other side skips the torn packet by its checksum
            self.send_errors += 1

    def close(self) -> None:
        self._port.close()


def _resolve(host: str, port: int, kind: int) -> tuple[int, Any]:
    try:
        family, _, _, _, where = socket.getaddrinfo(host, port, type=kind)[0]
    except (OSError, UnicodeError) as error:
        raise LinkOpenError(f"the host '{host}' is not known: {error}; check its spelling") from (
            error
        )
    return family, where


def _reason(error: BaseException) -> str:
    return getattr(error, "strerror", None) or str(error)


def _cannot_listen(address: UdpListen, error: OSError) -> LinkOpenError:
    advice = {
        errno.EADDRINUSE: "another program has that port; stop it or listen on another",
        errno.EADDRNOTAVAIL: "that address is not this machine's; use 0.0.0.0 or udpout:",
        errno.EACCES: "ports below 1024 need special rights; use a higher one",
    }.get(error.errno or 0, "check host and port")
    return LinkOpenError(
        f"cannot listen on udp {address.host}:{address.port}: {_reason(error)}; {advice}"
    )


def _cannot_call(scheme: str, address: UdpCall | TcpCall, error: OSError) -> LinkOpenError:
    advice = {
        errno.ECONNREFUSED: "nothing listens there; start the autopilot or check the port",
        errno.ENETUNREACH: "no network leads there; check the address",
        errno.EHOSTUNREACH: "no network leads there; check the address",
    }.get(error.errno or 0, "check host and port, and whether the autopilot runs")
    return LinkOpenError(
        f"cannot connect to {scheme} {address.host}:{address.port}: {_reason(error)}; {advice}"
    )


def _cannot_open_serial(address: SerialLine, error: OSError | ValueError) -> LinkOpenError:
    advice = {
        errno.ENOENT: "no such device; `ls /dev/tty*` shows which there are",
        errno.EACCES: "no permission; add your user to the group 'dialout' and log in again",
        errno.EBUSY: "another program has it",
        errno.EAGAIN: "another program has it",
    }.get(getattr(error, "errno", None) or 0, "check the device and the baud rate")
    return LinkOpenError(
        f"cannot open serial port {address.device} at {address.baud} baud: {advice}"
    )
