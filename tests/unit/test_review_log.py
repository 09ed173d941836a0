"""Logs of flights with one fault each, made of real MAVLink bytes: does the review name it?"""

import lzma
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.errors import MapError, UsageError
from companion.review.findings import findings
from companion.review.log_file import open_log
from companion.review.log_flight import log_flight
from companion.review.log_story import read_story
from companion.review.sources import open_flight
from companion.review.words import report
from companion.vehicle import Severity
from companion.world.frames import GeoPoint, enu_to_geodetic
from companion.world.maps import build_map

DATA = Path(__file__).parents[1] / "data"
START_US = 1_795_356_187_000_000
OFFBOARD, LOITER, RTL, POSCTL = 0x60000, 0x03040000, 0x05040000, 0x30000
GOOD_FLAGS = 0x37F
ARMED = 128


class Log:
    """Writes a telemetry log as a link would."""

    def __init__(self):
        self.data = b""
        self.senders = {}

    def add(self, time_s, message, system=1, component=1):
        sender = self.senders.setdefault(
            (system, component), dialect.MAVLink(None, system, component)
        )
        frame = bytes(message.pack(sender))
        sender.seq = (sender.seq + 1) % 256
        self.data += (START_US + round(time_s * 1e6)).to_bytes(8, "big") + frame

    def lose(self, count):
        """Let sequence numbers of the vehicle go by."""
        sender = self.senders[1, 1]
        sender.seq = (sender.seq + count) % 256

    def story(self, folder):
        path = folder / "flight.tlog"
        path.write_bytes(self.data)
        return read_story(path)


def heartbeat(mode, *, armed=True, status=4):
    base = 1 | (ARMED if armed else 0)
    return dialect.MAVLink_heartbeat_message(2, 12, base, mode, status, 3)


def position(time_s, north=0.0, up=10.0, speed=2.0):
    return dialect.MAVLink_local_position_ned_message(
        round(time_s * 1000), north, 0.0, -up, speed, 0.0, 0.0
    )


def setpoint(north=2.0, target=1):
    return dialect.MAVLink_set_position_target_local_ned_message(
        0, target, 1, 1, 3527, 0, 0, 0, north, 0, 0, 0, 0, 0, 0, 0
    )


def fly(
    log,
    *,
    begin_s=0.0,
    end_s=20.0,
    mode=lambda _: OFFBOARD,
    status=lambda _: 4,
    sends=lambda _: True,
    speaks=lambda _: True,
    north=lambda t: 2.0 * t,
    fix=lambda _: 3,
    flags=lambda _: GOOD_FLAGS,
    extra=lambda _log, _t: None,
):
    """Fly north at 2 m/s under the setpoints of a companion at 10 Hz."""
    for index in range(round(begin_s * 10), round(end_s * 10)):
        t = index / 10
        if speaks(t):
            if index % 10 == 0:
                log.add(t, heartbeat(mode(t), status=status(t)))
                log.add(t, dialect.MAVLink_extended_sys_state_message(0, 2))
                log.add(t, dialect.MAVLink_estimator_status_message(0, flags(t), *[0] * 8))
                log.add(t, dialect.MAVLink_gps_raw_int_message(0, fix(t), *[0] * 7, 10))
            log.add(t + 0.01, position(t, north(t)))
        if sends(t):
            log.add(t + 0.02, setpoint(), 1, 191)
        extra(log, t)


def found(story):
    return "\n".join(event.text for event in story.events if event.severity <= Severity.WARNING)


def test_a_flight_without_fault_has_nothing_that_stands_out(tmp_path):
    log = Log()
    fly(log)
    story = log.story(tmp_path)
    assert found(story) == ""
    assert dict(story.story.facts)["Setpoints"].startswith("200 at 10.0 Hz, from 1/191")


