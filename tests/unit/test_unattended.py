"""Running without anybody at the terminal: log, watchdog, unit file, health of the computer."""

import logging
import os
import pty
import re
import select
import shutil
import socket
import subprocess
from pathlib import Path

import pytest

from companion import clock
from companion.computer import MAX_CORES, UNKNOWN_CELSIUS, UNKNOWN_MIB, ComputerProbe
from companion.config import RunConfig
from companion.errors import UsageError
from companion.link.messages import computer_status
from companion.service import unit
from companion.terminal import TerminalHandler
from companion.watchdog import Watchdog

# -- the log -----------------------------------------------------------------------------------


def read_all(descriptor):
    data = b""
    while select.select([descriptor], [], [], 0.0)[0]:
        data += os.read(descriptor, 1 << 16)
    return data.decode().replace("\r\n", "\n")


@pytest.fixture(params=["pipe", "terminal", "socket"])
def ends(request):
    """Return ``(read, write)`` of something that blocks whoever writes too much to it."""
    if request.param == "socket":
        near, far = socket.socketpair()
        yield near.fileno(), far.fileno()
        near.close()
        far.close()
        return
    read, write = os.pipe() if request.param == "pipe" else pty.openpty()
    yield read, write
    os.close(read)
    os.close(write)


def test_lines_come_with_their_time(ends):
    read, write = ends
    handler = TerminalHandler(write)
    handler.emit(logging.LogRecord("companion", logging.INFO, "", 0, "engaged: %d m", (3,), None))
    assert re.fullmatch(r" +\d+ ms  engaged: 3 m\n", read_all(read))


def test_a_reader_that_stops_reading_holds_nobody_and_is_told_what_it_missed(ends):
    read, write = ends
    handler = TerminalHandler(write)
    for number in range(20_000):
        handler.write(f"line {number} " + "x" * 80)  # one that blocks would never return
    text = read_all(read)
    handler.write("the last one")
    for _ in range(100):
        text += read_all(read)
        if "the last one" in text:
            break
        handler.flush()
    assert re.search(r"\(\d+ lines were not shown\)", text)


def test_a_reader_that_has_gone_is_no_error():
    read, write = os.pipe()
    handler = TerminalHandler(write)
    os.close(read)
    handler.write("anybody?")
    handler.write("anybody?")
    handler.flush()
    os.close(write)


def test_a_stopped_terminal_holds_nobody():
    """Ctrl-S: the terminal takes nothing until Ctrl-Q."""
    import termios

    read, write = pty.openpty()
    termios.tcflow(write, termios.TCOOFF)
    handler = TerminalHandler(write)
    for number in range(500):
        handler.write(f"line {number}")
    assert not read_all(read)
    termios.tcflow(write, termios.TCOON)
    handler.flush()
    assert "lines were not shown" in read_all(read)
    os.close(read)
    os.close(write)


def test_the_terminal_we_were_given_still_blocks_others():
    """The flag belongs to the open terminal: the shell behind us must not inherit it."""
    read, write = pty.openpty()
    TerminalHandler(write)
    assert os.get_blocking(write)
    os.close(read)
    os.close(write)


# -- the watchdog ------------------------------------------------------------------------------


