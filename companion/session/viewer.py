"""The Rerun viewer of our own environment, always as a process of its own.

The ``rerun`` on PATH may be another version, and is a script that leaves the viewer behind when
it is stopped: the binary inside the ``rerun_cli`` package is started instead.
"""

import contextlib
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

from companion.clock import now_s, sleep_s
from companion.errors import CompanionError, UsageError

LOOPBACK = "127.0.0.1"
_MEMORY_LIMIT = "2GB"
_START_S = 60.0
_OPTIMIZE_S = 900.0  # of an hour, on a busy computer


def viewer_binary() -> Path:
    """Return the viewer that was installed with us.

    Raises:
        UsageError: If Rerun is not installed.
    """
    package = find_spec("rerun_cli")
    if package is None or package.origin is None:
        raise UsageError('the Rerun viewer is not installed: pip install "rerun-sdk==0.41.*"')
    return Path(package.origin).parent / ("rerun.exe" if sys.platform == "win32" else "rerun")


def has_display() -> bool:
    """Return whether a window can be opened here."""
    return sys.platform != "linux" or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    )


def open_viewer(*arguments: str) -> None:
    """Open a viewer window that outlives us, on a file or with ``--connect URI``.

    Raises:
        UsageError: If Rerun is not installed.
        CompanionError: If the viewer cannot be started.
    """
    _start(*arguments, "--port", "auto", "--memory-limit", _MEMORY_LIMIT)


@contextlib.contextmanager
def headless_viewer(size: tuple[int, int], *arguments: str) -> Iterator[str]:
    """Run a viewer without a window and yield the address it is controlled at.

    Args:
        size: Of the window that there is not, pixels.
        arguments: More for the viewer, such as ``--connect URI``.

    Raises:
        UsageError: If Rerun is not installed.
        CompanionError: If the viewer does not come up, with what it said.
    """
    port = free_port()
    with tempfile.TemporaryFile() as said:
        process = _start(
            *("--headless", "--port", str(port), "--window-size", f"{size[0]}x{size[1]}"),
            "--hide-welcome-screen",
            *arguments,
            output=said.fileno(),
        )
        try:
            deadline_s = now_s() + _START_S
            while not _listens(port):
                if process.poll() is not None or now_s() > deadline_s:
                    said.seek(0)
                    raise CompanionError(_why(said.read().decode(errors="replace")))
                sleep_s(0.1)
            try:
                yield f"rerun+http://{LOOPBACK}:{port}/proxy"
            except (ConnectionError, RuntimeError) as error:  # it may give up after it listens
                said.seek(0)
                reason = said.read().decode(errors="replace") or str(error)
                raise CompanionError(_why(reason)) from error
        finally:
            process.terminate()
            process.wait()


def optimize(recording: Path, rewritten: Path) -> bool:
    """Write a recording anew with fewer, larger chunks and a footer; mends one cut off.

    Returns:
        Whether ``rewritten`` was written; ``recording`` stays as it is.
    """
    try:
        command = [str(viewer_binary()), "rrd", "optimize", "--profile", "live", str(recording)]
        command += ["-o", str(rewritten)]
        subprocess.run(command, check=True, capture_output=True, timeout=_OPTIMIZE_S)
    except (CompanionError, OSError, subprocess.SubprocessError):
        rewritten.unlink(missing_ok=True)
        return False
    return True


def free_port(preferred: int = 0) -> int:
    """Return a TCP port that nobody listens on, ``preferred`` if it is free."""
    with socket.socket() as probe:
        try:
            probe.bind((LOOPBACK, preferred))
        except OSError:
            return free_port()
        port: int = probe.getsockname()[1]
        return port


def _start(*arguments: str, output: int = subprocess.DEVNULL) -> subprocess.Popen[bytes]:
    command = [str(viewer_binary()), *arguments, "--bind", LOOPBACK]
    environment = {"XDG_RUNTIME_DIR": tempfile.gettempdir(), **os.environ}
    try:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            env=environment,
            start_new_session=True,
        )
    except OSError as error:
        raise CompanionError(f"cannot start the Rerun viewer: {error}") from error
    return process


def _listens(port: int) -> bool:
    try:
        socket.create_connection((LOOPBACK, port), timeout=0.5).close()
    except OSError:
        return False
    return True


def _why(said: str) -> str:
    """Return one line on why the viewer did not come up."""
    if any(word in said for word in ("render context", "adapter", "wgpu", "Vulkan")):
        return (
            "the Rerun viewer found no graphics driver; on Debian or Ubuntu: "
            "sudo apt install mesa-vulkan-drivers libvulkan1"
        )
    last = said.strip().splitlines()[-1:] or ["it said nothing"]
    return f"the Rerun viewer did not start: {last[0]}"