FAULTS = {
    "the stream stops": (
        {
            "sends": lambda t: t < 10,
            "mode": lambda t: OFFBOARD if t < 11 else RTL,
            "status": lambda t: 4 if t < 11 else 5,
        },
        "OFFBOARD -> AUTO.RTL: a FAILSAFE of the autopilot, 1.1 s after the last setpoint",
    ),
    "setpoints are lost on the way": (
        {
            "mode": lambda t: OFFBOARD if t < 11 else RTL,
            "status": lambda t: 4 if t < 11 else 5,
        },
        "although setpoints were SENT all the time",
    ),
    "PX4 takes OFFBOARD back": (
        {
            "sends": lambda t: t < 8 or t >= 14,
            "mode": lambda t: OFFBOARD if t < 9 or t >= 15 else RTL,
            "status": lambda t: 5 if 9 <= t < 15 else 4,
        },
        "AUTO.RTL -> OFFBOARD: BY ITSELF: setpoints flow again",
    ),
    "the pilot takes over": (
        {"mode": lambda t: OFFBOARD if t < 10 else POSCTL},
        "OFFBOARD -> POSCTL: nobody on this link asked: the pilot, or the autopilot itself",
    ),
    "a gap": ({"sends": lambda t: not 10 <= t < 11}, "no setpoint of 1/191 for 1.10 s"),
    "GPS": ({"fix": lambda t: 3 if t < 10 else 1}, "GPS LOST its fix"),
    "glitch": (
        {"flags": lambda t: GOOD_FLAGS if t < 10 else GOOD_FLAGS | 1024},
        "a GPS GLITCH",
    ),
    "estimator": (
        {"flags": lambda t: GOOD_FLAGS if t < 10 else 0x25},
        "NO LONGER vouches for the position (flags 0x25)",
    ),
    "a jump": (
        {"north": lambda t: 2.0 * t + (0.0 if t < 10 else 4.0)},
        "the position JUMPED by 4.0 m (+0.0 east, +4.0 north, +0.0 up)",
    ),
    "silence": ({"speaks": lambda t: not 10 <= t < 14}, "NOTHING was heard of the vehicle for 4."),
    "a rival": (
        {"extra": lambda log, t: log.add(t + 0.05, setpoint(), 1, 192) if t > 10 else None},
        "SEVERAL send setpoints at once: 1/191 and 1/192",
    ),
    "lost packets": (
        {"extra": lambda log, t: log.lose(1) if t % 1 == 0.5 else None},
        "of the vehicle's packets were LOST",
    ),
    "reset": (
        {
            "extra": lambda log, t: log.add(
                t + 0.03,
                dialect.MAVLink_odometry_message(
                    0, 1, 1, 0, 0, 0, [1, 0, 0, 0], *[0] * 6, [0] * 21, [0] * 21, int(t > 10)
                ),
            )
        },
        "the estimator RESET itself (counter 0 -> 1)",
    ),
    "reboot": (
        {
            "extra": lambda log, t: log.add(
                t + 0.03, dialect.MAVLink_system_time_message(0, round(1000 * (t % 10)))
            )
        },
        "the autopilot REBOOTED",
    ),
    "origin": (
        {
            "extra": lambda log, t: log.add(
                t + 0.03,
                dialect.MAVLink_gps_global_origin_message(
                    473977420 + (0 if t < 10 else 900), 85455940, 489400
                ),
            )
        },
        "the local ORIGIN moved by 10.0 m",
    ),
    "a frozen target": (
        {
            "extra": lambda log, t: log.add(
                t + 0.03,
                dialect.MAVLink_global_position_int_message(
                    0, 473977420 + round(100 * min(t, 10)), 85455940, 0, 0, 100, 0, 0, 0
                ),
                42,
            )
        },
        "system 42 repeats ONE report, as if frozen, since 10.0 s",
    ),
    "battery": (
        {
            "extra": lambda log, t: log.add(
                t + 0.03,
                dialect.MAVLink_sys_status_message(
                    0, 0, 0, 0, 15000, 0, 80 if t < 10 else 9, *[0] * 6
                ),
            )
        },
        "BATTERY at 9 %",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named(tmp_path, fault):
    changes, expected = FAULTS[fault]
    log = Log()
    fly(log, **changes)
    story = log.story(tmp_path)
    assert expected in found(story)
    shown = report(log_flight(story))
    assert expected in " ".join(shown.split())
    assert max(map(len, shown.splitlines()[1:])) <= 80


def test_a_vehicle_that_does_not_follow_is_named(tmp_path):
    log = Log()
    for index in range(200):
        t = index / 10
        if index % 10 == 0:
            log.add(t, heartbeat(OFFBOARD))
        log.add(t + 0.01, position(t, 0.0, speed=0.0))
        log.add(t + 0.02, setpoint(), 1, 191)
    assert "did NOT FOLLOW its setpoints" in found(log.story(tmp_path))


def test_who_asked_for_a_mode_is_told(tmp_path):
    log = Log()
    beat = dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    log.add(0.0, beat, 255, 190)
    log.add(0.1, heartbeat(LOITER, armed=False))
    ask = dialect.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
    log.add(1.0, ask, 255, 190)
    log.add(1.1, heartbeat(LOITER))
    mode = dialect.MAVLink_command_long_message(1, 1, 176, 0, 1, 6, 0, 0, 0, 0, 0)
    log.add(2.0, mode, 255, 190)
    log.add(2.1, heartbeat(OFFBOARD))
    log.add(3.0, mode, 255, 190)
    log.add(3.1, dialect.MAVLink_command_ack_message(176, 1, 0, 0, 255, 190))
    texts = [event.text for event in log.story(tmp_path).events]
    assert "armed, asked for by ground station 255/190" in texts
    assert "mode AUTO.LOITER -> OFFBOARD: asked for by ground station 255/190" in texts
    assert "refused: mode OFFBOARD, ground station 255/190 (temporarily rejected)" in texts


def test_texts_in_chunks_are_joined_and_keep_their_severity(tmp_path):
    log = Log()
    log.add(0.0, heartbeat(LOITER))
    text = b"RTL: start return at 520 m (30 m above destination)"
    log.add(1.0, dialect.MAVLink_statustext_message(4, text[:50], 7, 0))
    log.add(1.1, dialect.MAVLink_statustext_message(4, text[50:], 7, 1))
    (event,) = [event for event in log.story(tmp_path).events if event.source == "autopilot"]
    assert (event.text, event.severity) == (text.decode(), Severity.WARNING)


@pytest.fixture(scope="module")
def real(tmp_path_factory):
    """The two recordings of real autopilots."""
    folder = tmp_path_factory.mktemp("real")
    for packed in DATA.glob("*.tlog.xz"):
        (folder / packed.stem).write_bytes(lzma.decompress(packed.read_bytes()))
    return folder


def test_a_real_arducopter_is_told(real):
    story = read_story(real / "ap_short_flight_companion.tlog")
    texts = [event.text for event in story.events]
    assert "ArduPilot" in story.vehicle_name
    assert any("STABILIZE -> GUIDED: asked for by companion 1/191" in text for text in texts)
    assert any("asks for take-off to 10 m" in text for text in texts)
    assert [text for text in texts if "took off" in text or text.startswith("landed")]
    flight = log_flight(story)
    assert 8.0 < flight.vehicle.position_enu_m[:, 2].max() < 12.0
    assert findings(flight) == []


def test_a_real_px4_is_told(real):
    story = read_story(real / "px4_short_flight_companion_30s.tlog")
    texts = [event.text for event in story.events]
    assert any("AUTO.LOITER -> OFFBOARD: asked for by companion 1/191" in text for text in texts)
    assert "took off" in texts
    curve = log_flight(story).curves["plots/velocity/north"]
    _, sent = curve.line("setpoint")
    _, measured = curve.line("measured")
    assert sent.max() > 1.0
    assert measured.max() > 1.0


def test_a_log_without_local_position_is_placed_by_the_global_one(tmp_path):
    log = Log()
    for index in range(100):
        t = index / 10
        if index % 10 == 0:
            log.add(t, heartbeat(LOITER))
        at = dialect.MAVLink_global_position_int_message(
            round(t * 1000), 473977420 + 90 * index, 85455940, 500_000, 0, 200, 0, 0, 0
        )
        log.add(t + 0.01, at)
    flight = log_flight(log.story(tmp_path))
    north_m = np.ptp(flight.vehicle.position_enu_m[:, 1])
    assert north_m == pytest.approx(99 * 90e-7 * 111_180, rel=0.02)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "empty"),
        (b"hello, world" * 100, "no MAVLink"),
        (b"ULog\x01\x12\x35" + bytes(100), "ULog"),
        (b"\xa3\x95\x80" + bytes(100), "dataflash"),
    ],
    ids=["empty", "text", "ulog", "dataflash"],
)
def test_what_is_no_log_is_refused_in_one_line(tmp_path, content, reason):
    path = tmp_path / "flight.tlog"
    path.write_bytes(content)
    with pytest.raises(UsageError, match=reason) as raised:
        open_flight(path)
    assert "\n" not in str(raised.value)