@pytest.fixture
def systemd(tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        path = tmp_path / "notify"
        listener.bind(str(path))
        listener.setblocking(False)

        def heard():
            messages = []
            while select.select([listener], [], [], 0.0)[0]:
                messages.append(listener.recv(4096).decode())
            return messages

        yield str(path), heard


def test_the_loop_tells_that_it_lives(systemd):
    path, heard = systemd
    environment = {"NOTIFY_SOCKET": path, "WATCHDOG_USEC": "2000000", "WATCHDOG_PID": "77"}
    with Watchdog(environment, process_id=77) as watchdog:
        watchdog.alive("preflight")
        assert heard() == ["READY=1\nWATCHDOG=1\nSTATUS=preflight"]
        watchdog.alive("preflight")
        assert heard() == []  # not due
        watchdog.alive("ready")
        assert heard() == ["WATCHDOG=1\nSTATUS=ready"]
        end_s = clock.now_s() + 1.2
        while clock.now_s() < end_s:
            watchdog.alive("ready")
            clock.sleep_s(0.02)
        assert 2 <= len(heard()) <= 3  # every half second: a quarter of the time-out
    assert heard() == ["STOPPING=1\nSTATUS=done"]


@pytest.mark.parametrize("environment", [{}, {"NOTIFY_SOCKET": "/nonexistent/notify"}])
def test_without_systemd_nothing_is_told(environment):
    with Watchdog(environment, process_id=1) as watchdog:
        watchdog.alive("ready")


def test_a_systemd_that_has_gone_or_does_not_read_holds_nobody(tmp_path):
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    listener.bind(str(tmp_path / "notify"))
    with Watchdog({"NOTIFY_SOCKET": str(tmp_path / "notify")}, process_id=1) as watchdog:
        for number in range(5000):
            watchdog.alive(f"phase {number}")
        listener.close()
        watchdog.alive("after")


# -- the unit ----------------------------------------------------------------------------------


def test_the_unit_runs_what_was_asked_for_and_stays_down_after_a_stand_down():
    argv = ["--connect", "serial:/dev/ttyAMA0:921600", "--map", "my map.yaml", "--target", "1,2,3"]
    config = RunConfig(connect=argv[1], map=argv[3], target=argv[5])
    text = unit(config, argv)
    line = next(line for line in text.splitlines() if line.startswith("ExecStart="))
    assert line.endswith(
        'run --connect serial:/dev/ttyAMA0:921600 --map "my map.yaml" --target 1,2,3'
    )
    assert "Type=notify" in text
    assert "WatchdogSec=5" in text
    assert "RestartPreventExitStatus=2 6 7 8" in text
    assert "SuccessExitStatus=130" in text
    assert "KillMode=control-group" in text, "the recorder is not killed with the loop"


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd here")
def test_systemd_has_nothing_to_say_against_the_unit(tmp_path):
    argv = ["--connect", "serial:/dev/ttyAMA0:921600", "--record", "/var/lib/flights 100%"]
    config = RunConfig(connect=argv[1], record=Path(argv[3]))
    file = tmp_path / "mavlink-companion.service"
    file.write_text(unit(config, argv))
    said = subprocess.run(
        ["systemd-analyze", "verify", str(file)], capture_output=True, text=True, check=False
    )
    assert (said.returncode, said.stderr) == (0, "")


@pytest.mark.parametrize(
    "moves", [{"engage": True}, {"takeoff": 5.0}, {"arm": True, "takeoff": 5.0}]
)
def test_a_service_never_moves_the_vehicle_unasked(moves):
    with pytest.raises(UsageError, match="waits for the pilot"):
        unit(RunConfig(connect="udp:0.0.0.0:14540", **moves), [])


# -- the computer ------------------------------------------------------------------------------


def test_the_state_of_this_computer(tmp_path):
    (tmp_path / "thermal_zone0").mkdir()
    (tmp_path / "thermal_zone1").mkdir()
    (tmp_path / "thermal_zone0" / "temp").write_text("48312\n")
    (tmp_path / "thermal_zone1" / "temp").write_text("71500\n")
    (tmp_path / "meminfo").write_text("MemTotal: 8000000 kB\nMemAvailable: 6000000 kB\n")
    (tmp_path / "stat").write_text("cpu 9 9 9 9\ncpu0 10 0 10 80 0\ncpu1 0 0 0 100 0\nintr 1\n")
    probe = ComputerProbe(tmp_path, tmp_path)
    probe.read()
    (tmp_path / "stat").write_text("cpu 9 9 9 9\ncpu0 60 0 10 130 0\ncpu1 0 0 0 200 0\nintr 1\n")
    state = probe.read()
    assert state.core_percent == (50, 0, *[255] * (MAX_CORES - 2))
    assert state.celsius == 72
    assert (state.ram_used_mib, state.ram_total_mib) == (1953, 7812)
    message = computer_status(state, 5000)
    assert (message.temperature_core[0], message.cpu_cores[0], message.ram_total) == (72, 50, 7812)


def test_a_computer_that_tells_nothing(tmp_path):
    state = ComputerProbe(tmp_path, tmp_path).read()
    assert state.celsius == UNKNOWN_CELSIUS
    assert state.ram_total_mib == UNKNOWN_MIB
    assert state.core_percent == (255,) * MAX_CORES


def test_this_very_computer_can_be_read():
    assert ComputerProbe().read().ram_total_mib > 100


def test_the_computers_state_goes_out_with_every_fifth_heartbeat(bench):
    bench.attach(computer=ComputerProbe().read)
    for _ in range(11):
        bench.vehicle.send_heartbeat(4)
    assert len(bench.transport.sent_of("ONBOARD_COMPUTER_STATUS")) == 2
