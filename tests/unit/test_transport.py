import contextlib
import os
import pty
import socket
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import LinkLostError, LinkOpenError, UsageError
from companion.link.address import SerialLine, TcpCall, UdpCall, UdpListen, parse_url
from companion.link.transport import open_transport

LOOPBACK = "127.0.0.1"


@pytest.mark.parametrize(
    ("url", "address"),
    [
        ("udp:0.0.0.0:14540", UdpListen("0.0.0.0", 14540)),
        ("udpin:127.0.0.1:14550", UdpListen("127.0.0.1", 14550)),
        ("udpin://0.0.0.0:14540", UdpListen("0.0.0.0", 14540)),
        ("udp://:14540", UdpListen("0.0.0.0", 14540)),
        ("udpout:10.0.0.2:14550", UdpCall("10.0.0.2", 14550)),
        ("udpout://host.local:14550/", UdpCall("host.local", 14550)),
        ("tcp:localhost:5760", TcpCall("localhost", 5760)),
        ("tcpout://127.0.0.1:5760", TcpCall("127.0.0.1", 5760)),
        ("udpout:[::1]:14550", UdpCall("::1", 14550)),
        ("serial:/dev/ttyAMA0:921600", SerialLine("/dev/ttyAMA0", 921600)),
        ("serial:///dev/ttyUSB0:57600", SerialLine("/dev/ttyUSB0", 57600)),
    ],
)
def test_urls_of_both_styles(url, address):
    assert parse_url(url) == address


@pytest.mark.parametrize(
    "url",
    [
        "",
        "14540",
        "/dev/ttyUSB0",
        "http:127.0.0.1:80",
        "tcpin:0.0.0.0:5760",
        "udp:127.0.0.1",
        "udp:127.0.0.1:",
        "udp:127.0.0.1:0",
        "udp:127.0.0.1:65536",
        "udp:127.0.0.1:١٢",
        "udp:127.0.0.1:" + "9" * 5000,
        "udpout::14550",
        "serial:/dev/ttyUSB0",
        "serial::57600",
        "serial:/dev/ttyUSB0:fast",
    ],
)
def test_an_unreadable_url_is_answered_with_an_example(url):
    with pytest.raises(UsageError, match="examples: udp:") as caught:
        parse_url(url)
    assert "\n" not in str(caught.value)


@given(st.text())
def test_no_url_raises_anything_else(url):
    with contextlib.suppress(UsageError):
        parse_url(url)


def free_port(kind=socket.SOCK_DGRAM):
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind((LOOPBACK, 0))
        return probe.getsockname()[1]


def receive(transport, size=1):
    """Wait for at least ``size`` bytes; give up after two seconds."""
    received = []
    end_s = time.monotonic() + 2.0
    while sum(len(data) for _, data in received) < size and time.monotonic() < end_s:
        transport.wait(0.1)
        received += transport.receive()
    return received


@pytest.fixture
def opened():
    transports = []

    def open_one(url):
        transports.append(open_transport(parse_url(url)))
        return transports[-1]

    yield open_one
    for transport in transports:
        transport.close()
        transport.close()


@pytest.fixture
def peer():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.bind((LOOPBACK, 0))
        udp.settimeout(2.0)
        yield udp


def test_udp_in_answers_the_peer_it_was_told(opened, peer):
    port = free_port()
    transport = opened(f"udpin:{LOOPBACK}:{port}")
    assert not transport.speaks_first
    transport.send(b"nobody yet")
    assert transport.send_errors == 1
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.sendto(b"other", (LOOPBACK, port))
        peer.sendto(b"one", (LOOPBACK, port))
        peer.sendto(b"two", (LOOPBACK, port))
        received = receive(transport, 11)
        assert [data for _, data in received] == [b"other", b"one", b"two"]
        assert received[1][0] == received[2][0] != received[0][0]
        transport.reply_to(received[1][0])
        transport.send(b"back")
        assert peer.recv(100) == b"back"


