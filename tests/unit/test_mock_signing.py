"""MAVLink 2 signing of the mock, checked by pymavlink's own end of it."""

import hashlib

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.errors import UsageError
from sim.mock.ardupilot.personality import ARDUPILOT
from sim.mock.bench import Bench
from sim.mock.placement import place_vehicle
from sim.mock.px4.personality import PX4
from sim.mock.signing import TICKS_PER_S, load_key
from sim.mock.vehicle import Settings

KEY = bytes(range(1, 33))
OTHER_KEY = bytes(32 * [7])
STAMP = 12 * 365 * 24 * 3600 * TICKS_PER_S
ARM = 400


def holder(key=KEY, *, stamp=STAMP, identity=(1, 191), link_id=3):
    """An end of pymavlink's that signs and checks."""
    codec = mavlink.MAVLink(None, *identity)
    codec.robust_parsing = True
    codec.signing.secret_key = key
    codec.signing.sign_outgoing = True
    codec.signing.timestamp = stamp
    codec.signing.link_id = link_id
    return codec


def command(number, *params):
    padded = [*params, *(0.0,) * (7 - len(params))]
    return mavlink.MAVLink_command_long_message(1, 1, number, 0, *padded)


def answers(bench):
    return [(m.command, m.result) for m in bench.all("COMMAND_ACK")]


def booted(personality, *, usb_link=0, **options):
    """A vehicle which signs."""
    settings = Settings(
        place_vehicle(None, None, personality),
        personality=personality,
        signing_key=KEY,
        signing_stamp=STAMP,
        usb_link=usb_link,
    )
    bench = Bench(settings, **options)
    bench.run(2.0)
    return bench


@pytest.fixture(params=[PX4, ARDUPILOT], ids=lambda personality: personality.name)
def signed(request):
    """Return a function that boots a vehicle which signs."""
    return lambda **options: booted(request.param, **options)


def test_everything_that_leaves_is_signed_and_verifies(signed):
    faults = ["t=1,kind=second_companion"]
    bench = signed(targets=["kind=circle,sysid=42"], faults=faults)
    bench.vehicle.receive(0, command(511, 32, 100_000).pack(holder()))
    bench.run(2.0)
    checker = holder(stamp=0)
    senders = set()
    for received in bench.received:
        assert received.packet[2] & 1
        (message,) = checker.parse_buffer(received.packet)
        assert message.get_type() != "BAD_DATA"
        senders.add((received.packet[5], received.packet[6]))
    assert senders == {(1, 1), (1, 192), (42, 1)}


def test_stamps_follow_the_time_and_always_rise(signed):
    bench = signed()
    bench.run(3.0)
    stamps = [int.from_bytes(r.packet[-12:-6], "little") for r in bench.received]
    assert stamps == sorted(set(stamps))
    elapsed = bench.received[-1].time_s - bench.received[0].time_s
    assert stamps[-1] - stamps[0] == pytest.approx(elapsed * TICKS_PER_S, rel=0.01)


def test_a_holder_of_the_key_is_obeyed(signed):
    bench = signed()
    bench.vehicle.receive(0, command(ARM, 1.0).pack(holder()))
    bench.run(0.1)
    assert answers(bench)[0][0] == ARM
    assert bench.vehicle.report()["packets_refused"] == {}


def test_who_does_not_sign_meets_silence_and_is_counted(signed):
    bench = signed()
    bench.send(command(ARM, 1.0))
    v1 = command(ARM, 1.0).pack(mavlink.MAVLink(None, 1, 191), force_mavlink1=True)
    bench.vehicle.receive(0, v1)
    bench.run(0.1)
    assert answers(bench) == []
    assert bench.vehicle.report()["packets_refused"] == {"unsigned": 2}


def test_who_signs_with_another_key_meets_silence_and_does_not_spoil_the_clock(signed):
    bench = signed()
    forged = holder(OTHER_KEY, stamp=STAMP + 1000 * 60 * TICKS_PER_S)
    bench.vehicle.receive(0, command(ARM, 1.0).pack(forged))
    assert bench.vehicle.report()["packets_refused"] == {"wrong signature": 1}
    bench.vehicle.receive(0, command(ARM, 1.0).pack(holder()))
    bench.run(0.1)
    assert len(answers(bench)) == 1


def test_a_replayed_packet_is_dropped(signed):
    bench = signed()
    packet = command(ARM, 1.0).pack(holder())
    bench.vehicle.receive(0, packet)
    bench.vehicle.receive(0, packet)
    bench.run(0.1)
    assert len(answers(bench)) == 1
    assert bench.vehicle.report()["packets_refused"] == {"replayed": 1}


