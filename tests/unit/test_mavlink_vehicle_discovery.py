import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.errors import AmbiguousVehicleError, LinkLostError, RefusedError, UsageError
from companion.link.opening import attach
from companion.vehicle import EventKind


def find(transport, **options):
    return attach(transport, url="udp:here", now=transport.now, **{"timeout_s": 5.0, **options})


@pytest.fixture
def wire(memory_transport):
    return memory_transport()


def test_the_only_autopilot_is_taken(wire, sender):
    sender(wire, 3).heartbeat(after_s=0.4)
    vehicle = find(wire)
    info = vehicle.info
    assert (info.system_id, info.autopilot, info.needs_stream_before_external) == (3, "px4", True)
    vehicle.wait_until(wire.now_s + 0.1)
    assert {message.get_srcSystem() for message in wire.sent} == {3}
    assert {message.get_srcComponent() for message in wire.sent} == {191}


def test_ardupilot_is_known_by_its_heartbeat(wire, sender):
    sender(wire, 1).heartbeat(0, autopilot=3)
    info = find(wire).info
    assert (info.autopilot, info.needs_stream_before_external) == ("ardupilot", False)


def test_ground_stations_and_companions_are_no_vehicles(wire, sender):
    sender(wire, 255, 190).heartbeat(0, autopilot=8, kind=6)
    sender(wire, 254, 1).heartbeat(0, autopilot=0, kind=6)
    sender(wire, 1, 191).heartbeat(0, autopilot=8, kind=18)
    sender(wire, 2, 154).heartbeat(0, autopilot=3)
    sender(wire, 7).heartbeat(after_s=2.0)
    assert find(wire).info.system_id == 7


@pytest.mark.parametrize("apart_s", [0.0, 0.9, 1.4])
def test_two_autopilots_and_none_chosen(wire, sender, apart_s):
    sender(wire, 2).heartbeat()
    sender(wire, 1).heartbeat(after_s=apart_s)
    with pytest.raises(AmbiguousVehicleError, match="system ids 1, 2; choose with --vehicle-sysid"):
        find(wire)


def test_two_autopilots_and_one_chosen(wire, sender):
    sender(wire, 2).heartbeat()
    sender(wire, 1).heartbeat(after_s=0.8)
    start_s = wire.now_s
    assert find(wire, vehicle_sysid=1).info.system_id == 1
    # named: no waiting for others, only the second for AUTOPILOT_VERSION
    assert wire.now_s - start_s <= 0.8 + 1.01


def test_a_target_with_an_autopilot_is_not_the_vehicle(wire, sender):
    sender(wire, 42).heartbeat()
    sender(wire, 1).heartbeat(after_s=3.0)
    assert find(wire, target_sysids=(42,)).info.system_id == 1


def test_the_vehicle_cannot_be_its_own_target(wire, sender):
    with pytest.raises(UsageError, match="both vehicle and target"):
        find(wire, vehicle_sysid=1, target_sysids=(1,))
    sender(wire, 1).heartbeat()
    with pytest.raises(UsageError, match="cannot be its own target"):
        find(wire, target_sysids=(1,))


def test_silence(wire):
    start_s = wire.now_s
    with pytest.raises(LinkLostError, match=r"no autopilot heard on udp:here within 5 s; is it"):
        find(wire)
    assert wire.now_s - start_s == pytest.approx(5.0)


def test_garbage(wire):
    wire.deliver(b"\xfd garbage " * 20)
    with pytest.raises(LinkLostError, match=r"200 bytes came .* no MAVLink .* wrong baud rate"):
        find(wire)


def test_only_others(wire, sender):
    sender(wire, 255, 190).heartbeat(0, autopilot=8, kind=6)
    with pytest.raises(LinkLostError, match="MAVLink comes only from 255/190"):
        find(wire)


def test_the_wrong_one(wire, sender):
    sender(wire, 2).heartbeat()
    sender(wire, 9).heartbeat()
    with pytest.raises(LinkLostError, match=r"vehicle 1 not heard .* system ids 2, 9"):
        find(wire, vehicle_sysid=1)


@pytest.mark.parametrize(("autopilot", "kind"), [(0, 2), (3, 1), (12, 10)])
def test_what_the_companion_does_not_fly(wire, sender, autopilot, kind):
    sender(wire, 1).heartbeat(0, autopilot=autopilot, kind=kind)
    with pytest.raises(RefusedError, match="MAV_"):
        find(wire)


def test_where_we_must_speak_first_we_do(memory_transport, sender):
    wire = memory_transport(speaks_first=True)
    sender(wire, 1).heartbeat(after_s=2.2)
    find(wire)
    heartbeats = wire.sent_of("HEARTBEAT")
    assert len(heartbeats) == 4
    for message in heartbeats:
        assert message.type == dialect.MAV_TYPE_ONBOARD_CONTROLLER
        assert message.autopilot == dialect.MAV_AUTOPILOT_INVALID


def test_where_we_listen_nothing_is_sent_before_the_vehicle_is_known(wire):
    with pytest.raises(LinkLostError):
        find(wire)
    assert wire.sent == []


def test_two_vehicles_with_one_id_are_not_mixed(wire, sender):
    sender(wire, 1, peer="here").heartbeat()
    sender(wire, 1, peer="there").heartbeat(after_s=1.0)
    with pytest.raises(AmbiguousVehicleError, match="system id 1 is heard from here and there"):
        find(wire)


def test_answers_go_to_the_peer_that_carries_the_vehicle(wire, sender):
    sender(wire, 42, peer="target").heartbeat(after_s=0.1)
    sender(wire, 1, peer="first").heartbeat()
    vehicle = find(wire, target_sysids=(42,))
    assert wire.reply_peer == "first"
    sender(wire, 42, peer="target").heartbeat()
    vehicle.wait_until(wire.now_s + 0.1)
    assert wire.reply_peer == "first"
    sender(wire, 1, peer="second").heartbeat(after_s=3.0)  # a new address after a silence
    vehicle.wait_until(wire.now_s + 3.1)
    assert wire.reply_peer == "second"


def test_a_rival_with_the_same_id_is_told_and_not_believed(wire, sender):
    ours = sender(wire, 1, peer="first")
    ours.heartbeat()
    vehicle = find(wire)
    told = []
    for _ in range(30):
        ours.heartbeat()
        sender(wire, 1, peer="rival").send(
            dialect.MAVLink_local_position_ned_message(1000, 9, 9, 9, 0, 0, 0)
        )
        vehicle.wait_until(wire.now_s + 0.1)
        told += vehicle.take_events()
    assert wire.reply_peer == "first"
    assert "LOCAL_POSITION_NED" not in vehicle.stats().rates_hz
    assert vehicle.stats().packets_foreign == 30
    assert {event.kind for event in told} == {EventKind.LINK_ERROR}
    assert 3 <= len(told) <= 4


def test_what_was_heard_while_looking_is_not_forgotten(wire, sender):
    autopilot = sender(wire, 1)
    autopilot.heartbeat()
    autopilot.send(dialect.MAVLink_gps_global_origin_message(473977420, 85455940, 489400))
    autopilot.send(dialect.MAVLink_local_position_ned_message(1000, 1, 2, 3, 0, 0, 0))
    autopilot.send(dialect.MAVLink_attitude_message(1000, 0, 0, 0, 0, 0, 0))
    state = find(wire).state()
    assert state.origin.latitude_deg == pytest.approx(47.397742)
    assert state.time_s == 1000.0  # when it arrived, not when it was looked at
