"""The recorder against everything that may happen to it: nothing of it may reach the flight."""

import os
import signal
import subprocess
import sys

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import common

from companion.clock import now_s, sleep_s
from companion.session.recorder import Recorder
from companion.session.records import (
    ActorRecord,
    Event,
    MapRecord,
    Raw,
    SessionStart,
    Tick,
    VehicleRecord,
)
from companion.vehicle import Severity

START = SessionStart(
    session_id="test",
    start_utc_us=1_795_356_187_000_000,
    map=MapRecord("box", [40.0, 40.0, 30.0]),
    actor=ActorRecord("none"),
    vehicle=VehicleRecord(1, "px4"),
    config={},
    v_max_mps=4.0,
    margin_m=2.0,
    arrival_radius_m=5.0,
)
PATIENCE_S = 60.0


def heartbeats(count):
    sender = common.MAVLink(None, srcSystem=1, srcComponent=1)
    for _ in range(count):
        yield bytes(common.MAVLink_heartbeat_message(2, 12, 81, 0, 4, 3).pack(sender))
        sender.seq = (sender.seq + 1) % 256


def frames_in(path):
    log = mavutil.mavlink_connection(str(path))
    count = 0
    while log.recv_match(type="HEARTBEAT") is not None:
        count += 1
    log.close()
    return count


def tick(index):
    return Tick(time_s=index / 20, position_enu_m=[float(index % 30), 5.0, 10.0])


def wait_until(condition):
    deadline_s = now_s() + PATIENCE_S
    while not condition():
        assert now_s() < deadline_s
        sleep_s(0.02)


@pytest.fixture
def recorder(tmp_path):
    recorder = Recorder(tmp_path)
    yield recorder
    recorder.close(PATIENCE_S)


def test_everything_handed_over_is_written(tmp_path, recorder):
    recorder.put(START)
    for index, frame in enumerate(heartbeats(500)):
        recorder.put(tick(index))
        recorder.put(Raw(index % 2 == 0, index / 20, frame))
    assert recorder.close(PATIENCE_S)
    assert not recorder.alive
    assert recorder.dropped == 0
    assert recorder.take_messages() == []
    assert frames_in(tmp_path / "flight.tlog") == 500


def test_closing_twice_is_harmless(recorder):
    assert recorder.close(PATIENCE_S)
    assert recorder.close(PATIENCE_S)


def test_a_killed_recorder_is_noticed_and_leaves_a_readable_log(tmp_path, recorder):
    recorder.put(START)
    for frame in heartbeats(100):
        recorder.put(Raw(False, 0.0, frame))
    wait_until(lambda: (tmp_path / "flight.tlog").exists())
    wait_until(lambda: frames_in(tmp_path / "flight.tlog") == 100)
    os.kill(recorder.process_id, signal.SIGKILL)

    def noticed():
        recorder.put(tick(0))
        return not recorder.alive

    wait_until(noticed)
    dropped = recorder.dropped
    recorder.put(tick(1))
    assert recorder.dropped == dropped + 1
    assert not recorder.close(PATIENCE_S)
    assert frames_in(tmp_path / "flight.tlog") == 100


def test_a_stopped_recorder_costs_the_oldest_records_only(tmp_path):
    recorder = Recorder(tmp_path, backlog_bytes=200_000)
    recorder.put(START)
    wait_until(lambda: (tmp_path / "flight.tlog").exists())
    os.kill(recorder.process_id, signal.SIGSTOP)
    sent = 2000
    for index in range(sent):  # more than the pipe and the backlog hold
        recorder.put(Raw(False, index / 20, b"\xfe\x08" + bytes([index % 256] * 1014)))
    assert recorder.alive
    assert 0 < recorder.dropped < sent
    last = next(iter(heartbeats(1)))
    recorder.put(Raw(False, sent / 20, last))
    os.kill(recorder.process_id, signal.SIGCONT)
    assert recorder.close(PATIENCE_S)
    assert (tmp_path / "flight.tlog").read_bytes().endswith(last)


def test_a_record_that_is_not_data_is_counted_not_raised(recorder):
    recorder.put(Tick(time_s=0.0, distance_m=object()))
    assert recorder.dropped == 1
    assert recorder.alive


def test_a_folder_that_cannot_be_written_is_said(tmp_path):
    recorder = Recorder(tmp_path / "missing")
    recorder.put(START)
    recorder.put(Event(0.0, Severity.INFO, "companion", "still flying"))
    assert recorder.close(PATIENCE_S)
    assert any("flight.tlog" in line for line in recorder.take_messages())


def test_the_flying_process_never_loads_rerun(tmp_path):
    code = (
        "import sys, pathlib\n"
        "from companion.session.recorder import Recorder\n"
        "from companion.session.records import Tick\n"
        "from companion.session import folder\n"
        "recorder = Recorder(pathlib.Path(sys.argv[1]))\n"
        "recorder.put(Tick(time_s=0.0))\n"
        "recorder.close(60.0)\n"
        "print(sorted({'rerun', 'pyarrow', 'rerun_bindings'} & set(sys.modules)))\n"
        "import threading; print(threading.active_count())\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=True
    )
    assert done.stdout == "[]\n1\n"
