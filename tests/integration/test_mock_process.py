"""The mock vehicle as a process: real sockets, signals, exit codes, and pymavlink as a client."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time

import pytest
from pymavlink import mavutil

MOCK = [sys.executable, "-m", "sim.mock"]


def free_port(kind=socket.SOCK_DGRAM):
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture
def start():
    """Start mock processes, and end those that still run."""
    processes = []

    def begin(*arguments):
        process = subprocess.Popen(
            [*MOCK, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        processes.append(process)
        return process

    yield begin
    for process in processes:
        if process.poll() is None:
            process.kill()
        process.communicate()


@pytest.fixture
def connect():
    """Open pymavlink connections as a companion, 1/191, and close them."""
    links = []

    def begin(url):
        link = mavutil.mavlink_connection(
            url, source_system=1, source_component=191, dialect="ardupilotmega"
        )
        links.append(link)
        return link

    yield begin
    for link in links:
        link.close()


def run(*arguments):
    return subprocess.run([*MOCK, *arguments], capture_output=True, text=True, timeout=30)


def hear(link, name, timeout_s=15.0, condition=lambda message: True):
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        message = link.recv_match(type=name, blocking=True, timeout=1.0)
        if message is not None and condition(message):
            return message
    pytest.fail(f"no such {name} within {timeout_s} s")


def command(link, number, *params):
    padded = [*params, *(0.0,) * (7 - len(params))]
    link.mav.command_long_send(1, 1, number, 0, *padded)
    return hear(link, "COMMAND_ACK", condition=lambda ack: ack.command == number).result


@pytest.mark.parametrize(
    ("arguments", "code", "complaint"),
    [
        (["--connect", "carrier:pigeon"], 2, "udpout:127.0.0.1:14540"),
        (["--connect", "udpout:127.0.0.1:notaport"], 2, "expected"),
        (["--connect", "udpout:127.0.0.1:70000"], 2, "expected"),
        (["--connect", "udpin:0.0.0.0:1", "--autopilot", "betaflight"], 2, "betaflight"),
        (["--connect", "udpin:127.0.0.1:14999", "--fault", "t=1,kind=gremlins"], 2, "gps_glitch"),
        (["--connect", "udpin:127.0.0.1:14999", "--target", "kind=ufo"], 2, "waypoints"),
        (["--connect", "udpin:127.0.0.1:14999", "--home", "1,2"], 2, "--home 1,2"),
        (["--connect", "udpin:127.0.0.1:14999", "--speed", "0"], 2, "--speed"),
        (["--connect", "udpin:127.0.0.1:14999", "--sysid", "0"], 2, "--sysid"),
        (["--connect", "udpin:127.0.0.1:14999", "--signing-key", "/no"], 2, "--signing-key /no"),
        (["--connect", "udpin:127.0.0.1:14999", "--map", "/no/such.yaml"], 5, "/no/such.yaml"),
        (["--connect", "udpin:192.0.2.1:14999"], 3, "udpin:192.0.2.1:14999"),
    ],
)
def test_mistakes_end_in_one_line_and_the_right_exit_code(arguments, code, complaint):
    result = run(*arguments)
    assert result.returncode == code
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("mock: ")
    assert complaint in lines[0]


def test_unknown_options_are_refused():
    result = run("--connect", "udpin:127.0.0.1:14999", "--altitude", "3")
    assert result.returncode == 2
    assert "--altitude" in result.stderr


def test_help_reads_like_a_manual():
    text = run("--help").stdout
    for word in (
        "14540",
        "MAVSDK",
        "QGroundControl",
        "second_companion",
        "waypoints",
        "MAVProxy",
        "--signing-key",
        "EXIT CODES",
    ):
        assert word in text
    assert max(map(len, text.splitlines())) <= 80


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_it_cleanly_with_a_report(start, tmp_path, number):
    report = tmp_path / "report.json"
    port = free_port()
    process = start(
        "--connect", f"udpin:127.0.0.1:{port}", "--map", "env1", "--report", str(report)
    )
    assert process.stdout is not None
    assert process.stdout.readline() == (
        f"mock: px4, system 1, on udpin:127.0.0.1:{port} (onboard rates)\n"
    )
    time.sleep(0.3)
    process.send_signal(number)
    _, err = process.communicate(timeout=10)
    assert (process.returncode, err) == (0, "")
    verdict = json.loads(report.read_text())
    assert (verdict["autopilot"], verdict["map"], verdict["contacts"]) == ("px4", "env1", [])


def test_it_ends_with_its_parent(tmp_path):
    port = free_port()
    script = (
        "import subprocess, sys, time\n"
        f"p = subprocess.Popen({MOCK!r} + ['--connect', 'udpin:127.0.0.1:{port}',"
        " '--exit-with-parent'], stdout=subprocess.PIPE)\n"
        "p.stdout.readline(); print(p.pid, flush=True)\n"
    )
    parent = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=30, check=True
    )
    pid = int(parent.stdout)
    deadline = time.monotonic() + 10.0
    while time.monotonic() < deadline:
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return
        time.sleep(0.05)
    os.kill(pid, signal.SIGKILL)
    pytest.fail("the mock outlived its parent")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_nothing_is_left_of_the_command_when_it_is_killed(number):
    port = free_port()
    command = [
        sys.executable,
        "-m",
        "companion.cli",
        "mock",
        "--connect",
        f"udpin:127.0.0.1:{port}",
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        process.stdout.readline()
        process.send_signal(number)
        assert process.stdout.read() == ""  # ends when nobody holds the pipe any more
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
        again.bind(("127.0.0.1", port))


@pytest.mark.parametrize("kind", ["udpout", "udpin", "tcpin"])
def test_pymavlink_arms_and_takes_off_on_every_transport(start, connect, kind):
    port = free_port(socket.SOCK_STREAM if kind == "tcpin" else socket.SOCK_DGRAM)
    theirs = {"udpout": "udpin", "udpin": "udpout", "tcpin": "tcp"}[kind]
    process = start("--connect", f"{kind}:127.0.0.1:{port}", "--speed", "4")
    assert process.stdout is not None
    process.stdout.readline()
    link = connect(f"{theirs}:127.0.0.1:{port}")
    link.mav.heartbeat_send(18, 8, 0, 0, 4)
    heartbeat = hear(link, "HEARTBEAT", condition=lambda m: m.system_status == 3)
    assert (heartbeat.autopilot, heartbeat.get_srcSystem()) == (12, 1)
    assert command(link, 400, 1.0) == 0
    assert command(link, 22, 0, 0, 0, *(float("nan"),) * 3, 489.4 + 5.0) == 0
    hear(link, "LOCAL_POSITION_NED", condition=lambda m: m.z < -4.0)


def test_pymavlink_flies_ardupilot_after_asking_for_streams(start, connect):
    port = free_port(socket.SOCK_STREAM)
    process = start(
        *("--autopilot", "ardupilot", "--connect", f"tcpin:127.0.0.1:{port}", "--speed", "4")
    )
    assert process.stdout is not None
    assert process.stdout.readline().endswith("(HEARTBEAT until asked)\n")
    link = connect(f"tcp:127.0.0.1:{port}")
    heartbeat = hear(link, "HEARTBEAT", condition=lambda m: m.system_status == 3)
    assert (heartbeat.autopilot, heartbeat.custom_mode) == (3, 0)
    link.mav.request_data_stream_send(1, 1, 6, 10, 1)
    hear(link, "LOCAL_POSITION_NED")
    assert command(link, 176, 1, 4) == 0
    assert command(link, 400, 1.0) == 0
    assert command(link, 22, 0, 0, 0, 0, 0, 0, 5.0) == 0
    hear(link, "LOCAL_POSITION_NED", condition=lambda m: m.z < -4.5)


def test_two_links_share_heartbeats_and_texts_go_where_a_ground_station_is(start, connect):
    onboard, ground = free_port(), free_port()
    urls = [f"udpout:127.0.0.1:{port}" for port in (onboard, ground)]
    start("--connect", urls[0], "--connect", urls[1])
    companion, station = (connect(f"udpin:127.0.0.1:{port}") for port in (onboard, ground))
    hear(station, "HEARTBEAT")
    station.mav.srcSystem, station.mav.srcComponent = 255, 190
    heard, texts = set(), []
    deadline = time.monotonic() + 15.0
    while time.monotonic() < deadline and not (255 in heard and texts):
        station.mav.heartbeat_send(6, 8, 0, 0, 4)
        companion.mav.command_long_send(1, 1, 176, 0, 1, 99, 0, 0, 0, 0, 0)
        for _ in range(200):
            message = companion.recv_match(blocking=True, timeout=0.01)
            if message is not None and message.get_type() == "HEARTBEAT":
                heard.add(message.get_srcSystem())
            assert message is None or message.get_type() != "STATUSTEXT"
            message = station.recv_match(type="STATUSTEXT", blocking=False)
            texts += [] if message is None else [message.text]
    assert heard == {1, 255}
    assert texts[0] == "Unsupported main mode\t"


def test_takeover_in_flight_is_logged_and_reported(start, connect, tmp_path):
    port = free_port()
    report = tmp_path / "report.json"
    process = start(
        *("--connect", f"udpout:127.0.0.1:{port}", "--speed", "4", "--report", str(report)),
        *("--fault", "from=offboard,t=6,kind=rc_takeover"),
    )
    link = connect(f"udpin:127.0.0.1:{port}")
    hear(link, "HEARTBEAT", condition=lambda m: m.system_status == 3)

    def stream():
        link.mav.set_position_target_local_ned_send(
            0, 1, 1, 1, 0xDC7, 0, 0, 0, 0, 0, -1.0, 0, 0, 0, 0, 0
        )

    stream()
    assert command(link, 176, 1, 6) == 0
    stream()
    assert command(link, 400, 1.0) == 0
    deadline = time.monotonic() + 20.0
    while time.monotonic() < deadline:
        stream()
        message = link.recv_match(type="HEARTBEAT", blocking=True, timeout=0.05)
        if message is not None and message.custom_mode == 0x00030000:
            break
    for _ in range(3):  # a bad companion: goes on sending
        stream()
        time.sleep(0.05)
    process.terminate()
    _, err = process.communicate(timeout=10)
    assert re.search(
        r"^mock: \d+\.\d\d s: fault from=offboard,t=6,kind=rc_takeover$", err, re.MULTILINE
    )
    verdict = json.loads(report.read_text())
    assert verdict["setpoints_outside_offboard"] >= 3
    assert "POSCTL armed" in [words for _, words in verdict["timeline"]]


def test_a_bad_companion_fails_the_mock_visibly(start, connect, tmp_path):
    port = free_port()
    report = tmp_path / "report.json"
    process = start(
        *("--connect", f"udpout:127.0.0.1:{port}", "--speed", "4", "--report", str(report))
    )
    link = connect(f"udpin:127.0.0.1:{port}")
    hear(link, "HEARTBEAT")
    link.mav.heartbeat_send(6, 8, 0, 0, 4)
    for _ in range(3):
        link.mav.set_position_target_local_ned_send(
            0, 1, 1, 1, 0xDC7, 0, 0, 0, float("nan"), 0, 0, 0, 0, 0, 0, 0
        )
    assert command(link, 176, 1, 4, 3) == 0
    process.terminate()
    _, err = process.communicate(timeout=10)
    assert process.returncode == 1
    assert "complaint: 1/191 sends setpoints with NaN" in err
    assert (
        "mock: FAILED: 1/191 sends setpoints with NaN, infinite or absurd values (3 times)" in err
    )
    verdict = json.loads(report.read_text())
    assert verdict["passed"] is False
    assert verdict["complaints_by_sender"]["1/191"] == {"bad_numbers": 3, "heartbeat_as_gcs": 1}


def test_two_vehicles_call_one_port(start, connect):
    port = free_port()
    for sysid in ("1", "2"):
        start("--sysid", sysid, "--connect", f"udpout:127.0.0.1:{port}", "--speed", "4")
    link = connect(f"udpin:127.0.0.1:{port}")
    for sysid in (1, 2):
        hear(link, "HEARTBEAT", condition=lambda m, sysid=sysid: m.get_srcSystem() == sysid)
    link.mav.command_long_send(2, 1, 400, 0, 1.0, 0, 0, 0, 0, 0, 0)
    assert hear(link, "COMMAND_ACK").get_srcSystem() == 2