def test_a_log_without_an_autopilot_is_refused(tmp_path):
    log = Log()
    log.add(0.0, dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), 255, 190)
    with pytest.raises(UsageError, match="no HEARTBEAT of an autopilot, only of systems 255"):
        log.story(tmp_path)


def test_garbage_between_entries_costs_only_itself(tmp_path):
    log = Log()
    fly(log, end_s=5.0)
    half = len(log.data) // 2
    path = tmp_path / "flight.tlog"
    path.write_bytes(log.data)
    whole = len(list(open_log(path).frames()))
    path.write_bytes(log.data[:half] + bytes(range(1, 200)) + log.data[half:])
    mended = open_log(path)
    assert whole - 3 <= len(list(mended.frames())) <= whole
    assert mended.bad_bytes >= 199


def test_a_clock_that_is_set_in_flight_does_not_stretch_the_flight(tmp_path):
    early = Log()
    fly(early, end_s=5.0)
    path = tmp_path / "flight.tlog"
    shifted = Log()
    fly(shifted, begin_s=100_005.0, end_s=100_010.0)
    path.write_bytes(early.data + shifted.data)
    story = read_story(path)
    assert story.duration_s == pytest.approx(9.9, abs=0.2)
    assert "clock was set 1 times" in story.events[-1].text


