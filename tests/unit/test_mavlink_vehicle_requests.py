import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.vehicle import RequestKind, RequestState

SET_MODE = dialect.MAV_CMD_DO_SET_MODE
ARM = dialect.MAV_CMD_COMPONENT_ARM_DISARM
TAKEOFF = dialect.MAV_CMD_NAV_TAKEOFF
ACCEPTED, TEMPORARILY_REJECTED, FAILED, IN_PROGRESS = 0, 1, 4, 5
OFFBOARD = 0x00060000
LOITER = 0x03040000
RTL = 0x05040000


def status(bench):
    return bench.vehicle.request_status()


def talk(bench, duration_s):
    """Let time pass while the vehicle beats twice a second, as ever in LOITER."""
    for _ in range(round(2 * duration_s)):
        bench.autopilot.heartbeat(LOITER)
        bench.run(0.5)


def test_idle_before_anything_was_asked(px4):
    assert (status(px4).kind, status(px4).state) == (None, RequestState.IDLE)


def test_accepted_is_not_yet_confirmed(px4):
    px4.answers[SET_MODE] = lambda message: px4.acknowledge(SET_MODE, ACCEPTED, after_s=0.02)
    px4.vehicle.request(RequestKind.EXTERNAL)
    (command,) = px4.commands(SET_MODE)
    assert (command.param1, command.param2, command.param3) == (1, 6, 0)
    assert (command.target_system, command.target_component, command.confirmation) == (1, 1, 0)
    px4.run(0.5)
    assert status(px4).state is RequestState.PENDING
    px4.autopilot.heartbeat(OFFBOARD)
    px4.run()
    assert status(px4).state is RequestState.CONFIRMED
    px4.run(5.0)
    assert len(px4.commands(SET_MODE)) == 1


def test_the_heartbeat_confirms_even_if_the_acknowledgement_is_lost(px4):
    px4.vehicle.request(RequestKind.EXTERNAL)
    px4.run(0.3)
    px4.autopilot.heartbeat(OFFBOARD)
    px4.run()
    assert status(px4).state is RequestState.CONFIRMED


def test_what_is_so_already_needs_the_acknowledgement(px4):
    """A failsafe's own LOITER is no answer to our HOLD."""
    px4.vehicle.request(RequestKind.HOLD)
    px4.autopilot.heartbeat(LOITER, armed=True, status=5)
    px4.run(0.5)
    assert status(px4).state is RequestState.PENDING
    px4.acknowledge(SET_MODE, ACCEPTED)
    px4.run()
    assert status(px4).state is RequestState.CONFIRMED


def test_an_old_heartbeat_confirms_nothing(px4):
    px4.acknowledge(SET_MODE, ACCEPTED, after_s=0.1)
    px4.vehicle.request(RequestKind.HOLD)
    px4.run(0.5)
    assert status(px4).state is RequestState.PENDING
    px4.autopilot.heartbeat(LOITER)
    px4.run()
    assert status(px4).state is RequestState.CONFIRMED


def test_three_tries_and_then_silence(px4):
    px4.vehicle.request(RequestKind.LAND)
    start_s = px4.transport.now_s
    talk(px4, 10.0)
    assert [message.confirmation for message in px4.commands(SET_MODE)] == [0, 1, 2]
    assert (status(px4).state, status(px4).detail) == (
        RequestState.TIMED_OUT,
        "no answer to 3 tries",
    )
    assert px4.transport.now_s - start_s == pytest.approx(10.0)


def test_accepted_and_never_seen(px4):
    px4.acknowledge(ARM, ACCEPTED, after_s=0.01)
    px4.vehicle.request(RequestKind.ARM)
    px4.run(6.0)
    assert status(px4).state is RequestState.TIMED_OUT
    assert "not seen" in status(px4).detail
    assert len(px4.commands(ARM)) == 1


def test_an_answer_is_no_older_than_its_question_however_long_the_loop_was_away(px4):
    px4.run(0.1)
    px4.transport.now_s += 3.0
    px4.acknowledge(ARM, ACCEPTED, after_s=0.0)
    px4.vehicle.request(RequestKind.ARM)
    px4.run(2.0)  # it was read at once, with the stamp of before the pause
    assert status(px4).state is RequestState.PENDING
    px4.autopilot.heartbeat(armed=True)
    px4.run(0.1)
    assert status(px4).state is RequestState.CONFIRMED


def test_arming_never_forces(px4):
    px4.vehicle.request(RequestKind.ARM)
    (command,) = px4.commands(ARM)
    assert (command.param1, command.param2) == (1.0, 0.0)
    px4.autopilot.heartbeat(LOITER, armed=True)
    px4.run()
    assert status(px4).state is RequestState.CONFIRMED


