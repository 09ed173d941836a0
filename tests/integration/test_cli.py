"""The command line around the commands: help, version, unknown words, closed pipes."""

import subprocess
import sys

import pytest

COMPANION = [sys.executable, "-m", "companion.cli"]


def call(*words):
    return subprocess.run([*COMPANION, *words], capture_output=True, text=True, check=False)


@pytest.mark.parametrize("command", ["run", "preflight", "mock", "review", "replay", "maps"])
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
    ],
)
def test_errors_are_one_line(words, code, says):
    done = call(*words)
    assert done.returncode == code
    assert says in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert done.stdout == ""


def test_a_reader_that_has_seen_enough_is_no_error():
    process = subprocess.Popen(
        [*COMPANION, "maps", "check", "zurich"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    process.stdout.close()
    error = process.stderr.read()
    process.stderr.close()
    assert process.wait(30) == 0
    assert error == b""
