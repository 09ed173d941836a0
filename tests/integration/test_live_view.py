"""A whole flight whose recorder is killed, or whose viewer stops: it arrives all the same."""

import json
import os
import re
import signal
import subprocess
import sys

import psutil
import pytest
from rerun.chunk import RrdReader

from companion.clock import now_s, sleep_s
from companion.session.viewer import free_port, viewer_binary

pytestmark = pytest.mark.slow
PATIENCE_S = 60.0
FLIGHT = (
    *("run", "--connect", "mock:px4", "--map", "env1", "--target", "20,20,30", "--json"),
    *("--arm", "--takeoff", "15", "--engage", "--rerun", "serve"),
)


class Flight:
    """``companion run`` in a process of its own, its log read line by line."""

    def __init__(self, folder):
        self.process = subprocess.Popen(
            [sys.executable, "-m", "companion.cli", *FLIGHT, "--record", str(folder)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.said = []

    def until(self, pattern):
        """Read the log until a line matches; return the match."""
        for line in self.process.stderr:
            self.said.append(line)
            if match := re.search(pattern, line):
                return match
        pytest.fail("".join(self.said))

    def recorder(self):
        deadline_s = now_s() + PATIENCE_S
        while now_s() < deadline_s:
            for child in psutil.Process(self.process.pid).children(recursive=True):
                if any("recorder_process" in word for word in child.cmdline()):
                    return child
            sleep_s(0.05)
        pytest.fail("there is no recorder")

    def summary(self):
        """Wait for the end."""
        out, err = self.process.communicate(timeout=120.0)
        self.said.append(err)
        return json.loads(out)


@pytest.fixture
def flight(tmp_path):
    flight = Flight(tmp_path)
    yield flight
    flight.process.kill()
    flight.process.communicate()


def test_a_recorder_that_is_killed_does_not_end_the_flight(flight):
    flight.until("engaged")
    flight.recorder().kill()
    flight.until("the recorder has died; the flight goes on")
    summary = flight.summary()
    assert summary["outcome"] == "arrived"
    assert summary["setpoints_sent"] > 100


def test_a_viewer_that_stops_is_not_noticed(flight, tmp_path):
    address = flight.until(r"rerun --connect (\S+)").group(1)
    command = [str(viewer_binary()), "--headless", "--port", str(free_port())]
    viewer = subprocess.Popen(
        [*command, "--bind", "127.0.0.1", "--connect", address],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        flight.until("engaged")
        os.kill(viewer.pid, signal.SIGSTOP)
        summary = flight.summary()
    finally:
        viewer.kill()
        viewer.wait()
    assert summary["outcome"] == "arrived"
    (recording,) = tmp_path.glob("*/session.rrd")
    paths = {str(chunk.entity_path) for chunk in RrdReader(str(recording)).stream()}
    assert {"/world/vehicle", "/plots/speed", "/__properties/summary"} <= paths
