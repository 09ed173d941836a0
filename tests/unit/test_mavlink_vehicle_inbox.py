import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.vehicle import EventKind

ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, UNSUPPORTED_MAV_FRAME = 0, 1, 2, 3, 9
REPOSITION = dialect.MAV_CMD_DO_REPOSITION
GLOBAL, GLOBAL_RELATIVE_ALT, GLOBAL_INT, TERRAIN = 0, 3, 5, 10
LAT, LON = 473980000, 85460000


def command_int(command=REPOSITION, *, frame=GLOBAL, x=LAT, y=LON, z=500.0, to=(1, 191)):
    return dialect.MAVLink_command_int_message(
        *to, frame, command, 0, 0, -1, 0, 0, math.nan, x, y, z
    )


def command_long(
    command=REPOSITION, *, params=(-1, 0, 0, math.nan, 47.398, 8.546, 500), to=(1, 191)
):
    return dialect.MAVLink_command_long_message(*to, command, 0, *params)


@pytest.fixture
def operator(bench):
    bench.attach()
    bench.run()
    bench.transport.sent.clear()
    return bench.sender(255, 190)


def hear(bench, sender, message):
    """Let a message arrive; return the ACKs it got and the events it made."""
    sender.send(message)
    bench.run()
    acks = bench.transport.sent_of("COMMAND_ACK")
    bench.transport.sent.clear()
    return acks, list(bench.vehicle.take_events())


@pytest.mark.parametrize("message", [command_int(), command_int(frame=GLOBAL_INT), command_long()])
def test_do_reposition_to_us_is_a_target(bench, operator, message):
    (ack,), (event,) = hear(bench, operator, message)
    assert (ack.command, ack.result) == (REPOSITION, ACCEPTED)
    assert (ack.target_system, ack.target_component) == (255, 190)
    assert event.kind is EventKind.REPOSITION
    assert event.target.source == "DO_REPOSITION"
    assert event.target.system_id == 255
    assert event.target.position.latitude_deg == pytest.approx(47.398, abs=1e-5)
    assert event.target.position.longitude_deg == pytest.approx(8.546, abs=1e-5)
    assert event.target.position.altitude_m == 500.0


def test_an_altitude_above_home_needs_home(bench, operator):
    message = command_int(frame=GLOBAL_RELATIVE_ALT, z=30.0)
    (ack,), events = hear(bench, operator, message)
    assert (ack.result, events) == (TEMPORARILY_REJECTED, [])
    bench.autopilot.send(
        dialect.MAVLink_home_position_message(LAT, LON, 489400, 0, 0, 0, (1, 0, 0, 0), 0, 0, 0)
    )
    (ack,), (event,) = hear(bench, operator, message)
    assert ack.result == ACCEPTED
    assert event.target.position.altitude_m == pytest.approx(519.4)


@pytest.mark.parametrize(
    ("message", "result"),
    [
        (command_int(x=0, y=0), DENIED),
        (command_int(x=2**31 - 1), DENIED),
        (command_int(x=-(2**31), y=-(2**31)), DENIED),
        (command_int(z=math.nan), DENIED),
        (command_int(z=math.inf), DENIED),
        (command_long(params=(-1, 0, 0, 0, math.nan, 8.5, 500)), DENIED),
        (command_long(params=(-1, 0, 0, 0, 0, 0, 500)), DENIED),
        (command_long(params=(-1, 0, 0, 0, 47.4, 8.5, math.nan)), DENIED),
        (command_int(frame=TERRAIN), UNSUPPORTED_MAV_FRAME),
        (command_int(frame=1), UNSUPPORTED_MAV_FRAME),
        (command_int(dialect.MAV_CMD_DO_SET_MODE), UNSUPPORTED),
        (command_long(dialect.MAV_CMD_COMPONENT_ARM_DISARM), UNSUPPORTED),
        (command_long(65535), UNSUPPORTED),
        (command_long(dialect.MAV_CMD_REQUEST_MESSAGE, params=(30, 0, 0, 0, 0, 0, 0)), UNSUPPORTED),
        (
            command_long(dialect.MAV_CMD_REQUEST_MESSAGE, params=(math.nan, 0, 0, 0, 0, 0, 0)),
            UNSUPPORTED,
        ),
    ],
)
def test_whatever_else_is_addressed_to_us_gets_one_answer_and_moves_nothing(
    bench, operator, message, result
):
    (ack,), events = hear(bench, operator, message)
    assert (ack.result, events) == (result, [])


