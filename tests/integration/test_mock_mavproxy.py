"""MAVProxy, unchanged and headless, against both personalities: parameters, modes, arming."""

import socket
import subprocess
import sys
import sysconfig
import time
from pathlib import Path

import pytest

MAVPROXY = Path(sysconfig.get_path("scripts")) / "mavproxy.py"
pytestmark = pytest.mark.skipif(
    not MAVPROXY.exists(),
    reason="MAVProxy is not installed",
)
SPEED = "4"
TROUBLE = ("ERROR", "Traceback", "Exception", "Failed", "link 1 down", "no link")
# MAVProxy's own `mode` command does not work with PX4: it packs a tuple where a number belongs.
SCRIPTS = {
    "ardupilot": [
        ("param show GUID_TIMEOUT", "GUID_TIMEOUT     3.0"),
        ("param set GUID_TIMEOUT 2", ""),
        ("mode LOITER", "Mode LOITER"),
        ("mode GUIDED", "Mode GUIDED"),
        ("arm throttle", "ARMED"),
        ("disarm", "DISARMED"),
        ("param show GUID_TIMEOUT", "GUID_TIMEOUT     2.0"),
    ],
    "px4": [
        ("long DO_SET_MODE 1 6", "Mode OFFBOARD"),
        ("long DO_SET_MODE 1 4 3", "Mode LOITER"),
        ("param show COM_OF_LOSS_T", "COM_OF_LOSS_T    1.0"),
        ("arm throttle", "ARMED"),
        ("disarm", "DISARMED"),
    ],
}


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Station:
    """One MAVProxy: what it is told, and what it has printed."""

    def __init__(self, process, output):
        self.process = process
        self.output = output
        self._read = 0

    def tell(self, line):
        self._read = len(self.output.read_text())
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def wait_for(self, words, timeout_s=40.0):
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            if words in self.output.read_text()[self._read :]:
                return
            assert self.process.poll() is None, self.output.read_text()
            time.sleep(0.05)
        pytest.fail(f"MAVProxy never said {words!r}:\n{self.output.read_text()}")


@pytest.fixture
def station(tmp_path):
    processes = []

    def start(autopilot):
        port = free_port()
        processes.append(
            subprocess.Popen(
                [
                    *(sys.executable, "-m", "sim.mock", "--autopilot", autopilot),
                    *("--connect", f"udpout:127.0.0.1:{port}", "--speed", SPEED),
                    "--exit-with-parent",
                ],
                stdout=subprocess.DEVNULL,
            )
        )
        output = tmp_path / "mavproxy.txt"
        with output.open("w") as printed:
            processes.append(
                subprocess.Popen(
                    [
                        *(sys.executable, str(MAVPROXY), f"--master=udpin:127.0.0.1:{port}"),
                        "--default-modules=link,param,mode,arm,cmdlong",
                        f"--state-basedir={tmp_path}",
                    ],
                    cwd=tmp_path,
                    stdin=subprocess.PIPE,
                    stdout=printed,
                    stderr=subprocess.STDOUT,
                    text=True,
                )
            )
        return Station(processes[-1], output)

    yield start
    for process in processes:
        process.terminate()
    for process in processes:
        if process.stdin is not None:
            process.stdin.close()
        process.wait(10.0)


@pytest.mark.parametrize("autopilot", SCRIPTS)
def test_mavproxy_connects_loads_parameters_changes_mode_and_arms(station, autopilot):
    proxy = station(autopilot)
    proxy.wait_for("online system 1")
    proxy.wait_for("parameters")
    for line, answer in SCRIPTS[autopilot]:
        proxy.tell(line)
        proxy.wait_for(answer)
    printed = proxy.output.read_text()
    assert "Saved" in printed
    assert not [words for words in TROUBLE if words in printed], printed
