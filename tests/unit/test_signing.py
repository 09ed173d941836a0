import copy
import hashlib
from datetime import UTC, datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.errors import LinkLostError, RefusedError, UsageError
from companion.link.codec import Parser
from companion.link.signing import Fault, Signing, SigningKey, load_key, stamp_at

MINUTE = 6_000_000
STAMP = 37 * 365 * MINUTE
KEY = SigningKey(bytes(range(32)), "test")


def partner(secret=KEY.secret, *, stamp=STAMP, system_id=1, component_id=1, link_id=0):
    """A MAVLink end that signs and checks by pymavlink alone."""
    mavlink = dialect.MAVLink(None, system_id, component_id)
    mavlink.signing.secret_key = secret
    mavlink.signing.sign_outgoing = secret is not None
    mavlink.signing.timestamp = stamp
    mavlink.signing.link_id = link_id
    return mavlink


def ours(*, stamp=STAMP, now_s=0.0, link_id=0, key=KEY):
    return Signing(key, stamp=stamp, now_s=now_s, link_id=link_id)


def heartbeat(mavlink, **options):
    frame = dialect.MAVLink_heartbeat_message(2, 12, 0x1D, 7, 3, 3).pack(mavlink, **options)
    mavlink.seq = (mavlink.seq + 1) % 256
    return frame


def stamp_of(frame):
    return int.from_bytes(frame[-12:-6], "little")


keys = st.binary(min_size=32, max_size=32)
stamps = st.integers(1, (1 << 48) - 2)
messages = st.one_of(
    st.builds(
        dialect.MAVLink_local_position_ned_message,
        st.integers(0, 2**32 - 1),
        *[st.floats(width=32, allow_nan=False)] * 6,
    ),
    st.builds(
        dialect.MAVLink_statustext_message,
        st.integers(0, 7),
        st.binary(max_size=50),
        st.integers(0, 65535),
        st.integers(0, 255),
    ),
    st.builds(dialect.MAVLink_system_time_message, st.integers(0, 2**64 - 1), st.just(0)),
)


@given(keys, stamps, st.integers(0, 255), st.integers(1, 255), messages, st.integers(0, 255))
def test_what_we_sign_is_what_pymavlink_signs(secret, stamp, link_id, system_id, message, sequence):
    theirs = partner(secret, stamp=stamp, system_id=system_id, link_id=link_id)
    theirs.seq = sequence
    plain = partner(None, system_id=system_id)
    plain.seq = sequence
    signing = ours(stamp=stamp, link_id=link_id, key=SigningKey(secret, "test"))
    frame = signing.sign(copy.deepcopy(message).pack(plain), 0.0)
    assert frame == message.pack(theirs)
    partner(secret, stamp=0).decode(bytearray(frame))  # raises if it did not check


@given(keys, stamps, messages)
def test_what_pymavlink_signs_is_admitted_once(secret, stamp, message):
    frame = message.pack(partner(secret, stamp=stamp))
    signing = ours(stamp=stamp, key=SigningKey(secret, "test"))
    parser = Parser(signing.admits)
    assert [received.frame for received in parser.receive(frame, 0.0)] == [frame]
    assert parser.receive(frame, 0.0) == []
    assert signing.refused[Fault.REPLAYED] == 1


@given(messages, st.data())
def test_no_changed_bit_passes(message, data):
    frame = bytearray(message.pack(partner()))
    at = data.draw(st.integers(0, len(frame) - 1))
    frame[at] ^= 1 << data.draw(st.integers(0, 7))
    assert not ours().admits(bytes(frame), 0.0)


@pytest.mark.parametrize(
    ("frame", "fault"),
    [
        (heartbeat(partner(None)), Fault.UNSIGNED),
        (heartbeat(partner(None), force_mavlink1=True), Fault.UNSIGNED),
        (heartbeat(partner(bytes(32))), Fault.WRONG_KEY),
        (heartbeat(partner(stamp=STAMP - MINUTE - 1)), Fault.OLD),
        (heartbeat(partner(stamp=STAMP - MINUTE)), None),
        (heartbeat(partner(stamp=STAMP + 500 * MINUTE)), None),
    ],
)
def test_faults_by_name(frame, fault):
    signing = ours()
    assert signing.admits(frame, 0.0) is (fault is None)
    assert signing.refused == {each: int(each is fault) for each in Fault}


def test_a_withheld_packet_grows_old_on_a_stream_that_is_known():
    theirs = partner()
    signing = ours()
    assert signing.admits(heartbeat(theirs), 0.0)
    assert not signing.admits(heartbeat(theirs), 60.1)
    assert signing.refused[Fault.OLD] == 1


def test_a_forged_stamp_does_not_shut_out_the_real_sender():
    signing = ours()
    forged = bytearray(heartbeat(partner(stamp=STAMP + 1000)))
    forged[-1] ^= 1
    assert not signing.admits(bytes(forged), 0.0)
    assert signing.admits(heartbeat(partner(stamp=STAMP + 1)), 0.0)


def test_streams_are_told_apart_by_link_system_and_component():
    signing = ours()
    for ids in ({}, {"system_id": 2}, {"component_id": 2}, {"link_id": 2}):
        assert signing.admits(heartbeat(partner(**ids)), 0.0)