def test_udp_out_outlives_a_peer_that_is_not_there(opened):
    port = free_port()
    transport = opened(f"udpout:{LOOPBACK}:{port}")
    assert transport.speaks_first
    for _ in range(5):
        transport.send(b"anybody?")
        transport.wait(0.01)
        assert transport.receive() == []
    assert transport.send_errors > 0  # the ICMP answers were counted, not raised
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as late:
        late.bind((LOOPBACK, port))
        late.settimeout(2.0)
        transport.send(b"hello")
        data, address = late.recvfrom(100)
        assert data in (b"hello", b"anybody?")
        late.sendto(b"here", address)
        assert receive(transport, 4)[0][1] == b"here"


def test_a_flood_is_taken_in_pieces(opened, peer):
    port = free_port()
    transport = opened(f"udpin:{LOOPBACK}:{port}")
    for _ in range(100):
        peer.sendto(b"x", (LOOPBACK, port))
    assert 0 < len(transport.receive()) < 100


@pytest.fixture
def server():
    with socket.create_server((LOOPBACK, 0)) as listening:
        listening.settimeout(2.0)
        yield listening


def test_tcp_both_ways_and_its_end(opened, server):
    transport = opened(f"tcp:{LOOPBACK}:{server.getsockname()[1]}")
    accepted, _ = server.accept()
    with accepted:
        transport.send(b"ping")
        assert accepted.recv(100) == b"ping"
        accepted.sendall(b"pong")
        assert b"".join(data for _, data in receive(transport, 4)) == b"pong"
        assert transport.receive() == []
    with pytest.raises(LinkLostError, match="closed"):
        receive(transport)


def test_tcp_reset_is_a_lost_link(opened, server):
    transport = opened(f"tcp:{LOOPBACK}:{server.getsockname()[1]}")
    accepted, _ = server.accept()
    accepted.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
    accepted.close()
    with pytest.raises(LinkLostError, match="TCP"):
        receive(transport)
    transport.send(b"counted")
    assert transport.send_errors == 1


def test_a_full_tcp_link_drops_whole_packets_only(opened, server):
    transport = opened(f"tcp:{LOOPBACK}:{server.getsockname()[1]}")
    accepted, _ = server.accept()
    packet = bytes(range(256)) * 4
    with accepted:
        while transport.send_errors < 3:
            transport.send(packet)
        accepted.settimeout(0.2)
        arrived = bytearray()
        for _ in range(3):
            try:
                while chunk := accepted.recv(1 << 20):
                    arrived += chunk
            except TimeoutError:
                transport.send(packet)  # pushes the rest of the torn one first
    assert len(arrived) % len(packet) == 0
    assert arrived == packet * (len(arrived) // len(packet))


@pytest.fixture
def terminal():
    leader, follower = pty.openpty()
    yield leader, os.ttyname(follower)
    os.close(follower)


def test_serial_both_ways_and_its_end(opened, terminal):
    leader, device = terminal
    transport = opened(f"serial:{device}:57600")
    assert transport.speaks_first
    assert transport.receive() == []
    transport.send(b"\xfd\x00\r\n\x11\x13")
    assert os.read(leader, 100) == b"\xfd\x00\r\n\x11\x13"
    os.write(leader, b"\xfe\x03\x04\r")
    assert b"".join(data for _, data in receive(transport, 4)) == b"\xfe\x03\x04\r"
    os.close(leader)
    with pytest.raises(LinkLostError, match="serial"):
        receive(transport)


def test_open_errors_say_what_to_do(opened, peer, terminal):
    taken = peer.getsockname()[1]
    refused = free_port(socket.SOCK_STREAM)
    for url, advice in [
        (f"udpin:{LOOPBACK}:{taken}", "another program has that port"),
        ("udpin:192.0.2.1:14540", "not this machine's"),
        (f"tcp:{LOOPBACK}:{refused}", "nothing listens there"),
        ("udpin:no.such.host.invalid:14540", "not known"),
        ("tcp:no.such.host.invalid:5760", "check host and port"),
        ("serial:/dev/no-such-port:57600", "no such device"),
        ("serial:/dev/null:57600", "check the device"),
    ]:
        with pytest.raises(LinkOpenError, match=advice) as caught:
            opened(url)
        assert "\n" not in str(caught.value)
    opened(f"serial:{terminal[1]}:57600")
    with pytest.raises(LinkOpenError, match="another program has it"):
        opened(f"serial:{terminal[1]}:57600")
    os.close(terminal[0])
