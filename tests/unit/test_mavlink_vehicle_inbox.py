import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.vehicle import CommandAnswer, CommandKind, EventKind, Verdict

ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, UNSUPPORTED_MAV_FRAME = 0, 1, 2, 3, 9
REPOSITION = dialect.MAV_CMD_DO_REPOSITION
PAUSE = dialect.MAV_CMD_DO_PAUSE_CONTINUE
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
def orders():
    return []


@pytest.fixture
def operator(bench, orders):
    bench.attach()
    bench.vehicle.judge_commands(lambda order: orders.append(order) or bench.verdict)
    bench.verdict = CommandAnswer(Verdict.ACCEPTED)
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
def test_do_reposition_to_us_is_judged_before_it_is_acknowledged(bench, operator, orders, message):
    (ack,), (event,) = hear(bench, operator, message)
    assert (ack.command, ack.result) == (REPOSITION, ACCEPTED)
    assert (ack.target_system, ack.target_component) == (255, 190)
    (order,) = orders
    assert (order.kind, order.sender) == (CommandKind.REPOSITION, "255/190")
    assert order.position.latitude_deg == pytest.approx(47.398, abs=1e-5)
    assert order.position.longitude_deg == pytest.approx(8.546, abs=1e-5)
    assert order.position.altitude_m == 500.0
    assert (event.kind, event.text) == (EventKind.COMMAND, "DO_REPOSITION of 255/190: accepted")


@pytest.mark.parametrize("verdict", Verdict)
def test_the_judges_verdict_is_the_answer(bench, operator, verdict):
    bench.verdict = CommandAnswer(verdict, "because")
    (ack,), (event,) = hear(bench, operator, command_int())
    assert ack.result == verdict
    assert event.text.endswith("because")


def test_before_a_flight_begins_orders_are_put_off(bench, operator):
    bench.vehicle.judge_commands(None)
    (ack,), (event,) = hear(bench, operator, command_int())
    assert ack.result == TEMPORARILY_REJECTED
    assert "no flight has begun" in event.text


@pytest.mark.parametrize(("param1", "kind"), [(0, CommandKind.PAUSE), (1, CommandKind.CONTINUE)])
@pytest.mark.parametrize("make", [command_long, None])
def test_pause_and_continue(bench, operator, orders, param1, kind, make):
    if make is None:
        message = dialect.MAVLink_command_int_message(
            1, 191, 0, PAUSE, 0, 0, param1, 0, 0, 0, 0, 0, 0
        )
    else:
        message = make(PAUSE, params=(param1, 0, 0, 0, 0, 0, 0))
    (ack,), _ = hear(bench, operator, message)
    assert (ack.command, ack.result) == (PAUSE, ACCEPTED)
    assert [order.kind for order in orders] == [kind]


def test_an_altitude_above_home_needs_home(bench, operator, orders):
    message = command_int(frame=GLOBAL_RELATIVE_ALT, z=30.0)
    (ack,), events = hear(bench, operator, message)
    assert (ack.result, events) == (TEMPORARILY_REJECTED, [])
    bench.autopilot.send(
        dialect.MAVLink_home_position_message(LAT, LON, 489400, 0, 0, 0, (1, 0, 0, 0), 0, 0, 0)
    )
    (ack,), _ = hear(bench, operator, message)
    assert ack.result == ACCEPTED
    assert orders[0].position.altitude_m == pytest.approx(519.4)


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
        (command_long(PAUSE, params=(2, 0, 0, 0, 0, 0, 0)), DENIED),
        (command_long(PAUSE, params=(math.nan, 0, 0, 0, 0, 0, 0)), DENIED),
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