@pytest.mark.parametrize("to", [(1, 191), (1, 0)])
def test_we_say_who_we_are(bench, operator, to):
    operator.send(command_long(512, params=(148, 0, 0, 0, 0, 0, 0), to=to))
    bench.run()
    assert [message.get_type() for message in bench.transport.sent] == [
        "COMMAND_ACK",
        "AUTOPILOT_VERSION",
    ]
    assert bench.transport.sent[1].capabilities & dialect.MAV_PROTOCOL_CAPABILITY_COMMAND_INT


@pytest.mark.parametrize("to", [(1, 1), (2, 191), (0, 0), (1, 0), (1, 190)])
def test_what_is_addressed_to_others_gets_no_answer(bench, operator, to):
    for message in (
        command_long(dialect.MAV_CMD_DO_SET_MODE, to=to),
        command_int(dialect.MAV_CMD_COMPONENT_ARM_DISARM, to=to),
    ):
        assert hear(bench, operator, message) == ([], [])


def test_the_autopilots_own_broadcasts_get_no_answer(bench, operator):
    """PX4 sends gimbal commands 1000 and 1001 to component 0 in flight."""
    assert hear(bench, bench.autopilot, command_long(1000, to=(1, 0))) == ([], [])
    assert hear(bench, bench.autopilot, command_long(1001, to=(0, 0))) == ([], [])


def local_setpoint(to=(1, 1)):
    return dialect.MAVLink_set_position_target_local_ned_message(
        0, *to, 1, 3527, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0
    )


def global_setpoint(to=(1, 1)):
    return dialect.MAVLink_set_position_target_global_int_message(
        0, *to, 6, 3527, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0
    )


@pytest.mark.parametrize(
    "message",
    [
        local_setpoint(),
        local_setpoint((1, 0)),
        local_setpoint((0, 0)),
        global_setpoint(),
        command_int(to=(1, 1)),
        command_long(to=(1, 1)),
    ],
)
@pytest.mark.parametrize("source", [(255, 190), (1, 192), (2, 1), (1, 191)])
def test_somebody_else_steering_our_vehicle_is_told(bench, operator, source, message):
    acks, (event,) = hear(bench, bench.sender(*source), message)
    assert acks == []
    assert event.kind is EventKind.FOREIGN_SETPOINT
    assert f"{source[0]}/{source[1]}" in event.text


@pytest.mark.parametrize("message", [local_setpoint((2, 1)), local_setpoint((1, 154))])
def test_steering_another_vehicle_is_not_our_business(bench, operator, message):
    assert hear(bench, operator, message) == ([], [])


def test_a_foreign_stream_is_told_once_a_second(bench, operator):
    told = []
    for _ in range(60):
        operator.send(local_setpoint())
        bench.run(0.05)
        told += bench.vehicle.take_events()
    assert 3 <= len(told) <= 4


def test_a_setpoint_of_a_target_system_is_foreign_too(bench):
    vehicle = bench.attach(target_sysids=(42,))
    bench.sender(42).send(local_setpoint())
    bench.run()
    assert [event.kind for event in vehicle.take_events()] == [EventKind.FOREIGN_SETPOINT]


def test_the_echo_of_our_own_setpoint_is_not_foreign(bench, operator):
    bench.vehicle.send_velocity(np.zeros(3))
    _, _, frame = bench.tapped[-1]
    bench.transport.deliver(frame)
    bench.run()
    assert bench.vehicle.take_events() == ()
