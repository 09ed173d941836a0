"""The command line around the commands: help, version, unknown words, closed pipes."""

import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

COMPANION = [sys.executable, "-m", "companion.cli"]


def call(*words):
    return subprocess.run([*COMPANION, *words], capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    "command", ["run", "preflight", "service", "mock", "review", "replay", "maps"]
)
def test_every_command_explains_itself(command):
    done = call(command, "--help")
    assert done.returncode == 0, done.stderr
    assert "usage" in done.stdout


def test_without_a_command_the_commands_are_listed():
    done = call()
    assert done.returncode == 2
    assert "run" in done.stdout


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (["fly"], 2, "no such command"),
        (["maps", "check", "atlantis"], 5, "atlantis"),
        (["actors", "show", "nobody"], 5, "nobody"),
        (["review", "/nonexistent"], 2, "nonexistent"),
        (["run", "--bogus"], 2, "--bogus"),
        (["run", "--targte", "1,2,3"], 2, "perhaps you meant --target"),
        (["run", "--v-max", "fast"], 2, "--v-max"),
        (["run", "--on-exit", "jump"], 2, "hold"),
        (["run", "--connect"], 2, "--connect"),
        (["replay"], 2, "Session folder"),
        (["maps", "chekc", "env1"], 2, "chekc"),
        (["service", "--connect", "mock:px4", "--engage"], 2, "waits for the pilot"),
    ],
)
def test_errors_are_one_line(words, code, says):
    done = call(*words)
    assert done.returncode == code
    assert says in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert done.stdout == ""


def test_an_output_that_is_full_is_one_line():
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [*COMPANION, "maps", "check", "env1"],
            stdout=full, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    assert done.returncode == 8
    assert len(done.stderr.splitlines()) == 1


def is_taken(port):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return True
    return False


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_before_the_flight_ends_with_130(number, tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with subprocess.Popen(
        [*COMPANION, "run", "--connect", f"udp:127.0.0.1:{port}", "--record", str(tmp_path)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        while not is_taken(port):
            assert process.poll() is None
            time.sleep(0.1)
        process.send_signal(number)
        error = process.stderr.read()
        assert process.wait(10) == 130
    assert error == "companion: interrupted\n"


def test_a_reader_that_has_seen_enough_is_no_error():
    process = subprocess.Popen(
        [*COMPANION, "maps", "check", "zurich"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    process.stdout.close()
    error = process.stderr.read()
    process.stderr.close()
    assert process.wait(30) == 0
    assert error == b""


def test_who_kills_the_mock_leaves_nothing_behind():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as companion:
        companion.bind(("127.0.0.1", 0))
        companion.settimeout(20.0)
        url = f"udpout:127.0.0.1:{companion.getsockname()[1]}"
        command = [sys.executable, "-m", "companion.cli", "mock", "--connect", url]
        mock = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        try:
            companion.recv(300)
        finally:
            mock.kill()
            mock.wait()
        companion.settimeout(0.5)
        assert any(is_silent(companion) for _ in range(100_000))  # after what it sent in life


def is_silent(listener):
    try:
        listener.recv(300)
    except TimeoutError:
        return True
    return False