@pytest.mark.parametrize(("late_s", "heard"), [(50.0, True), (70.0, False)])
def test_a_new_sender_may_be_a_minute_behind(signed, late_s, heard):
    bench = signed()
    late = holder(stamp=STAMP - round((late_s - bench.time_s) * TICKS_PER_S))
    bench.vehicle.receive(0, command(ARM, 1.0).pack(late))
    bench.run(0.1)
    assert bool(answers(bench)) is heard
    assert bench.vehicle.report()["packets_refused"] == ({} if heard else {"old": 1})


def test_senders_and_their_links_have_stamps_of_their_own(signed):
    bench = signed()
    for identity, link_id in (((1, 191), 0), ((1, 191), 1), ((255, 190), 0)):
        early = holder(identity=identity, link_id=link_id)
        bench.vehicle.receive(0, command(ARM, 1.0).pack(early))
    bench.run(0.1)
    assert len(answers(bench)) == 3


RADIO = mavlink.MAVLink_radio_status_message(1, 2, 3, 4, 5, 6, 7)
HEARTBEAT = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)


@pytest.mark.parametrize(
    ("personality", "message", "refused"),
    [(PX4, RADIO, 0), (PX4, HEARTBEAT, 0), (ARDUPILOT, RADIO, 0), (ARDUPILOT, HEARTBEAT, 1)],
    ids=["px4, radio", "px4, heartbeat", "ardupilot, radio", "ardupilot, heartbeat"],
)
def test_some_messages_need_no_signature(personality, message, refused):
    bench = booted(personality)
    bench.send(message, identity=(51, 68))
    assert bench.vehicle.report()["packets_refused"].get("unsigned", 0) == refused


@pytest.mark.parametrize(("personality", "obeys"), [(PX4, False), (ARDUPILOT, True)])
def test_only_ardupilot_trusts_whoever_is_on_its_usb_port(personality, obeys):
    bench = booted(personality, ground_links=(False, False), usb_link=2)
    forged = command(176, 1.0, 4.0).pack(holder(OTHER_KEY))
    bench.vehicle.receive(1, forged)
    bench.send(command(176, 1.0, 4.0), link=1)
    bench.run(0.1)
    assert len(bench.all("COMMAND_ACK", link=1)) == (2 if obeys else 0)
    bench.send(command(176, 1.0, 4.0), link=0)
    bench.run(0.1)
    assert bench.all("COMMAND_ACK", link=0) == []


def test_a_key_of_zeros_with_a_stamp_is_a_key():
    bench = Bench()
    bench.run(2.0)
    bench.send(mavlink.MAVLink_setup_signing_message(1, 1, bytes(32), STAMP))
    assert bench.command(ARM, 1.0) is None


def test_a_key_can_be_set_up_and_taken_away_on_the_ground():
    bench = Bench()
    bench.run(2.0)
    assert not any(received.packet[2] & 1 for received in bench.received)
    bench.send(mavlink.MAVLink_setup_signing_message(1, 1, KEY, STAMP))
    bench.run(0.1)
    start = len(bench.received)
    bench.run(1.0)
    assert all(received.packet[2] & 1 for received in bench.received[start:])
    assert bench.command(ARM, 1.0) is None
    away = mavlink.MAVLink_setup_signing_message(1, 1, bytes(32), 0)
    bench.vehicle.receive(0, away.pack(holder(stamp=STAMP + 60 * TICKS_PER_S)))
    assert bench.command(ARM, 1.0) == 0


def test_no_key_is_taken_in_flight():
    bench = Bench()
    bench.run(2.0)
    assert bench.command(ARM, 1.0) == 0
    bench.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), identity=(255, 190))
    bench.send(mavlink.MAVLink_setup_signing_message(1, 1, KEY, STAMP))
    assert bench.command(ARM, 1.0) == 0
    bench.run(0.2)
    assert bench.texts()[-1] == "ERROR: Won't setup signing when armed"


@pytest.mark.parametrize(
    ("content", "key"),
    [
        (KEY, KEY),
        (KEY.hex().encode() + b"\n", KEY),
        (b"open sesame\n", hashlib.sha256(b"open sesame").digest()),
        (b"x" * 64, hashlib.sha256(b"x" * 64).digest()),
        (b"y" * 32, hashlib.sha256(b"y" * 32).digest()),
    ],
    ids=["raw", "hexadecimal", "passphrase", "passphrase of 64", "passphrase of 32"],
)
def test_forms_of_a_key_file(tmp_path, content, key):
    path = tmp_path / "key"
    path.write_bytes(content)
    assert load_key(path) == key


def test_a_key_file_that_holds_none_is_refused(tmp_path):
    with pytest.raises(UsageError, match="cannot read --signing-key"):
        load_key(tmp_path / "missing")
    (tmp_path / "empty").write_bytes(b"\n")
    with pytest.raises(UsageError, match="is empty"):
        load_key(tmp_path / "empty")