@pytest.mark.parametrize("mavlink1", [False, True])
def test_only_a_radio_may_speak_unsigned(mavlink1):
    signing = ours()
    radio = dialect.MAVLink(None, 51, 68)
    status = dialect.MAVLink_radio_status_message(1, 2, 3, 4, 5, 6, 7)
    assert signing.admits(status.pack(radio, force_mavlink1=mavlink1), 0.0)
    assert not signing.admits(heartbeat(radio, force_mavlink1=mavlink1), 0.0)


@given(st.lists(st.floats(-5.0, 100.0), max_size=50), st.data())
def test_our_stamps_rise_whatever_the_clock_does(steps_s, data):
    signing = ours()
    now_s = 0.0
    newest = 0
    for step_s in steps_s:
        now_s += step_s
        if data.draw(st.booleans()):
            later = partner(stamp=STAMP + data.draw(st.integers(0, 1 << 40)))
            signing.admits(heartbeat(later), now_s)
        stamp = stamp_of(signing.sign(heartbeat(partner(None)), now_s))
        assert stamp > newest
        newest = stamp


def test_stamps_keep_the_time_and_catch_up_with_the_vehicle():
    signing = ours()
    plain = heartbeat(partner(None))
    assert stamp_of(signing.sign(plain, 1.5)) == STAMP + 150_000
    assert signing.admits(heartbeat(partner(stamp=STAMP + 10 * MINUTE)), 2.0)
    assert stamp_of(signing.sign(plain, 2.0)) == STAMP + 10 * MINUTE
    assert stamp_of(signing.sign(plain, 3.0)) == STAMP + 10 * MINUTE + 100_000
    assert stamp_of(signing.sign(plain, 3.0)) == STAMP + 10 * MINUTE + 100_001


def test_the_end_of_all_stamps_raises_nothing():
    last = (1 << 48) - 1
    signing = ours(stamp=last)
    for now_s in (0.0, 1e6):
        assert stamp_of(signing.sign(heartbeat(partner(None)), now_s)) == last


def test_stamps_count_from_2015():
    assert stamp_at(datetime(2015, 1, 1, 0, 0, 1, tzinfo=UTC)) == 100_000
    assert stamp_at(datetime(1970, 1, 1, tzinfo=UTC)) == 0


@pytest.mark.parametrize(
    ("content", "secret", "form"),
    [
        (bytes(range(200, 232)), bytes(range(200, 232)), "raw"),
        (b"0f" * 32, b"\x0f" * 32, "hex"),
        (b"0F" * 32 + b"\r\n", b"\x0f" * 32, "hex"),
        (b"correct horse\n", hashlib.sha256(b"correct horse").digest(), "passphrase"),
        (b"x" * 32, hashlib.sha256(b"x" * 32).digest(), "passphrase"),
        ("geschütz".encode(), hashlib.sha256("geschütz".encode()).digest(), "passphrase"),
        (b" spaces count ", hashlib.sha256(b" spaces count ").digest(), "passphrase"),
    ],
)
def test_the_three_forms_of_a_key_file(tmp_path, content, secret, form):
    path = tmp_path / "key"
    path.write_bytes(content)
    path.chmod(0o600)
    key = load_key(path)
    assert key.secret == secret
    assert form in key.form
    assert str(secret) not in repr(key)


@pytest.mark.parametrize(
    "content", [b"", b"\n", b"two\nlines\n", bytes(range(200, 231)), b"\x00" * 31, b"x" * 1025]
)
def test_no_key_in_the_file(tmp_path, content):
    path = tmp_path / "key"
    path.write_bytes(content)
    path.chmod(0o600)
    with pytest.raises(RefusedError, match="holds no key"):
        load_key(path)


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o666])
def test_a_key_open_to_others_is_refused(tmp_path, mode):
    path = tmp_path / "key"
    path.write_bytes(b"secret")
    path.chmod(mode)
    with pytest.raises(RefusedError, match=f"chmod 600 {path}"):
        load_key(path)


def test_a_key_that_cannot_be_read(tmp_path):
    with pytest.raises(UsageError, match="No such file"):
        load_key(tmp_path / "none")
    with pytest.raises(UsageError, match="Is a directory"):
        load_key(tmp_path)


def test_discovery_says_what_was_dropped(bench):
    for _ in range(3):
        bench.autopilot.heartbeat()
    with pytest.raises(LinkLostError, match="4 not signed; same key on both sides"):
        bench.attach(signing_key=KEY, timeout_s=1.0)


def test_a_neighbour_who_does_not_sign_is_counted_and_told_of_now_and_then(bench):
    theirs = partner(stamp=stamp_at(datetime.now(UTC)))
    bench.transport.deliver(heartbeat(theirs))
    vehicle = bench.attach(signing_key=KEY)
    for _ in range(15):
        bench.autopilot.heartbeat()
        bench.run(1.0)
    told = [event.text for event in vehicle.take_events()]
    first, second = told
    assert first == "packets dropped on the signed link so far: 1 not signed"
    assert second != first
    assert vehicle.stats().packets_refused == 16
