"""``--connect mock:px4`` or ``mock:ardupilot``: the built-in mock vehicle as a process of its own.

The mock is another program that happens to be installed with us: it is started by name, spoken
to over loopback UDP, and knows nothing of our codec.
"""

import logging
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from companion.errors import LinkOpenError

MOCK_PREFIX = "mock:"
MOCKS = ("mock:px4", "mock:ardupilot")
MOCK_SYSID = 1
_STOP_S = 3.0
_LOG = logging.getLogger("companion")


@contextmanager
def link_url(
    connect: str,
    map_path: str,
    target_sysid: int | None,
    signing_key: Path | None = None,
    *,
    speed: float = 1.0,
) -> Iterator[str]:
    """Yield the URL to connect to; one of ``MOCKS`` starts a vehicle that ends with us.

    Args:
        connect: URL, or one of ``MOCKS``.
        map_path: Map file or bundled name, for the mock's own contact referee.
        target_sysid: A second system that wanders through the map, if one is to be pursued.
        signing_key: File of the key that the mock vehicle signs with, if it is to.
        speed: Seconds of the mock vehicle in one of ours.

    Raises:
        LinkOpenError: If the mock vehicle cannot be started.
    """
    if not connect.startswith(MOCK_PREFIX):
        yield connect
        return
    autopilot = connect.removeprefix(MOCK_PREFIX)
    with mock_vehicle(autopilot, map_path, target_sysid, signing_key, speed=speed) as url:
        _LOG.info("started the mock vehicle (%s)", autopilot)
        yield url


@contextmanager
def mock_vehicle(
    autopilot: str,
    map_path: str,
    target_sysid: int | None,
    signing_key: Path | None = None,
    *,
    speed: float = 1.0,
) -> Iterator[str]:
    """Start a mock vehicle that calls us, and stop it at the end.

    Args:
        autopilot: The personality, ``px4`` or ``ardupilot``.
        map_path: Map file or bundled name, for the mock's own contact referee.
        target_sysid: A second system that wanders through the map, if one is to be pursued.
        signing_key: File of the key that it signs with, if it is to.
        speed: Its seconds in one of ours.

    Yields:
        The URL to listen on.

    Raises:
        LinkOpenError: If the process cannot be started.
    """
    port = _free_port()
    command = [
        sys.executable, "-m", "sim.mock",
        "--autopilot", autopilot,
        "--connect", f"udpout:127.0.0.1:{port}",
        "--map", map_path,
        "--speed", f"{speed:g}",
        "--exit-with-parent",
    ]  # fmt: skip
    if target_sysid is not None:
        command += ["--target", f"kind=waypoints,sysid={target_sysid},speed=1.5"]
    if signing_key is not None:
        command += ["--signing-key", str(signing_key)]
    try:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C on the terminal is for us; the vehicle flies on
        )
    except OSError as error:
        raise LinkOpenError(f"cannot start the mock vehicle: {error}") from error
    try:
        yield f"udpin:127.0.0.1:{port}"
    finally:
        process.terminate()
        try:
            process.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
