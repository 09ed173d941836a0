"""``companion run`` as people use it: real processes and sockets, the mock's own verdict."""

import contextlib
import json
import os
import resource
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from pymavlink import mavutil

from tests.integration.running import COMPANION, free_port

MOCK = [sys.executable, "-m", "sim.mock", "--autopilot", "px4"]


@pytest.fixture
def mock(tmp_path):
    processes = []

    def start(*options):
        report = tmp_path / f"verdict{len(processes)}.json"
        process = subprocess.Popen(
            [*MOCK, "--report", str(report), *map(str, options)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        processes.append(process)

        def verdict():
            process.terminate()
            process.wait(10.0)
            return json.loads(report.read_text())

        return verdict

    yield start
    for process in processes:
        if process.poll() is None:
            process.kill()
        process.wait()


UP = ("--takeoff", 6, "--arm", "--engage")


def test_from_the_ground_to_the_target_over_mavlink(run, constant_actor, tmp_path):
    """One command; the session folder holds what DESIGN 6 and the README promise."""
    started = run(
        "--connect", "mock:px4", "--actor", constant_actor((1.0, 0.0, 0.0)),
        "--map", "env1", "--target", "34,10,6", *UP,
    )  # fmt: skip
    summary = started.finish()
    assert (summary["outcome"], summary["exit_code"], started.process.returncode) == (
        "arrived",
        0,
        0,
    )
    assert set(summary) >= {
        "reason", "session_dir", "duration_s", "distance_flown_m", "final_distance_m",
        "min_clearance_m", "max_speed_mps", "setpoints_sent", "setpoint_rate_hz",
        "jitter_p99_ms", "latency_p50_ms", "latency_p99_ms", "late_ticks",
        "shield_interventions", "takeovers", "link_loss_percent",
    }  # fmt: skip
    assert summary["final_distance_m"] < 5.0
    assert summary["setpoint_rate_hz"] == pytest.approx(20.0, abs=1.0)
    (folder,) = (tmp_path / "sessions").iterdir()
    assert json.loads((folder / "summary.json").read_text())["outcome"] == "arrived"
    assert json.loads((folder / "config.json").read_text())["map"] == "env1"
    assert (folder / "session.rrd").stat().st_size > 20_000

    log = mavutil.mavlink_connection(str(folder / "flight.tlog"), dialect="ardupilotmega")
    seen = {}
    while (message := log.recv_match()) is not None:
        key = (message.get_srcSystem(), message.get_srcComponent(), message.get_type())
        seen[key] = seen.get(key, 0) + 1
    log.close()
    assert seen[1, 191, "SET_POSITION_TARGET_LOCAL_NED"] == summary["setpoints_sent"]
    assert seen[1, 191, "HEARTBEAT"] > 5
    assert seen[1, 1, "LOCAL_POSITION_NED"] > 100
    assert not any("BAD_DATA" in key[2] for key in seen)
    assert not any(key[2] == "PARAM_SET" for key in seen)


def test_pilot_takes_over_in_mid_flight(run, mock, constant_actor):
    port = free_port()
    verdict = mock(
        "--connect", f"udpout:127.0.0.1:{port}", "--map", "env1", "--radio",
        "--fault", "t=4,from=offboard,kind=rc_takeover",
    )  # fmt: skip
    started = run(
        "--connect", f"udp:127.0.0.1:{port}", "--actor", constant_actor(),
        "--map", "env1", "--target", "80,10,6", *UP,
    )  # fmt: skip
    summary = started.finish()
    assert (summary["outcome"], summary["exit_code"]) == ("stood_down", 7)
    assert summary["takeovers"] == 1
    assert "POSCTL" in summary["reason"]
    assert verdict()["contacts"] == []


def test_interrupt_gives_the_vehicle_back(run, mock, constant_actor):
    port = free_port()
    mock("--connect", f"udpout:127.0.0.1:{port}", "--map", "env1")
    started = run(
        "--connect", f"udpin://127.0.0.1:{port}", "--actor", constant_actor((0.0, 0.0, 0.0)),
        "--map", "env1", "--target", "80,10,6", *UP,
    )  # fmt: skip
    started.wait_for("engaged")
    started.process.send_signal(signal.SIGINT)
    summary = started.finish()
    assert (summary["outcome"], summary["exit_code"]) == ("stopped", 130)
    assert "not confirmed" not in summary["reason"]


def test_killed_outright_the_recording_still_opens(run, mock, constant_actor, tmp_path):
    from rerun.chunk import RrdReader

    port = free_port()
    mock("--connect", f"udpout:127.0.0.1:{port}", "--map", "env1")
    started = run(
        "--connect", f"udp:127.0.0.1:{port}", "--actor", constant_actor((0.0, 0.0, 0.0)),
        "--map", "env1", "--target", "80,10,6", *UP,
    )  # fmt: skip
    started.wait_for("engaged")
    time.sleep(3.0)
    started.process.kill()
    started.finish()
    (folder,) = (tmp_path / "sessions").iterdir()
    deadline = time.monotonic() + 20.0
    while subprocess.run(["pgrep", "-f", str(folder)], stdout=subprocess.DEVNULL).returncode == 0:
        assert time.monotonic() < deadline, "the recorder process outlives its session"
        time.sleep(0.1)
    paths = {chunk.entity_path for chunk in RrdReader(str(folder / "session.rrd")).stream()}
    assert any(path.startswith("/world") for path in paths)
    text = subprocess.run(
        [*COMPANION, "review", str(folder), "--text"], capture_output=True, text=True, check=False
    )
    assert text.returncode == 0, text.stderr
    assert "Traceback" not in text.stderr


def test_speed_is_capped_by_what_the_vehicle_does_without_us(run, constant_actor):
    """PX4's defaults: 1 s on, then braking; 2.6 m/s keep that within 5 m."""
    started = run(
        "--connect", "mock:px4", "--actor", constant_actor((1.0, 0.0, 0.0)),
        "--map", "env1", "--target", "34,10,6", "--margin", 5, "--cap-by-failsafe", *UP,
    )  # fmt: skip
    summary = started.finish()
    assert summary["outcome"] == "arrived", summary
    assert summary["v_max_mps"] == pytest.approx(2.61, abs=0.01)
    assert summary["max_speed_mps"] < 2.9
    log = "".join(started.log)
    assert "if this program dies, PX4 flies on for 1.0 s" in log
    assert "v_max lowered from 5 to 2.6 m/s" in log


def test_without_the_flag_blind_travel_is_only_told(run, constant_actor):
    started = run(
        "--connect", "mock:px4", "--actor", constant_actor(), "--map", "env1",
        "--target", "34,10,6", "--shadow",
    )  # fmt: skip
    started.wait_for("waiting: ")
    started.process.send_signal(signal.SIGINT)
    assert started.finish()["v_max_mps"] == 5.0
    (line,) = (line for line in started.log if "blind travel" in line)
    assert "13.3 m" in line
    assert "1.3 m/s" in line


SUMMARY_KEYS = {
    "outcome", "reason", "reason_code", "exit_code", "session_dir", "duration_s",
    "distance_flown_m", "final_distance_m", "min_clearance_m", "max_speed_mps", "setpoints_sent",
    "setpoint_rate_hz", "jitter_p99_ms", "latency_p50_ms", "latency_p99_ms", "late_ticks",
    "shield_interventions", "takeovers", "link_loss_percent",
}  # fmt: skip


def full_disk():
    """Let no file grow beyond 300 kB: what a full disk is to whoever writes."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))


def test_a_full_disk_and_two_interrupts_in_flight(run, mock, constant_actor):
    """The flight goes on and says so; even the second Ctrl-C leaves a whole summary."""
    port = free_port()
    mock("--connect", f"udpout:127.0.0.1:{port}", "--map", "env1")
    started = run(
        "--connect", f"udp:127.0.0.1:{port}", "--actor", constant_actor((0.0, 0.0, 0.0)),
        "--map", "env1", "--target", "80,10,6", *UP, preexec_fn=full_disk,
    )  # fmt: skip
    started.wait_for("engaged")
    started.wait_for("File too large")
    started.process.send_signal(signal.SIGINT)
    time.sleep(0.1)
    started.process.send_signal(signal.SIGINT)
    summary = started.finish()
    assert (summary["outcome"], summary["exit_code"]) == ("stopped", 130)
    assert summary["reason_code"] == "signal"
    assert set(summary) >= SUMMARY_KEYS
    assert summary["setpoints_sent"] > 20
    assert json.loads((Path(summary["session_dir"]) / "summary.json").read_text()) == summary


def test_under_systemd_with_a_log_that_nobody_reads(mock, constant_actor, tmp_path):
    """The loop tells systemd that it lives, and a full pipe behind stderr does not hold it."""
    port = free_port()
    mock("--connect", f"udpout:127.0.0.1:{port}", "--map", "env1")
    unread, stderr = os.pipe()
    os.set_blocking(stderr, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(stderr, bytes(4096))
    os.set_blocking(stderr, True)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.settimeout(60.0)
        process = subprocess.Popen(
            [
                *COMPANION, "run", "--json", "--connect", f"udp:127.0.0.1:{port}", "--actor",
                str(constant_actor()), "--map", "env1", "--target", "80,10,6",
                "--record", str(tmp_path / "sessions"),
            ],
            stdout=subprocess.PIPE,
            stderr=stderr,
            env={**os.environ, "NOTIFY_SOCKET": str(tmp_path / "notify"),
                 "WATCHDOG_USEC": "2000000"},
        )  # fmt: skip
        told = [systemd.recv(4096).decode()]
        while "STATUS=ready" not in told[-1] or len(told) < 4:
            told.append(systemd.recv(4096).decode())
        process.send_signal(signal.SIGTERM)
        while "STOPPING=1" not in told[-1]:
            told.append(systemd.recv(4096).decode())
    out, _ = process.communicate(timeout=60)
    os.close(unread)
    os.close(stderr)
    assert "READY=1" in told[0]
    assert not any("READY=1" in text for text in told[1:])
    summary = json.loads(out)
    assert (summary["outcome"], process.returncode) == ("stopped", 130)


def test_a_tcp_link_that_is_cut_is_a_lost_link(run, mock, constant_actor):
    port = free_port(socket.SOCK_STREAM)
    verdict = mock("--connect", f"tcpin:127.0.0.1:{port}", "--map", "env1")
    deadline = time.monotonic() + 30.0
    while True:  # the mock is still starting
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0):
            break
        assert time.monotonic() < deadline
        time.sleep(0.1)
    started = run(
        "--connect", f"tcp:127.0.0.1:{port}", "--actor", constant_actor(), "--map", "env1",
        "--target", "80,10,6",
    )  # fmt: skip
    started.wait_for("ready: ")
    verdict()
    summary = started.finish()
    assert (summary["outcome"], summary["exit_code"]) == ("link_lost", 4)
    assert summary["reason_code"] == "link_failed"
    assert "TCP" in summary["reason"]