@settings(
    deadline=None, max_examples=10, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_damage_never_ends_in_a_traceback(tmp_path, real, data):
    content = bytearray((real / "ap_short_flight_companion.tlog").read_bytes())
    begin = data.draw(st.integers(0, len(content) - 1))
    end = begin + data.draw(st.integers(1, 20_000))
    noise = data.draw(st.binary(max_size=300))
    content[begin:end] = noise
    path = tmp_path / "flight.tlog"
    path.write_bytes(content[: data.draw(st.integers(30_000, 90_000))])
    assert "What happened" in report(open_flight(path))


def test_a_session_without_a_recording_is_read_from_its_log(tmp_path):
    log = Log()
    fly(log, end_s=5.0)
    (tmp_path / "flight.tlog").write_bytes(log.data)
    text = report(open_flight(tmp_path))
    assert "the run was cut off" in " ".join(text.split())
    assert "OFFBOARD" in text


def placed(latitude, longitude):
    """A flight of ten seconds north, its local origin somewhere on earth."""
    log = Log()
    log.add(0.0, dialect.MAVLink_gps_global_origin_message(latitude, longitude, 489_400))
    fly(log, end_s=10.0)
    return log


def test_a_log_is_laid_over_a_map_where_it_was_flown(tmp_path):
    here = GeoPoint(47.39774, 8.54559, 489.4)
    corner = enu_to_geodetic(here, np.array((-30.0, -10.0, 0.0)))
    house = [[36.0, 20.0], [46.0, 20.0], [46.0, 30.0], [36.0, 30.0]]
    city = build_map("yard", (80.0, 80.0, 50.0), [house], [25.0], origin=corner)
    story = placed(round(here.latitude_deg * 1e7), round(here.longitude_deg * 1e7)).story(tmp_path)
    flight = log_flight(story, city)
    np.testing.assert_allclose(flight.vehicle.position_enu_m[0], [30.0, 10.0, 0.0], atol=0.3)
    _, clearance_m = flight.curves["plots/clearance"].line("clearance")
    assert clearance_m.min() == pytest.approx(6.0, abs=0.1)
    elsewhere = build_map("far", (80.0, 80.0, 50.0), [], [], origin=GeoPoint(10.0, 10.0, 0.0))
    with pytest.raises(MapError, match="outside of far"):
        log_flight(story, elsewhere)


def test_a_map_without_a_place_takes_the_log_at_its_launch_point(tmp_path):
    log = Log()
    fly(log, end_s=10.0)
    story = log.story(tmp_path)
    city = build_map("box", (80.0, 80.0, 50.0), [], [], launch_enu_m=(40.0, 5.0, 0.0))
    flight = log_flight(story, city)
    np.testing.assert_allclose(flight.vehicle.position_enu_m[0], [40.0, 5.0, 0.0], atol=0.3)
    on_earth = build_map("far", (80.0, 80.0, 50.0), [], [], origin=GeoPoint(10.0, 10.0, 0.0))
    with pytest.raises(MapError, match="does not tell where on earth"):
        log_flight(story, on_earth)
