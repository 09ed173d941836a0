"""Open a link and find the vehicle on it."""

import importlib.util
import logging
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path
from typing import Literal

from companion import clock
from companion.computer import Computer
from companion.errors import UsageError
from companion.link.address import parse_url
from companion.link.codec import Codec
from companion.link.connection import Connection, Tap
from companion.link.discovery import discover
from companion.link.signing import Signing, SigningKey, load_key, stamp_at
from companion.link.transport import Transport, open_transport
from companion.link.vehicle import COMPONENT_ID, MavlinkVehicle

Backend = Literal["pymavlink", "mavsdk"]
"""The library that reads and writes the messages."""

_PROVISIONAL_SYSTEM_ID = 1
_VERSION_WAIT_S = 1.0
_LOG = logging.getLogger("companion")


def connect(
    url: str,
    *,
    backend: Backend = "pymavlink",
    vehicle_sysid: int | None = None,
    target_sysids: Sequence[int] = (),
    timeout_s: float = 30.0,
    tap: Tap | None = None,
    computer: Callable[[], Computer] | None = None,
    signing_key: Path | None = None,
    watch: Callable[[Transport], Transport] | None = None,
    now: Callable[[], float] = clock.now_s,
    utc_now: Callable[[], datetime] = clock.utc_now,
) -> MavlinkVehicle:
    """Open a link and find the vehicle on it.

    Args:
        url: See ``companion.link.address.parse_url``.
        backend: What reads and writes the messages.
        vehicle_sysid: Which vehicle; ``None`` if there is but one.
        target_sysids: Systems whose positions are reported by ``targets``.
        timeout_s: How long to wait for the vehicle.
        tap: Called with ``(sent, time_s, frame)`` for every frame both ways.
        computer: Reads the state of this computer, for ONBOARD_COMPUTER_STATUS; ``None`` tells
            nobody of it.
        signing_key: File of the key that everybody on the link must sign with, see
            ``companion.link.signing.load_key``; ``None`` leaves the link open to all.
        watch: Returns what to use in place of the transport, to see what passes.
        now: The monotonic clock.
        utc_now: The wall clock, read once where frames are signed.

    Raises:
        UsageError: If the URL or the system ids make no sense, the backend is not installed,
            or the key file cannot be read.
        LinkOpenError: If the link cannot be opened.
        LinkLostError: If the vehicle is not heard in time.
        AmbiguousVehicleError: If there are several and none was named.
        RefusedError: If the companion does not fly such a vehicle, or others may read the key.
    """
    address = parse_url(url)
    check_backend(backend)
    key = None
    if signing_key is not None:
        key = load_key(signing_key)
        _LOG.info("frames are signed; the key in %s is %s", signing_key, key.form)
    # The codec first: loading MAVSDK takes longer than the kernel keeps packets for us.
    codec = make_codec(backend, vehicle_sysid)
    try:
        transport = open_transport(address)
    except BaseException:
        codec.close()
        raise
    return attach(
        transport if watch is None else watch(transport),
        url=url,
        codec=codec,
        vehicle_sysid=vehicle_sysid,
        target_sysids=target_sysids,
        timeout_s=timeout_s,
        tap=tap,
        computer=computer,
        signing_key=key,
        now=now,
        utc_now=utc_now,
    )


def attach(
    transport: Transport,
    *,
    url: str,
    codec: Codec | None = None,
    vehicle_sysid: int | None = None,
    target_sysids: Sequence[int] = (),
    timeout_s: float = 30.0,
    tap: Tap | None = None,
    computer: Callable[[], Computer] | None = None,
    signing_key: SigningKey | None = None,
    now: Callable[[], float] = clock.now_s,
    utc_now: Callable[[], datetime] = clock.utc_now,
) -> MavlinkVehicle:
    """Find the vehicle on an open transport, which is closed on failure; see ``connect``.

    ``codec`` is what ``make_codec`` returns, pymavlink's if it is not given.
    """
    codec = make_codec("pymavlink", vehicle_sysid) if codec is None else codec
    signing = None
    if signing_key is not None:
        signing = Signing(signing_key, stamp=stamp_at(utc_now()), now_s=now())
    connection = Connection(transport, codec, now, tap, signing)
    try:
        found = discover(
            connection,
            url=url,
            vehicle_sysid=vehicle_sysid,
            target_sysids=target_sysids,
            timeout_s=timeout_s,
        )
        vehicle = MavlinkVehicle(connection, found, target_sysids, computer)
        vehicle.wait_for_version(_VERSION_WAIT_S)
    except BaseException:
        connection.close()
        raise
    return vehicle


def check_backend(backend: Backend) -> None:
    """Refuse a backend that is not installed.

    Raises:
        UsageError: Says how to install it.
    """
    if importlib.util.find_spec(backend) is None:
        raise UsageError(
            f"--backend {backend} needs a package that is not installed: "
            f'pip install "mavsdk>=4.1,<5"'
        )


def make_codec(backend: Backend, vehicle_sysid: int | None) -> Codec:
    """Return what reads and writes messages, speaking as the vehicle's system if that is known."""
    system_id = _PROVISIONAL_SYSTEM_ID if vehicle_sysid is None else vehicle_sysid
    if backend == "pymavlink":
        return Codec(system_id, COMPONENT_ID)
    from companion.link.mavsdk import MavsdkCodec  # only here: it loads 20 MB and starts threads

    return MavsdkCodec(system_id, COMPONENT_ID)
