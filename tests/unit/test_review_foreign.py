"""Logs as they come from the field: damaged, by other writers, or no logs at all."""

import gzip

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.errors import UsageError
from companion.review.log_file import open_log
from companion.review.log_flight import log_flight
from companion.review.log_story import read_story
from companion.review.sources import open_flight
from companion.review.words import report
from companion.session.tlog import read_tlog
from companion.vehicle import Severity


def found(story):
    return "\n".join(event.text for event in story.events if event.severity <= Severity.WARNING)


def entries(*parts):
    return b"".join(utc_us.to_bytes(8, "big") + frame for utc_us, frame in parts)


@pytest.fixture
def px4(real_logs):
    """``(utc_us, frame)`` of a real flight."""
    return read_tlog((real_logs / "px4_short_flight_companion_30s.tlog").read_bytes())


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "empty"),
        (b"hello, world" * 100, "no MAVLink"),
        (b"ULog\x01\x12\x35" + bytes(100), "ULog"),
        (b"\xa3\x95\x80" + bytes(100), "dataflash"),
        (gzip.compress(bytes(100)), "unpack it first"),
        (b"RRF2" + bytes(100), "name it .rrd"),
    ],
    ids=["empty", "text", "ulog", "dataflash", "gzip", "rrd"],
)
def test_what_is_no_log_is_refused_in_one_line(tmp_path, content, reason):
    path = tmp_path / "flight.tlog"
    path.write_bytes(content)
    with pytest.raises(UsageError, match=reason) as raised:
        open_flight(path)
    assert "\n" not in str(raised.value)


def test_a_stream_without_times_is_refused_by_name(tmp_path, px4):
    path = tmp_path / "flight.raw"
    path.write_bytes(b"".join(frame for _, frame in px4))
    with pytest.raises(UsageError, match="a raw stream of MAVLink without times"):
        open_flight(path)


def test_a_log_without_an_autopilot_is_refused(flight_log):
    beat = dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    flight_log.add(0.0, beat, 255, 190)
    with pytest.raises(UsageError, match="no HEARTBEAT of an autopilot, only of systems 255"):
        read_story(flight_log.write())


def test_garbage_between_entries_costs_only_itself(flight_log):
    flight_log.fly(end_s=5.0)
    half = len(flight_log.data) // 2
    whole = len(list(open_log(flight_log.write()).frames()))
    flight_log.data = flight_log.data[:half] + bytes(range(1, 200)) + flight_log.data[half:]
    mended = open_log(flight_log.write())
    assert whole - 3 <= len(list(mended.frames())) <= whole
    assert mended.bad_bytes >= 199


@pytest.mark.parametrize(
    ("step_s", "words"),
    [
        (100_000.0, "the log's clock jumped AHEAD by 100000 s"),
        (-20.0, "the log's clock went BACK by 20 s"),
        (-3600.0, "the log's clock went BACK by 3600 s"),
    ],
)
def test_a_clock_that_is_set_in_flight_does_not_stretch_the_flight(tmp_path, px4, step_s, words):
    half = len(px4) // 2
    late = [(utc_us + round(step_s * 1e6), frame) for utc_us, frame in px4[half:]]
    path = tmp_path / "flight.tlog"
    path.write_bytes(entries(*px4[:half], *late))
    story = read_story(path)
    assert story.duration_s == pytest.approx((px4[-1][0] - px4[0][0]) * 1e-6, abs=1.0)
    assert found(story).startswith(words)
    assert len(found(story).splitlines()) == 1


def test_packets_that_waited_for_the_reader_are_no_set_clock(tmp_path, px4):
    """A reader who was away stamps what lay in the kernel with the time of its last look."""
    waited = [(px4[1000][0], frame) if i % 70 else (at, frame)
              for i, (at, frame) in enumerate(px4[1000:2000])]  # fmt: skip
    path = tmp_path / "flight.tlog"
    path.write_bytes(entries(*px4[:1000], *waited, *px4[2000:]))
    assert "clock" not in found(read_story(path))


def test_a_log_without_position_does_not_say_that_it_never_flew(flight_log):
    for second in range(10):
        flight_log.heartbeat(second, 0x60000)
    flight = log_flight(read_story(flight_log.write()))
    assert flight.result.startswith("no position in it")


def test_of_two_vehicles_one_is_told_and_the_other_named(flight_log):
    flight_log.fly(end_s=5.0)
    beat = dialect.MAVLink_heartbeat_message(2, 3, 1, 0, 4, 3)
    flight_log.add(5.0, beat, 7)
    story = read_story(flight_log.write())
    assert story.senders.vehicle == 1
    assert "another autopilot is heard too: system 7" in [event.text for event in story.events]


@settings(
    deadline=None, max_examples=10, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_damage_never_ends_in_a_traceback(tmp_path, real_logs, data):
    content = bytearray((real_logs / "ap_short_flight_companion.tlog").read_bytes())
    begin = data.draw(st.integers(0, len(content) - 1))
    end = begin + data.draw(st.integers(1, 20_000))
    noise = data.draw(st.binary(max_size=300))
    content[begin:end] = noise
    path = tmp_path / "flight.tlog"
    path.write_bytes(content[: data.draw(st.integers(30_000, 90_000))])
    assert "What happened" in report(open_flight(path))
