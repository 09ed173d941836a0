"""The recorder against everything that may happen to it: nothing of it may reach the flight."""

import os
import re
import resource
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import common
from rerun.chunk import RrdReader

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
from companion.session.viewer import free_port, viewer_binary
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
PATIENCE_S = 30.0


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


def ticks_in(path):
    """Ticks in a recording that may still be written to."""
    try:
        chunks = list(RrdReader(str(path)).stream())
    except (OSError, RuntimeError, ValueError):
        return 0
    vehicle = [chunk for chunk in chunks if chunk.entity_path == "/world/vehicle"]
    return sum(chunk.to_record_batch().num_rows for chunk in vehicle)


def tick(index):
    return Tick(time_s=index / 20, position_enu_m=[float(index % 30), 5.0, 10.0])


def full_tick(index):
    """A tick with everything in it, so that a stream nobody reads fills up."""
    return Tick(
        time_s=index / 20,
        position_enu_m=[float(index % 30), 5.0, 10.0],
        velocity_enu_mps=[1.0, 2.0, 3.0],
        target_enu_m=[20.0, 20.0, 10.0],
        observation=[index / 2000] * 59,
        safe_enu_mps=[1.0, 2.0, 3.0],
        clearance_m=4.0,
        rates_hz={"HEARTBEAT": 1.0},
    )


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


def test_what_the_link_says_goes_with_the_next_tick(tmp_path, recorder):
    recorder.put(START)
    log = tmp_path / "flight.tlog"
    wait_until(log.exists)
    for frame in heartbeats(100):
        recorder.put(Raw(False, 0.0, frame))
    sleep_s(0.3)
    assert frames_in(log) == 0
    recorder.put(tick(0))
    wait_until(lambda: frames_in(log) == 100)


def test_closing_twice_is_harmless(recorder):
    assert recorder.close(PATIENCE_S)
    assert recorder.close(PATIENCE_S)


def test_a_killed_recorder_is_noticed_and_leaves_a_readable_log(tmp_path, recorder):
    recorder.put(START)
    for frame in heartbeats(100):
        recorder.put(Raw(False, 0.0, frame))
    recorder.put(tick(0))
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
        if index % 10 == 9:
            recorder.put(tick(index))
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


def test_ctrl_c_on_the_terminal_does_not_end_the_recording(tmp_path, recorder):
    recorder.put(START)
    wait_until(lambda: (tmp_path / "session.rrd").exists())
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGABRT):
        os.kill(recorder.process_id, number)
    recorder.put(Raw(True, 1.0, next(heartbeats(1))))
    assert recorder.close(PATIENCE_S)
    assert frames_in(tmp_path / "flight.tlog") == 1


@pytest.mark.filterwarnings("ignore:RRD file has no footer")
def test_when_everything_is_killed_the_recording_still_opens(tmp_path):
    command = [sys.executable, __file__, str(tmp_path), "1000"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as flying:
        process_id = int(flying.stdout.readline())
        wait_until(lambda: ticks_in(tmp_path / "session.rrd") > 100)
        os.kill(process_id, signal.SIGKILL)
        flying.kill()
    assert ticks_in(tmp_path / "session.rrd") > 100


@pytest.mark.filterwarnings("ignore:RRD file has no footer")
def test_when_the_flying_process_dies_the_recorder_finishes(tmp_path):
    subprocess.run([sys.executable, __file__, str(tmp_path), "3"], check=False)
    wait_until(lambda: ticks_in(tmp_path / "session.rrd") == 300)


def test_a_full_disk_is_said_and_the_pipe_drained(tmp_path):
    limit = 100_000  # bytes a file may have, as on a disk that fills up
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
    try:
        recorder = Recorder(tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    recorder.put(START)
    for frame in heartbeats(20_000):
        recorder.put(Raw(False, 0.0, frame))
        recorder.put(tick(0))
    assert recorder.alive
    assert recorder.close(PATIENCE_S)
    assert recorder.dropped == 0
    assert any("flight.tlog is incomplete" in line for line in recorder.take_messages())


def test_without_rerun_the_rest_is_recorded_and_it_is_said(tmp_path, monkeypatch):
    missing = tmp_path / "path" / "rerun.py"
    missing.parent.mkdir()
    missing.write_text("raise ImportError('not installed')")
    monkeypatch.setenv("PYTHONPATH", str(missing.parent))
    recorder = Recorder(tmp_path)
    recorder.put(START)
    recorder.put(Raw(False, 0.0, next(heartbeats(1))))
    assert recorder.close(PATIENCE_S)
    assert "Rerun is not installed" in recorder.take_messages()[0]
    assert frames_in(tmp_path / "flight.tlog") == 1
    assert not (tmp_path / "session.rrd").exists()


def test_the_live_view_is_hosted_on_loopback_only(tmp_path):
    recorder = Recorder(tmp_path, live="serve")
    recorder.put(START)
    messages = []

    def announced():
        messages.extend(recorder.take_messages())
        return messages

    wait_until(announced)
    (port,) = re.findall(r"rerun --connect rerun\+http://127\.0\.0\.1:(\d+)/proxy", messages[0])
    socket.create_connection(("127.0.0.1", int(port)), timeout=PATIENCE_S).close()
    listening = Path("/proc/net/tcp").read_text().upper()
    assert f"0100007F:{int(port):04X}" in listening
    assert f"00000000:{int(port):04X}" not in listening
    assert recorder.close(PATIENCE_S)


@pytest.mark.parametrize(
    "viewer",
    [
        "absent",
        "stopped",
        pytest.param("watching", marks=pytest.mark.slow),
        pytest.param("killed", marks=pytest.mark.slow),
    ],
)
def test_whatever_the_viewer_does_the_recording_is_whole(tmp_path, viewer):
    """It hosts, viewers come: one that reads no more must not hold up the file or the flight."""
    recorder = Recorder(tmp_path, live="serve")
    recorder.put(START)
    messages = []

    def announced():
        messages.extend(recorder.take_messages())
        return messages

    wait_until(announced)
    (address,) = re.findall(r"rerun --connect (\S+)", messages[0])
    watching = None
    if viewer != "absent":
        command = [str(viewer_binary()), "--headless", "--port", str(free_port())]
        watching = subprocess.Popen(
            [*command, "--bind", "127.0.0.1", "--connect", address],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    try:
        for index in range(100):
            recorder.put(tick(index))
        if viewer == "stopped":
            os.kill(watching.pid, signal.SIGSTOP)
        elif viewer == "killed":
            watching.kill()
        for index in range(100, 2000):
            recorder.put(full_tick(index))
        assert recorder.alive
        assert recorder.dropped == 0
        assert recorder.close(PATIENCE_S)
    finally:
        if watching is not None:
            watching.kill()
            watching.wait()
    assert recorder.take_messages() == []
    assert ticks_in(tmp_path / "session.rrd") == 2000


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


def fly_and_die(folder, duration_s):
    """The flying process of the tests above: no end, no good-bye."""
    recorder = Recorder(folder)
    print(recorder.process_id, flush=True)
    recorder.put(START)
    for index in range(round(100 * duration_s)):
        recorder.put(tick(index))
        sleep_s(0.01)
    os.kill(os.getpid(), signal.SIGKILL)


if __name__ == "__main__":
    fly_and_die(Path(sys.argv[1]), float(sys.argv[2]))
