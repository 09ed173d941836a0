"""Link URLs: what people write after ``--connect``, in the spelling of pymavlink or MAVSDK."""

from dataclasses import dataclass

from companion.errors import UsageError

_EXAMPLES = (
    "udp:0.0.0.0:14540, udpout:10.0.0.2:14550, tcp:127.0.0.1:5760, serial:/dev/ttyAMA0:921600"
)


@dataclass(frozen=True, slots=True)
class UdpListen:
    """Bind a UDP port and answer whoever carries the vehicle."""

    host: str
    port: int


@dataclass(frozen=True, slots=True)
class UdpCall:
    """Send UDP to a known host and port."""

    host: str
    port: int


@dataclass(frozen=True, slots=True)
class TcpCall:
    """Connect to a TCP server, as ArduPilot SITL is one."""

    host: str
    port: int


@dataclass(frozen=True, slots=True)
class SerialLine:
    """Open a serial port."""

    device: str
    baud: int


Address = UdpListen | UdpCall | TcpCall | SerialLine

_NETWORK: dict[str, type[UdpListen] | type[UdpCall] | type[TcpCall]] = {
    "udp": UdpListen,
    "udpin": UdpListen,
    "udpout": UdpCall,
    "tcp": TcpCall,
    "tcpout": TcpCall,
}


def parse_url(url: str) -> Address:
    """Return the address a URL stands for.

    ``udp:HOST:PORT`` and ``udpin:`` listen, ``udpout:`` and ``tcp:`` call, ``serial:DEVICE:BAUD``
    opens a port; ``udpin://`` and so on mean the same. An empty host listens on all interfaces.

    Raises:
        UsageError: If the URL cannot be read; the message shows one that can.
    """
    scheme, colon, rest = url.partition(":")
    rest = rest.removeprefix("//")
    if not colon:
        raise _bad(url, "it has no scheme")
    if scheme == "serial":
        return _serial(url, rest)
    kind = _NETWORK.get(scheme)
    if kind is None:
        known = ", ".join([*_NETWORK, "serial"])
        raise _bad(url, f"the scheme '{scheme}' is none of {known}")
    host, colon, port_text = rest.rstrip("/").rpartition(":")
    if not colon:
        raise _bad(url, "the port is missing")
    port = _number(url, "port", port_text, 65535)
    host = host.removeprefix("[").removesuffix("]")
    if not host and kind is not UdpListen:
        raise _bad(url, "the host to call is missing")
    return kind(host or "0.0.0.0", port)


def _serial(url: str, rest: str) -> SerialLine:
    device, colon, baud_text = rest.rpartition(":")
    if not colon or not device:
        raise _bad(url, "a serial port needs its device and its baud rate")
    return SerialLine(device, _number(url, "baud rate", baud_text, 10_000_000))


def _number(url: str, name: str, text: str, highest: int) -> int:
    plain = text.isascii() and text.isdigit() and len(text) <= len(str(highest))
    if not plain or not 1 <= int(text) <= highest:
        raise _bad(url, f"the {name} must be a number from 1 to {highest}, got '{text}'")
    return int(text)


def _bad(url: str, reason: str) -> UsageError:
    return UsageError(f"cannot read the link URL '{url}': {reason}; examples: {_EXAMPLES}")
