"""The companion from the ground to the target on the mock ArduCopter, and what it may not do."""

import json
import socket
import subprocess
import sys

import pytest


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture
def mock(tmp_path):
    """Start a mock ArduCopter; its ``verdict`` ends it."""
    processes = []

    class Mock:
        def __init__(self, *options):
            self.port = free_port()
            self.report = tmp_path / "report.json"
            processes.append(
                subprocess.Popen(
                    [
                        *(sys.executable, "-m", "sim.mock", "--autopilot", "ardupilot"),
                        *("--connect", f"udpout:127.0.0.1:{self.port}", "--map", "env1"),
                        *("--report", str(self.report), "--exit-with-parent", *options),
                    ],
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                )
            )

        def verdict(self):
            processes[-1].terminate()
            processes[-1].wait(10.0)
            return json.loads(self.report.read_text())

    yield Mock
    for process in processes:
        if process.poll() is None:
            process.kill()
        process.wait()


def fly(folder, actor, connect):
    """Run the companion to its end and return its exit code and what it said."""
    finished = subprocess.run(
        [
            *(sys.executable, "-m", "companion.cli", "run", "--connect", connect),
            *("--actor", str(actor), "--map", "env1", "--target", "34,10,6"),
            *("--takeoff", "6", "--arm", "--engage"),
        ],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=100,
    )
    return finished.returncode, finished.stdout + finished.stderr


def test_from_the_ground_to_the_target(tmp_path, mock, constant_actor):
    vehicle = mock()
    code, said = fly(tmp_path, constant_actor((1.0, 0.0, 0.0)), f"udpin:127.0.0.1:{vehicle.port}")
    assert code == 0, said
    verdict = vehicle.verdict()
    assert verdict["contacts"] == []
    words = [words for _, words in verdict["timeline"]]
    assert (words[0], words[-2:]) == ("STABILIZE disarmed", ["GUIDED armed", "BRAKE armed"])
    assert verdict["setpoints_refused"] == 0
    assert verdict["setpoints_after_mode_shown"] <= 1


def test_a_pilot_who_switches_to_loiter_is_left_alone(tmp_path, mock, constant_actor):
    vehicle = mock("--fault", "from=offboard,t=1,kind=rc_takeover")
    code, said = fly(tmp_path, constant_actor((0.2, 0.0, 0.0)), f"udpin:127.0.0.1:{vehicle.port}")
    assert code == 7, said
    verdict = vehicle.verdict()
    assert verdict["timeline"][-1][1] == "LOITER armed"
    assert verdict["setpoints_after_mode_shown"] <= 1


def test_the_built_in_mock_is_started_by_name(tmp_path, constant_actor):
    code, said = fly(tmp_path, constant_actor((1.0, 0.0, 0.0)), "mock:ardupilot")
    assert code == 0, said
    assert "ardupilot 4.6.3" in said
