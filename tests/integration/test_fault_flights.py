"""Whole flights of the companion against a mock vehicle that fails, on a virtual clock.

Real MAVLink bytes both ways, no sockets: the real loop and link in front of the real mock. The
verdict is the mock's own.
"""

import numpy as np
import pytest

from companion.control import Flight, Mission
from companion.guidance.shield import Shield, ShieldLimits
from companion.guidance.situation import Plan
from companion.link.opening import attach
from companion.policy.actor import Actor
from companion.positions import TargetSource
from companion.session.records import Event, Tick
from companion.world.maps import load_map
from sim.mock.bench import Bench
from sim.mock.placement import place_vehicle
from sim.mock.vehicle import Settings

ENV1 = load_map("env1")
START_S = 1000.0
TICK_S = 0.01


class BenchTransport:
    """A ``companion.link`` transport whose other end is a mock vehicle in this process."""

    speaks_first = False
    send_errors = 0

    def __init__(self, vehicle, *, dead_at_s=np.inf):
        self.vehicle = vehicle
        self.sent = []
        self._pending = []
        self._time_s = 0.0
        self._dead_at_s = dead_at_s

    def now(self):
        return START_S + self._time_s

    def wait(self, timeout_s):
        target_s = self._time_s + max(0.0, timeout_s)
        while not self._pending and self._time_s < target_s:
            self._time_s = min(self._time_s + TICK_S, target_s)
            self.vehicle.advance(self._time_s)
            self._pending += self.vehicle.take_output()

    def receive(self):
        got, self._pending = self._pending, []
        return [("mock", data) for _, data in got]

    def reply_to(self, peer):
        pass

    def send(self, data):
        self.sent.append((self._time_s, data))
        self.vehicle.receive(0, data)

    def close(self):
        pass


class Flown:
    """One flight and everything about it."""

    def __init__(self, actor, *, faults=(), targets=(), radio=False, source=None, stop_at_s=200.0):
        bench = Bench(
            Settings(place_vehicle(ENV1, None), radio=radio),
            faults=faults,
            targets=targets,
            seed=3,
        )
        transport = BenchTransport(bench.vehicle)
        vehicle = attach(
            transport,
            url="bench",
            target_sysids=[source.system_id] if source and source.system_id else [],
            now=transport.now,
        )
        self.records = []
        flight = Flight(
            vehicle,
            Mission(
                map=ENV1,
                actor=Actor.load(actor),
                plan=Plan(engage=True, arm=True, takeoff_m=6.0),
                target=source or TargetSource(np.array([90.0, 10.0, 6.0])),
                v_max_mps=4.0,
                rate_hz=20.0,
            ),
            Shield(ENV1, ShieldLimits(v_max_mps=4.0)),
            record=self.records.append,
            stop_requested=lambda: transport.now() - START_S > stop_at_s,
        )
        self.summary = flight.run()
        self.verdict = bench.vehicle.report()
        self.events = [record.text for record in self.records if isinstance(record, Event)]
        self.ticks = [record for record in self.records if isinstance(record, Tick)]
        self.setpoint_times_s = [
            time_s for time_s, data in transport.sent if data[7:10] == (84).to_bytes(3, "little")
        ]
        assert self.verdict["contacts"] == []
        assert not any(data[7:10] == (23).to_bytes(3, "little") for _, data in transport.sent), (
            "a parameter was written"
        )

    @property
    def end(self):
        return str(self.summary.outcome), self.summary.exit_code


FROM = "t=4,from=offboard,"


@pytest.fixture
def actor(constant_actor):
    return constant_actor((0.2, 0.0, 0.0))


