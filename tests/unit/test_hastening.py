"""A clock and a transport that are faster than the wall."""

import time

import pytest

from companion import clock
from companion.config import RunConfig
from companion.errors import UsageError
from companion.hastening import HastenedTransport, hastened_clock


def test_the_clock_shows_more_seconds_than_pass():
    fast, before_s = hastened_clock(5.0), clock.now_s()
    start_s = fast()
    assert start_s == pytest.approx(before_s, abs=0.5), "it begins now"
    time.sleep(0.02)
    shown_s, passed_s = fast() - start_s, clock.now_s() - before_s
    assert 0.1 <= shown_s <= 5.0 * passed_s


def test_at_our_own_pace_it_is_the_clock_itself():
    assert hastened_clock(1.0) is clock.now_s


def test_it_waits_in_the_seconds_of_the_clock_and_hands_on_the_rest(memory_transport):
    inner = memory_transport()
    transport = HastenedTransport(inner, 4.0)
    start_s = inner.now_s
    transport.wait(1.0)
    assert inner.now_s - start_s == 0.25
    inner.deliver(b"in", peer="somebody")
    assert transport.receive() == [("somebody", b"in")]
    transport.reply_to("somebody")
    assert inner.reply_peer == "somebody"
    inner.send_errors = 3
    assert transport.receive() == []
    assert transport.send_errors == 3
    transport.close()
    assert inner.closed


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"connect": "udp:0.0.0.0:14540", "mock_speed": 4.0}, "--mock-speed is for --connect mock"),
        ({"connect": "mock:px4", "mock_speed": 40.0}, "--mock-speed must be 0.1 to 10"),
    ],
)
def test_a_vehicle_elsewhere_is_never_flown_by_a_fast_clock(options, words):
    with pytest.raises(UsageError, match=words):
        RunConfig(**options).check()
