"""Runs that never begin: nobody there, too many, a wrong option or file; each says why."""

import re
import socket
import threading

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from tests.integration.running import Run, free_port


def heartbeat(system_id, autopilot=dialect.MAV_AUTOPILOT_PX4):
    mavlink = dialect.MAVLink(None, system_id, 1)
    return dialect.MAVLink_heartbeat_message(2, autopilot, 0x1D, 0x03040000, 3, 3).pack(mavlink)


class Chatter(threading.Thread):
    """Sends datagrams to a port, ten times a second, until it is stopped."""

    def __init__(self, port, *datagrams):
        super().__init__(daemon=True)
        self.port, self.datagrams, self.over = port, datagrams, threading.Event()

    def run(self):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            while not self.over.wait(0.1):
                for data in self.datagrams:
                    out.sendto(data, ("127.0.0.1", self.port))


@pytest.fixture
def chatter():
    started = []

    def start(port, *datagrams):
        started.append(Chatter(port, *datagrams))
        started[-1].start()

    yield start
    for thread in started:
        thread.over.set()
        thread.join(5.0)


def refused(started):
    """Return what a refused run said: one line on stderr, JSON with the same code."""
    summary = started.finish()
    assert summary["exit_code"] == started.process.returncode
    complaints = [line for line in started.log if line.startswith("companion: ")]
    assert len(complaints) == 1, started.log
    assert summary["session_dir"] is None
    return started.process.returncode, complaints[0]


def test_nobody_on_the_link(run, constant_actor):
    started = run("--connect", f"udp:127.0.0.1:{free_port()}", "--actor", constant_actor())
    code, line = refused(started)
    assert code == 4
    assert "heard" in line


def test_garbage_on_the_link(run, chatter, constant_actor):
    port = free_port()
    chatter(port, bytes(range(256)), b"\xfd\xff\x00" * 50)
    started = run("--connect", f"udp:127.0.0.1:{port}", "--actor", constant_actor())
    code, line = refused(started)
    assert code == 4
    assert re.search(r"MAVLink", line)


def test_two_autopilots_need_a_choice(run, chatter, constant_actor):
    port = free_port()
    chatter(port, heartbeat(1), heartbeat(7))
    started = run("--connect", f"udp:127.0.0.1:{port}", "--actor", constant_actor())
    code, line = refused(started)
    assert code == 5
    assert "--vehicle-sysid" in line
    assert "1" in line
    assert "7" in line


def test_port_in_use(run, constant_actor):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        started = run(
            "--connect", f"udp:127.0.0.1:{taken.getsockname()[1]}", "--actor", constant_actor()
        )
        assert refused(started)[0] == 3


@pytest.mark.parametrize(
    ("options", "code", "says"),
    [
        (["--connect", "carrier-pigeon:1"], 2, "udp:"),
        (["--connect", "mock:px4", "--map", "atlantis"], 5, "atlantis"),
        (["--connect", "mock:px4", "--actor", "nobody"], 5, "nobody"),
        (["--connect", "mock:px4", "--map", "env1", "--target", "50,48,20"], 5, "obs2"),
        (["--connect", "mock:px4", "--map", "env1", "--target", "50,480,20"], 5, "outside"),
        (
            ["--connect", "mock:px4", "--map", "env1", "--target", "11,68,9", "--margin", "8"],
            5,
            "reach",
        ),
        (["--connect", "mock:px4", "--target", "50,48"], 2, "--target"),
        (["--connect", "mock:px4", "--v-max", "90"], 2, "--v-max"),
    ],
)
def test_bad_options_are_refused_before_anything_is_opened(
    run, constant_actor, options, code, says
):
    if "--actor" not in options:
        options = [*options, "--actor", constant_actor()]
    got, line = refused(run(*options))
    assert got == code
    assert says in line


def test_truncated_and_foreign_actor_files(run, tmp_path, constant_actor):
    whole = constant_actor().read_bytes()
    for name, data in {"cut.onnx": whole[: len(whole) // 2], "not.onnx": b"MZ" * 500}.items():
        (tmp_path / name).write_bytes(data)
        code, line = refused(run("--connect", "mock:px4", "--actor", tmp_path / name))
        assert code == 5
        assert name in line


@pytest.mark.parametrize("place", ["/proc/nowhere", __file__])
def test_a_recording_that_cannot_be_written_is_noticed_before_the_link_is_opened(
    constant_actor, place
):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        url = f"udp:127.0.0.1:{taken.getsockname()[1]}"
        started = Run("--connect", url, "--actor", constant_actor(), record=place)
        code, line = refused(started)
        started.process.stdout.close()
        started.process.stderr.close()
    assert code == 2
    assert "--record" in line