def test_nothing_wrong(actor):
    flown = Flown(actor)
    assert flown.end == ("arrived", 0)
    assert flown.verdict["setpoints_after_mode_shown"] <= 1
    assert flown.summary.link_loss_percent == 0.0


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("kind=rc_takeover", "POSCTL"),
        ("kind=rc_loss", "LOITER"),
        ("kind=gcs_mode", "LOITER"),
        ("kind=setpoint_deaf", "failsafe"),
        ("kind=second_companion", "1/192"),
        ("kind=reboot", ""),
        ("kind=geofence", ""),
    ],
)
def test_whoever_takes_the_vehicle_gets_it(actor, fault, reason):
    """Mode changes, failsafes, foreign setpoints, reboot: silence in the same tick, for good."""
    flown = Flown(actor, faults=[FROM + fault], radio=True)
    assert flown.end == ("stood_down", 7), flown.events
    assert reason in flown.summary.reason
    assert flown.summary.takeovers == 1
    assert flown.verdict["setpoints_after_mode_shown"] <= 1


def test_a_silent_link_ends_with_the_autopilot_in_charge(actor):
    flown = Flown(actor, faults=[FROM + "kind=link_loss"])
    assert flown.end[1] == 4
    assert "s old" in flown.summary.reason or "nothing heard" in flown.summary.reason


def test_a_short_silence_is_survived_or_stood_down(actor):
    """0.4 s without a packet: the vehicle waits and flies on."""
    flown = Flown(actor, faults=[FROM + "kind=link_loss,for=0.4"])
    assert flown.end == ("arrived", 0), flown.summary.reason
    assert any("position is late" in text for text in flown.events)


@pytest.mark.parametrize("fault", ["kind=loss,percent=20", "kind=duplicate,percent=20",
                                   "kind=corrupt,percent=20"])  # fmt: skip
def test_a_bad_radio_is_flown_through(actor, fault):
    flown = Flown(actor, faults=["t=6," + fault])
    assert flown.end == ("arrived", 0), flown.summary.reason


def test_lost_acks_are_asked_for_again(actor):
    flown = Flown(actor, faults=["t=0,kind=ack_lost,count=2"])
    assert flown.end == ("arrived", 0), flown.summary.reason


@pytest.mark.parametrize("fault", ["kind=ekf_reset,north=3", "kind=origin_move,north=4"])
def test_a_moved_frame_holds_then_flies_on(actor, fault):
    flown = Flown(actor, faults=[FROM + fault])
    assert any("frame has moved" in text for text in flown.events), flown.events
    assert flown.end[0] in ("arrived", "stood_down")


def test_an_estimator_that_gives_up_stops_the_flight(actor):
    flown = Flown(actor, faults=[FROM + "kind=gps_loss"])
    assert flown.end[0] in ("stood_down", "failed", "link_lost")
    assert flown.end[1] in (7, 8, 4)


def test_a_flat_battery_hands_over(actor):
    flown = Flown(actor, faults=[FROM + "kind=battery_low,level=0.1"])
    assert flown.end in (("battery_low", 5), ("stood_down", 7)), flown.summary.reason


WALKER = "kind=circle,sysid=42,at=60:12:6,radius=6,speed=1"


def test_a_moving_target_is_caught(actor):
    flown = Flown(actor, targets=[WALKER], source=TargetSource(system_id=42))
    assert flown.end == ("arrived", 0), flown.summary.reason


def test_a_target_that_falls_silent_stops_the_vehicle_and_then_ends_the_flight(actor):
    flown = Flown(
        actor,
        targets=[WALKER],
        source=TargetSource(system_id=42),
        faults=[FROM + "kind=target_stale"],
    )
    assert flown.end == ("target_lost", 4), flown.summary.reason
    silent = [tick for tick in flown.ticks if tick.target_tier in ("hold", "lost")]
    assert all(not any(tick.safe_enu_mps) for tick in silent if tick.safe_enu_mps)


def test_a_target_that_repeats_itself_is_a_silent_target(actor):
    flown = Flown(
        actor,
        targets=[WALKER],
        source=TargetSource(system_id=42),
        faults=[FROM + "kind=target_freeze"],
    )
    assert flown.end == ("target_lost", 4), flown.summary.reason


def test_a_target_never_heard_is_refused(actor):
    flown = Flown(actor, source=TargetSource(system_id=42))
    assert flown.end == ("refused", 5)
    assert "42" in flown.summary.reason
    assert flown.setpoint_times_s == []