@pytest.mark.parametrize(
    ("result", "name"),
    [(1, "TEMPORARILY_REJECTED"), (2, "DENIED"), (3, "UNSUPPORTED"), (4, "FAILED"), (77, "77")],
)
def test_a_rejection_carries_the_result_by_name(px4, result, name):
    px4.acknowledge(SET_MODE, result, after_s=0.01)
    px4.vehicle.request(RequestKind.RETURN)
    px4.run(1.0)
    assert status(px4).state is RequestState.REJECTED
    assert name in status(px4).detail
    assert len(px4.commands(SET_MODE)) == 1


@pytest.mark.parametrize("text_first", [True, False])
def test_a_rejection_carries_what_the_vehicle_said(ardupilot, text_first):
    text = dialect.MAVLink_statustext_message(2, b"Arm: System not initialised")
    ardupilot.autopilot.send(text, after_s=0.01 if text_first else 0.04)
    ardupilot.acknowledge(ARM, FAILED, after_s=0.02)
    ardupilot.vehicle.request(RequestKind.ARM)
    ardupilot.run(0.5)
    assert status(ardupilot).detail == "FAILED: Arm: System not initialised"


def test_talk_is_no_reason(ardupilot):
    ardupilot.autopilot.send(dialect.MAVLink_statustext_message(6, b"Field Elevation Set"))
    ardupilot.acknowledge(ARM, FAILED, after_s=0.02)
    ardupilot.vehicle.request(RequestKind.ARM)
    ardupilot.run(0.5)
    assert status(ardupilot).detail == "FAILED"


def test_in_progress_extends_and_is_never_sent_again(px4):
    px4.answers[TAKEOFF] = lambda message: px4.acknowledge(TAKEOFF, IN_PROGRESS, after_s=0.1)
    px4.vehicle.request(RequestKind.TAKEOFF, altitude_m=10.0)
    px4.acknowledge(TAKEOFF, IN_PROGRESS, after_s=2.5)
    px4.run(5.0)
    assert status(px4).state is RequestState.PENDING
    assert len(px4.commands(TAKEOFF)) == 1
    px4.run(1.0)
    assert status(px4).state is RequestState.TIMED_OUT


@pytest.mark.parametrize("target", [(1, 190), (255, 191), (255, 190)])
def test_answers_to_others_are_not_ours(px4, target):
    px4.vehicle.request(RequestKind.EXTERNAL)
    px4.acknowledge(SET_MODE, FAILED, after_s=0.01, target=target)
    px4.run(0.1)
    assert status(px4).state is RequestState.PENDING


def test_answers_to_other_commands_are_not_ours(px4):
    px4.vehicle.request(RequestKind.EXTERNAL)
    px4.acknowledge(dialect.MAV_CMD_SET_MESSAGE_INTERVAL, FAILED, after_s=0.01)
    px4.run(0.1)
    assert status(px4).state is RequestState.PENDING


def test_an_acknowledgement_without_a_target_is_taken(px4):
    px4.vehicle.request(RequestKind.EXTERNAL)
    px4.acknowledge(SET_MODE, TEMPORARILY_REJECTED, after_s=0.01, target=(0, 0))
    px4.run(0.1)
    assert status(px4).state is RequestState.REJECTED


def test_a_new_request_replaces_the_pending_one(px4):
    px4.vehicle.request(RequestKind.EXTERNAL)
    px4.run(0.1)
    px4.vehicle.request(RequestKind.HOLD)
    talk(px4, 10.0)
    modes = [message.param2 for message in px4.commands(SET_MODE)]
    assert modes == [6, 4, 4, 4]
    assert status(px4).kind is RequestKind.HOLD


def test_the_answer_to_the_request_before_is_not_taken_for_this_ones(px4):
    px4.acknowledge(SET_MODE, FAILED, after_s=0.2)  # a slow link: the answer to the first
    px4.vehicle.request(RequestKind.EXTERNAL)
    px4.run(0.1)
    px4.vehicle.request(RequestKind.LAND)
    px4.run(0.3)
    assert status(px4).state is RequestState.PENDING
    px4.acknowledge(SET_MODE, ACCEPTED)
    px4.autopilot.heartbeat(0x06040000)
    px4.run()
    assert status(px4).state is RequestState.CONFIRMED


def test_an_answer_that_was_lost_long_ago_is_not_waited_for(px4):
    px4.vehicle.request(RequestKind.EXTERNAL)
    px4.autopilot.heartbeat(OFFBOARD)
    px4.run(3.0)
    px4.acknowledge(SET_MODE, FAILED, after_s=0.01)
    px4.vehicle.request(RequestKind.HOLD)
    px4.run(0.1)
    assert status(px4).state is RequestState.REJECTED


