"""Flights that go on, end or never begin: bad radios, lost answers, strangers, signals, orders."""

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.control import Flight, Mission
from companion.guidance.shield import Shield
from companion.guidance.shield_limits import ShieldLimits
from companion.guidance.situation import Plan
from companion.link.autopilots import Px4
from companion.link.messages import velocity_of
from companion.link.opening import attach
from companion.positions import TargetSource
from companion.world.frames import LocalTie
from sim.mock.placement import place_vehicle
from sim.mock.px4.personality import PX4
from tests.integration.flown import BOTH, ENV1, WALKER, Flown, dies, hears, message_id


@pytest.fixture
def actor(constant_actor):
    return constant_actor((0.2, 0.0, 0.0))


@pytest.mark.parametrize(
    ("kind", "autopilot"),
    [("loss", "px4"), ("loss", "ardupilot"), ("duplicate", "px4"), ("corrupt", "px4")],
)
def test_a_bad_radio_is_flown_through(actor, kind, autopilot):
    flown = Flown(actor, faults=[f"t=6,kind={kind},percent=20"], autopilot=autopilot)
    flown.check_conduct()
    assert flown.end == ("arrived", 0), flown.summary.reason


@pytest.mark.parametrize("autopilot", BOTH)
def test_the_climb_counts_as_flown(actor, autopilot):
    """ArduPilot calls all of it TAKING_OFF; its own log had 10 m more than the summary."""
    flown = Flown(actor, autopilot=autopilot)
    assert flown.end == ("arrived", 0), flown.summary.reason
    assert flown.summary.distance_flown_m == pytest.approx(flown.verdict["distance_flown_m"], abs=1)


def test_lost_acks_are_asked_for_again(actor):
    flown = Flown(actor, faults=["t=0,kind=ack_lost,count=2"])
    assert flown.end == ("arrived", 0), flown.summary.reason


def test_a_moving_target_is_caught(actor):
    flown = Flown(actor, targets=[WALKER], source=TargetSource(system_id=42))
    flown.check_conduct()
    assert flown.end == ("arrived", 0), flown.summary.reason


@pytest.mark.parametrize("autopilot", BOTH)
def test_somebody_else_steering_before_the_flight_keeps_it_from_starting(actor, autopilot):
    flown = Flown(actor, faults=["t=0,kind=second_companion"], autopilot=autopilot)
    assert flown.end[0] in ("refused", "stood_down")
    assert flown.summary.reason_code == "foreign_setpoint"
    assert not any(velocity.any() for _, velocity in flown.setpoints)
    assert not flown.told("arming")


@pytest.mark.parametrize("autopilot", BOTH)
def test_a_signal_while_arming_leaves_nothing_armed(actor, autopilot):
    def stop_when_armed(flown):
        before = flown.wire.on_tick

        def on_tick():
            before()
            flown.stopping |= flown.vehicle.autopilot.armed

        flown.wire.on_tick = on_tick

    flown = Flown(actor, autopilot=autopilot, prepare=stop_when_armed)
    assert flown.end == ("stopped", 130)
    assert not flown.vehicle.autopilot.armed
    assert "not confirmed" not in flown.summary.reason


@pytest.mark.parametrize("autopilot", BOTH)
def test_started_again_after_it_died_in_flight_it_waits_for_the_pilot(actor, autopilot):
    """A stream that resumes would take the vehicle out of its failsafe: PX4 does that by itself."""
    flown = Flown(actor, happens=dies, autopilot=autopilot)
    wire = flown.wire
    started_s = wire.time_s
    wire.killed, wire.on_tick = False, lambda: None
    link = attach(wire, url="bench", now=wire.now)
    flight = Flight(
        link,
        Mission(
            map=ENV1,
            actor=flown.actor,
            plan=Plan(stream_before_external=link.info.needs_stream_before_external),
            target=TargetSource(np.array([66.0, 10.0, 6.0])),
            v_max_mps=4.0,
            rate_hz=20.0,
        ),
        Shield(ENV1, ShieldLimits(v_max_mps=4.0)),
        record=lambda record: None,
        stop_requested=lambda: wire.time_s > started_s + 20.0,
    )
    assert flight.run().outcome == "stopped"
    again = [velocity_of(frame) for time_s, frame in wire.sent if time_s > started_s]
    assert all(velocity is None for velocity in again), "a stream that nobody needs yet"
    modes = [mode for time_s, mode in flown.vehicle.report()["timeline"] if time_s > started_s]
    assert not any("OFFBOARD armed" in mode for mode in modes)


def reposition(enu_m):
    """DO_REPOSITION to the companion, to a point of the map as the mock lays it on earth."""
    place = place_vehicle(ENV1, None, PX4)
    origin = place.home
    tie = LocalTie.from_launch(ENV1.launch_enu_m, origin, earth_radius_m=Px4.earth_radius_m)
    point = tie.map_to_geodetic(np.array(enu_m))
    return dialect.MAVLink_command_int_message(
        1, 191, 0, dialect.MAV_CMD_DO_REPOSITION, 0, 0, -1, 0, 0, 0,
        round(point.latitude_deg * 1e7), round(point.longitude_deg * 1e7), point.altitude_m,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("enu_m", "result"),
    [
        ((66.0, 10.0, 6.0), dialect.MAV_RESULT_ACCEPTED),
        ((50.0, 48.0, 20.0), dialect.MAV_RESULT_DENIED),
        ((50.0, 480.0, 20.0), dialect.MAV_RESULT_DENIED),
    ],
)
def test_a_target_by_mavlink_is_flown_to_only_if_it_was_accepted(actor, enu_m, result):
    flown = Flown(
        actor, source=TargetSource(), happens=hears(255, 190, reposition(enu_m)), stop_at_s=45.0
    )
    flown.check_conduct()
    (ack,) = (
        dialect.MAVLink(None).decode(bytearray(frame))
        for _, frame in flown.wire.sent
        if message_id(frame) == dialect.MAVLINK_MSG_ID_COMMAND_ACK
    )
    assert (ack.command, ack.result) == (dialect.MAV_CMD_DO_REPOSITION, result)
    accepted = result == dialect.MAV_RESULT_ACCEPTED
    assert (flown.end[0] == "arrived") is accepted, flown.events
    assert any(velocity.any() for _, velocity in flown.setpoints) is accepted


@pytest.mark.slow
@pytest.mark.timeout(1800.0)
@pytest.mark.parametrize("autopilot", BOTH)
def test_takeover_at_any_moment_on_the_wire(actor, autopilot):
    """Two hundred moments of a whole flight, each mode a pilot may choose."""
    rng = np.random.default_rng(7)
    modes = {"px4": ("posctl", "altctl", "loiter", "rtl", "land")}.get(autopilot, ("loiter", "rtl"))
    for _ in range(100):
        text = f"t={rng.uniform(0.0, 26.0):.2f},kind=rc_takeover,mode={rng.choice(modes)}"
        flown = Flown(actor, faults=[text], autopilot=autopilot, radio=True)
        flown.check_conduct()
        # Who chose a mode that cannot be armed in, before anything was asked, is waited for.
        waits = flown.end[0] == "stopped" and "waiting for ready-to-arm" in "".join(flown.events)
        assert flown.end[1] in (0, 6, 7) or (waits and not flown.setpoints), (text, flown.summary)
