"""The mock against recorded autopilots: same requests, then the table of the comparison.

Two flights are in ``tests/data``; where COMPANION_CAPTURES names a folder, every telemetry log
in it is compared as well.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.errors import UsageError
from companion.world.frames import GeoPoint
from sim.mock.ardupilot.personality import ARDUPILOT
from sim.mock.bench import Bench
from sim.mock.conformance.compare import compare
from sim.mock.conformance.recording import interpret, read_recording
from sim.mock.conformance.table import Row, as_text
from sim.mock.packet import Packer
from sim.mock.placement import place_vehicle
from sim.mock.px4.personality import PX4
from sim.mock.vehicle import Settings

SHORT = ("ap_short_flight_companion", "px4_short_flight_companion_30s")
CAPTURES = os.environ.get("COMPANION_CAPTURES", "")
FOLDER = sorted(Path(CAPTURES).glob("*.tlog")) if CAPTURES else []
NAMES = (*SHORT, *(str(path) for path in FOLDER if path.stem not in SHORT))

KNOWN = {
    "px4_offboard_loss_and_resume": {"mode, arming and state", "landed state", "message rates"},
    "px4_pilot_takeover": {"failsafe felt after"},
}
"""Deviations that remain, with their reasons in the README of the mock."""


@pytest.fixture(scope="module", params=NAMES, ids=lambda name: Path(name).stem)
def recording(request, recorded_flight):
    if request.param in SHORT:
        return interpret(request.param, recorded_flight(request.param))
    return read_recording(Path(request.param))


def test_the_mock_agrees_with_the_recording(recording):
    rows = compare(recording)
    assert {"mode, arming and state", "message rates"} <= {row.what for row in rows}
    deviating = {row.what for row in rows if not row.holds}
    assert deviating <= KNOWN.get(recording.name, set()), as_text(recording.name, rows)


def test_short_flights_are_compared_in_every_respect(recorded_flight):
    for name in SHORT:
        rows = {row.what: row for row in compare(interpret(name, recorded_flight(name)))}
        assert {
            "answers to commands",
            "mode, arming and state",
            "landed state",
            "estimator flags",
            "message rates",
            "the way flown",
        } <= rows.keys()
        assert rows["answers to commands"].deviation < 0.05
        assert rows["mode, arming and state"].deviation < 0.05


def test_a_mock_that_answers_otherwise_is_found_out(recorded_flight, monkeypatch):
    from sim.mock.px4 import commander

    monkeypatch.setattr(commander.Px4, "can_arm", lambda self: False)
    rows = compare(interpret(SHORT[1], recorded_flight(SHORT[1])))
    wrong = {row.what for row in rows if not row.holds}
    assert {"answers to commands", "mode, arming and state", "the way flown"} <= wrong


class Log(Bench):
    """A bench that logs what is sent, in MAVLink 1 as well, as a client would."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.sent = []

    def send(self, message, *, link=0, identity=None):
        sender = identity or self.identity
        packet = Packer(*sender).pack(message)
        if len(self.sent) % 2 == 0:
            codec = mavlink.MAVLink(None, *sender)
            packet = codec.decode(bytearray(packet)).pack(codec, force_mavlink1=True)
        self.sent.append((self.time_s, packet))
        super().send(message, link=link, identity=identity)

    def frames(self):
        """Return the log, by a wall clock that runs slower than the vehicle."""
        heard = [(received.time_s, received.packet) for received in self.received]
        log = sorted([*heard, *self.sent], key=lambda item: item[0])
        return [(1e9 + 0.8 * t, frame) for t, frame in log]


@pytest.mark.parametrize("personality", [PX4, ARDUPILOT], ids=lambda personality: personality.name)
def test_a_recording_of_the_mock_itself_agrees_whoever_and_wherever_it_is(personality):
    place = place_vehicle(None, GeoPoint(12.5, 77.5, 920.0), personality)
    boot_s = 3.7 if personality is PX4 else 30.0
    settings = Settings(
        place, boot_s=boot_s, personality=personality, system_id=9, radio=personality is ARDUPILOT
    )
    bench = Log(settings, identity=(9, 191))
    external = personality.kind.external_mode_number
    bench.run(1.0)
    bench.send(mavlink.MAVLink_request_data_stream_message(9, 1, 0, 8, 1))
    bench.command(511, 245, 200_000)
    bench.run(boot_s + 1.0)
    bench.run(0.5, stream=bench.velocity(0, 0, -1))
    bench.command(176, 1, external)
    bench.command(400, 1)
    if personality is ARDUPILOT:
        bench.command(22, 0, 0, 0, 0, 0, 0, 9.0)
        bench.run(14.0)
    bench.run(9.0, stream=bench.velocity(1.5, -0.5, -0.3))
    bench.run(9.0)
    bench.command(21)
    bench.run(6.0)
    rows = compare(interpret("itself", bench.frames()))
    assert {"answers to commands", "failsafe felt after", "stopping distance"} <= {
        row.what for row in rows
    }
    assert all(row.holds for row in rows), as_text("itself", rows)


def test_the_table_says_what_holds():
    good = Row("rates", "1 Hz", "1 Hz", 3.0, 10.0, "%")
    bad = Row("answers", "2 ACKs", "1 ACKs", float("inf"), 0.2, "s", "at 3 s")
    lines = as_text("flight", [good, bad]).splitlines()
    assert lines[0] == "flight: 1 of 2 agree"
    assert lines[2].startswith("ok  rates")
    assert lines[3].startswith("NO  answers")
    assert lines[3].endswith("at 3 s")


def test_what_is_no_recording_of_an_autopilot_is_refused(tmp_path):
    with pytest.raises(UsageError, match="cannot read"):
        read_recording(tmp_path / "missing.tlog")
    (tmp_path / "text.tlog").write_text("this is no telemetry log at all")
    with pytest.raises(UsageError, match="no telemetry log"):
        read_recording(tmp_path / "text.tlog")
    (tmp_path / "empty.tlog").write_bytes(b"")
    command = [sys.executable, "-m", "sim.mock.conformance", str(tmp_path / "empty.tlog")]
    result = subprocess.run(command, capture_output=True, text=True, timeout=30)
    assert result.returncode == 2
    assert result.stderr == "conformance: empty: no PX4 or ArduPilot sends HEARTBEAT in it\n"


def test_the_fit_can_be_drawn(tmp_path):
    pytest.importorskip("matplotlib", reason="pictures need the training extra")
    data = Path(__file__).parents[1] / "data" / f"{SHORT[1]}.tlog.xz"
    picture = tmp_path / "fit.png"
    command = [sys.executable, "-m", "sim.mock.fit", str(data), str(picture)]
    subprocess.run(command, check=True, timeout=100)
    assert picture.read_bytes().startswith(b"\x89PNG")