@pytest.mark.parametrize("kind", [RequestKind.EXTERNAL, RequestKind.LAND, RequestKind.TAKEOFF])
@pytest.mark.parametrize("accepted", [False, True])
def test_a_pilot_who_chooses_a_mode_meanwhile_is_not_asked_again(px4, kind, accepted):
    px4.landed(1)
    px4.run()
    px4.vehicle.request(kind, altitude_m=10.0)
    sent = len(px4.transport.sent_of("COMMAND_LONG"))
    if accepted:
        px4.acknowledge(TAKEOFF if kind is RequestKind.TAKEOFF else SET_MODE, ACCEPTED)
    px4.autopilot.heartbeat(0x00030000, armed=True, after_s=0.1)
    px4.run(5.0)
    assert status(px4).state is RequestState.REJECTED
    assert status(px4).detail == "somebody else chose POSCTL"
    commands = px4.transport.sent_of("COMMAND_LONG")[sent:]
    assert not [message for message in commands if message.command in (SET_MODE, TAKEOFF)]


def test_into_a_silence_nothing_is_asked_again_until_the_heartbeat_shows_the_same_mode(px4):
    px4.vehicle.request(RequestKind.LAND)
    px4.run(2.0)
    assert len(px4.commands(SET_MODE)) == 2  # at once and after 0.7 s
    px4.position()
    px4.run(0.5)
    assert len(px4.commands(SET_MODE)) == 2  # it is heard again, but not what mode it is in
    px4.autopilot.heartbeat(LOITER)
    px4.run(0.1)
    assert len(px4.commands(SET_MODE)) == 3


def test_a_failsafe_that_began_in_a_silence_is_not_taken_back(px4):
    px4.vehicle.request(RequestKind.LAND)
    px4.run(1.5)
    px4.position()
    px4.run(0.5)
    px4.autopilot.heartbeat(RTL, armed=True, status=5)
    px4.run(5.0)
    assert len(px4.commands(SET_MODE)) == 2
    assert status(px4).detail == "somebody else chose AUTO.RTL"


def test_arming_is_no_matter_of_modes(px4):
    px4.vehicle.request(RequestKind.ARM)
    px4.run(5.0)
    assert len(px4.commands(ARM)) == 3


def test_a_reboot_ends_what_was_pending(px4):
    px4.vehicle.request(RequestKind.LAND)
    px4.position(boot_ms=500)
    px4.run()
    assert (status(px4).state, status(px4).detail) == (
        RequestState.REJECTED,
        "the autopilot rebooted",
    )


def test_px4_takes_off_above_sea_level(px4):
    px4.vehicle.request(RequestKind.TAKEOFF, altitude_m=10.0)
    (command,) = px4.commands(TAKEOFF)
    assert command.param7 == pytest.approx(489.4 + 3.0 + 10.0)  # origin, 3 m above it, 10 m more
    assert all(map(math.isnan, (command.param4, command.param5, command.param6)))


def test_px4_shows_a_take_off_by_its_mode(px4):
    px4.landed(1)
    px4.run()
    px4.vehicle.request(RequestKind.TAKEOFF, altitude_m=10.0)
    px4.run(0.1)
    px4.autopilot.heartbeat(0x02040000)
    px4.run()
    assert status(px4).state is RequestState.CONFIRMED


def test_px4_without_an_origin_is_not_asked_to_take_off(bench):
    bench.attach()
    bench.vehicle.request(RequestKind.TAKEOFF, altitude_m=10.0)
    assert status(bench).state is RequestState.REJECTED
    assert "GPS_GLOBAL_ORIGIN" in status(bench).detail
    assert bench.commands(TAKEOFF) == []


def test_ardupilot_takes_off_above_home(ardupilot):
    ardupilot.autopilot.heartbeat(4, autopilot=3, armed=True)
    ardupilot.vehicle.request(RequestKind.TAKEOFF, altitude_m=10.0)
    (command,) = ardupilot.commands(TAKEOFF)
    assert command.param7 == 10.0
    ardupilot.acknowledge(TAKEOFF, ACCEPTED)
    ardupilot.run(3.0)  # spinning up
    assert status(ardupilot).state is RequestState.PENDING
    ardupilot.autopilot.heartbeat(4, autopilot=3, armed=True, status=4)
    ardupilot.landed(3)
    ardupilot.run()
    assert status(ardupilot).state is RequestState.CONFIRMED


@pytest.mark.parametrize("altitude_m", [None, 0.0, -5.0, math.nan, math.inf])
def test_a_take_off_to_nowhere_is_a_mistake(px4, altitude_m):
    with pytest.raises(ValueError, match="altitude"):
        px4.vehicle.request(RequestKind.TAKEOFF, altitude_m=altitude_m)
    assert px4.commands(TAKEOFF) == []
