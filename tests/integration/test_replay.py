"""``companion replay`` on flights of the real program over real sockets."""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time

import pytest

from companion.session.inputs import InputsOutput, read_inputs
from companion.session.recorder import Recorder
from companion.session.records import Inputs, SessionEnd
from companion.session.tlog import read_tlog

COMPANION = [sys.executable, "-m", "companion.cli"]
MOCK = [sys.executable, "-m", "sim.mock", "--autopilot", "px4", "--exit-with-parent"]
UP = ("--takeoff", 6, "--arm", "--engage")


def companion(*arguments):
    done = subprocess.run(
        [*COMPANION, *map(str, arguments)], capture_output=True, text=True, timeout=90, check=False
    )
    assert "Traceback" not in done.stderr, done.stderr
    return done


def replay(folder, *options):
    done = companion("replay", folder, "--json", *options)
    found = json.loads(done.stdout) if done.stdout else None
    assert found is None or found["exit_code"] == done.returncode
    return done.returncode, found, done.stderr


def only_folder(parent):
    (folder,) = parent.iterdir()
    return folder


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """Fly once from the ground to a target; return folder and actor, neither to be changed."""
    place = tmp_path_factory.mktemp("flown")
    actor = place / "actor.onnx"
    bundled = subprocess.run(
        [sys.executable, "-c", "from companion.policy.actor import actors_folder as f; print(f())"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout.strip()
    shutil.copy(f"{bundled}/paper-free.onnx", actor)
    done = companion(
        "run", "--connect", "mock:px4", "--map", "env1", "--actor", actor, "--target", "26,10,6",
        "--record", place / "sessions", *UP,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return only_folder(place / "sessions"), actor


@pytest.fixture
def session(flown, tmp_path):
    """Return a copy of the flight that a test may damage."""
    return shutil.copytree(flown[0], tmp_path / "session")


def test_every_frame_comes_out_the_same(session):
    code, found, _ = replay(session)
    summary = json.loads((session / "summary.json").read_text())
    assert (code, found["same"], found["same_summary"]) == (0, True, True), found
    assert found["setpoints_sent"] == summary["setpoints_sent"] > 100
    assert found["frames_sent"] > found["setpoints_sent"] + 10
    assert not found["cut_off"]
    words = companion("replay", session).stdout
    assert "bit for bit" in words


def change_one_setpoint(session):
    tlog = session / "flight.tlog"
    data = bytearray(tlog.read_bytes())
    at = 0
    moving = []
    for _, frame in read_tlog(bytes(data)):
        if frame[7:10] == b"\x54\0\0" and any(frame[26:38]):
            moving.append(at + 8 + 26)
        at += 8 + len(frame)
    data[moving[20]] ^= 1  # the lowest bit of the north velocity
    tlog.write_bytes(data)


def test_one_bit_is_noticed(session):
    change_one_setpoint(session)
    code, found, _ = replay(session)
    assert (code, found["same"]) == (8, False)
    assert (found["different_frames"], found["different_setpoints"]) == (1, 1)
    assert 0.0 < found["largest_difference_mps"] < 1e-3
    assert found["first_difference_s"] > 5.0
    assert "1 frames differ" in companion("replay", session).stdout


def rewrite_inputs(session, keep):
    path = session / "inputs.bin"
    inputs = read_inputs(path)
    size = 16_384
    pieces = [inputs.journal[at : at + size] for at in range(0, len(inputs.journal), size)]
    output = InputsOutput(path)
    output.write(inputs.start)
    for number, piece in enumerate(pieces):
        if keep(number):
            output.write(Inputs(number, inputs.frames, piece))
    output.write(SessionEnd(inputs.summary))
    output.close()


def drop_a_block(session):
    rewrite_inputs(session, lambda number: number != 5)


def drop_frames(session):
    entries = read_tlog((session / "flight.tlog").read_bytes())
    with (session / "flight.tlog").open("wb") as file:
        for index, (utc_us, frame) in enumerate(entries):
            if not 1000 <= index < 1010:
                file.write(utc_us.to_bytes(8, "big") + frame)


def swap_frames(session):
    entries = read_tlog((session / "flight.tlog").read_bytes())
    entries[500], entries[501] = entries[501], entries[500]
    with (session / "flight.tlog").open("wb") as file:
        for utc_us, frame in entries:
            file.write(utc_us.to_bytes(8, "big") + frame)


def lose_tlog(session):
    (session / "flight.tlog").unlink()


def lose_inputs(session):
    (session / "inputs.bin").unlink()


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (drop_a_block, "gaps"),
        (drop_frames, "lacks 10 frames"),
        (lose_tlog, "flight.tlog"),
        (lose_inputs, "inputs.bin"),
    ],
)
def test_an_incomplete_recording_is_refused(session, damage, says):
    damage(session)
    code, found, err = replay(session)
    assert (code, found) == (5, None)
    assert says in err
    assert len(err.splitlines()) == 1


def test_frames_out_of_order_are_no_replay(session):
    swap_frames(session)
    code, found, _ = replay(session)
    assert code in (5, 8)
    assert found is None or not found["same"]


def test_an_actor_that_has_changed_is_refused(session, flown):
    actor = flown[1]
    kept = actor.read_bytes()
    try:
        done = subprocess.run(
            [sys.executable, "-c", _RETOUCH, str(actor)],
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        code, _, err = replay(session)
    finally:
        actor.write_bytes(kept)
    assert code == 5
    assert "is not the one that flew" in err


_RETOUCH = """
import sys, onnx
model = onnx.load(sys.argv[1])
model.doc_string = "retouched"
onnx.save(model, sys.argv[1])
"""


def test_another_actor_decides_in_the_same_situations(session, constant_actor, tmp_path):
    other = constant_actor((1.0, 0.0, 0.0))
    code, found, err = replay(session, "--actor", other, "--record", tmp_path / "others")
    assert (code, err) == (0, "")
    opinion = found["other"]
    assert opinion["ticks"] > 20
    assert opinion["largest_difference_mps"] > 0.0
    folder = only_folder(tmp_path / "others")
    assert opinion["session_dir"] == str(folder)
    assert json.loads((folder / "summary.json").read_text())["outcome"] == "replayed"
    report = companion("review", folder, "--text")
    assert report.returncode == 0, report.stderr
    assert "would have decided" in " ".join(report.stdout.split())
    assert (folder / "session.rrd").stat().st_size > 20_000


def test_the_same_actor_has_the_same_opinion(session, flown, tmp_path):
    _, found, _ = replay(session, "--actor", flown[1], "--record", tmp_path / "others")
    assert found["other"]["largest_difference_mps"] == 0.0
    assert found["other"]["interventions_now"] == found["other"]["interventions_then"]


@pytest.fixture
def fly(tmp_path):
    """Start a mock and a run against it; return the run's process."""
    started = []

    def start(*options, mock=()):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        started.append(
            subprocess.Popen(
                [*MOCK, "--connect", f"udpout:127.0.0.1:{port}", "--map", "env1", *map(str, mock)],
                stdout=subprocess.DEVNULL,
            )
        )
        command = ["run", "--connect", f"udpin:127.0.0.1:{port}", "--map", "env1"]
        command += ["--record", tmp_path / "sessions", *options, *UP]
        run = subprocess.Popen(
            [*COMPANION, *map(str, command)],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        started.append(run)
        return run

    yield start
    for process in started:
        if process.poll() is None:
            process.kill()
        process.wait()
        if process.stdout is not None:
            process.stdout.close()


def wait_for(run, words):
    for line in run.stdout:
        if words in line:
            return
    raise AssertionError(f"never said {words!r}")


@pytest.mark.parametrize("backend", ["pymavlink", "mavsdk"])
def test_a_pursuit_on_a_bad_radio_and_a_takeover(fly, constant_actor, tmp_path, backend):
    """Targets, losses, doubled and broken packets, a pilot: everything that comes is an input."""
    pytest.importorskip(backend)
    run = fly(
        "--backend", backend,
        "--actor", constant_actor((0.6, 0.1, 0.2)), "--target-sysid", 42,
        mock=(
            "--radio", "--target", "kind=waypoints,sysid=42,speed=1.5,at=60:60:10",
            "--fault", "kind=loss,percent=5", "--fault", "kind=corrupt,percent=2",
            "--fault", "kind=duplicate,percent=5", "--fault", "from=offboard,t=4,kind=rc_takeover",
        ),
    )  # fmt: skip
    run.stdout.read()
    assert run.wait(60) == 7
    code, found, err = replay(only_folder(tmp_path / "sessions"))
    assert (code, err) == (0, "")
    assert found["same"]
    assert found["setpoints_sent"] > 50


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_a_run_that_was_ended_replays_until_its_end(fly, constant_actor, tmp_path, number):
    run = fly("--actor", constant_actor((0.0, 0.0, 0.0)), "--target", "80,10,6")
    wait_for(run, "engaged")
    time.sleep(2.0)
    run.send_signal(number)
    run.stdout.read()
    run.wait(30)
    folder = only_folder(tmp_path / "sessions")
    deadline = time.monotonic() + 20.0
    while subprocess.run(["pgrep", "-f", str(folder)], stdout=subprocess.DEVNULL).returncode == 0:
        assert time.monotonic() < deadline, "the recorder process outlives its session"
        time.sleep(0.1)
    code, found, err = replay(folder)
    assert (code, err) == (0, "")
    assert found["same"]
    assert found["setpoints_sent"] > 20
    assert found["cut_off"] is (number == signal.SIGKILL)


def test_a_recorder_that_could_not_keep_up_is_found_out(flown, tmp_path):
    inputs = read_inputs(flown[0] / "inputs.bin")
    recorder = Recorder(tmp_path, backlog_bytes=200_000)
    os.kill(recorder.process_id, signal.SIGSTOP)
    recorder.put(inputs.start)
    for number in range(60):
        recorder.put(Inputs(number, 0, bytes(50_000)))
    os.kill(recorder.process_id, signal.SIGCONT)
    assert recorder.close(20.0)
    assert recorder.dropped > 0
    code, found, err = replay(tmp_path)
    assert (code, found) == (5, None)
    assert "dropped records" in err
