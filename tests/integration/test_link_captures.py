"""Recordings of real autopilots through the link; see ``tests/data/README.md``.

Two short flights come with the repository. Name the folder of the full set in the environment
variable ``COMPANION_CAPTURES`` to run all of them.
"""

import itertools
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from companion.link.codec import Codec, Parser
from companion.link.opening import attach
from companion.vehicle import EventKind

CLIENTS = {(1, 191), (255, 190)}
"""Who flew the vehicle when it was recorded; what they sent is not what a link hears."""

PX4_SHORT = "px4_short_flight_companion_30s"
AP_SHORT = "ap_short_flight_companion"

ALL = (
    PX4_SHORT,
    AP_SHORT,
    "ap_boot_passive",
    "ap_early_requests",
    "ap_flight_guided_velocity",
    "ap_gcs_failsafe",
    "ap_gps_loss_speedup10_until_ready",
    "ap_pilot_takeover_companion_port",
    "px4_boot_onboard_passive",
    "px4_early_requests",
    "px4_flight_offboard_velocity",
    "px4_offboard_loss_and_resume",
    "px4_pilot_takeover",
    "px4_short_flight_companion",
)


@pytest.fixture(scope="session")
def load(recorded_flight, tlog_reader):
    """Return the frames of a recording; skip where only the full set has it."""

    def frames_of(name):
        if name in (PX4_SHORT, AP_SHORT):
            return recorded_flight(name)
        folder = os.environ.get("COMPANION_CAPTURES")
        if not folder:
            pytest.skip("set COMPANION_CAPTURES to the folder of the recordings")
        return tlog_reader((Path(folder) / f"{name}.tlog").read_bytes())

    return frames_of


@dataclass
class Replay:
    """What the link made of a recording; times from its first frame."""

    vehicle: object
    states: list
    events: list
    frame_count: int

    def modes(self):
        return [mode for mode, _ in itertools.groupby(s.mode_name for _, s in self.states)]

    def first(self, predicate):
        return next(time_s for time_s, state in self.states if predicate(state))

    def state_at(self, time_s):
        return next(state for when_s, state in self.states if when_s >= time_s)

    def texts(self):
        return [event.text for event in self.events if event.kind is EventKind.STATUS_TEXT]


@pytest.fixture
def replay(load, memory_transport):
    """Replay what a link would have heard, under virtual time."""

    def run(name):
        everything = load(name)
        zero_s = everything[0][0]
        frames = [
            (time_s - zero_s, frame)
            for time_s, frame in everything
            if (frame[5], frame[6]) not in CLIENTS
        ]
        transport = memory_transport()
        start_s = transport.now_s
        for time_s, frame in frames:
            transport.deliver(frame, after_s=time_s)
        vehicle = attach(transport, url="recording", timeout_s=30.0, now=transport.now)
        states, events = [], []
        end_s = start_s + frames[-1][0]
        while transport.now_s < end_s:
            vehicle.wait_until(transport.now_s + 0.05)
            events += vehicle.take_events()
            if (state := vehicle.state()) is not None:
                states.append((transport.now_s - start_s, state))
        return Replay(vehicle, states, events, len(frames))

    return run


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("sizes", [(1,), (7, 1, 64, 3, 280, 1500)], ids=["bytes", "odd chunks"])
def test_every_packet_is_cut_out_whole(load, name, sizes):
    frames = [frame for _, frame in load(name)]
    stream = b"".join(frames)
    parser = Parser()
    received = []
    size_of = itertools.cycle(sizes)
    position = 0
    while position < len(stream):
        size = next(size_of)
        received += parser.receive(stream[position : position + size], 0.0)
        position += size
    assert [packet.frame for packet in received] == frames
    assert parser.bytes_bad == 0
    assert parser.packets_lost.get((1, 1), 0) == 0


@pytest.mark.parametrize("name", ALL)
def test_every_packet_decodes_or_is_of_no_dialect(load, name):
    parser, codec = Parser(), Codec(1, 191)
    strange = set()
    for time_s, frame in load(name):
        (received,) = parser.receive(frame, time_s)
        if codec.decode(received) is None:
            strange.add(received.message_id)
    assert strange <= {8, 290, 291, 380, 410, 411, 436, 441, 514}
    if name.startswith("ap_"):
        assert not strange


@pytest.mark.parametrize("name", ALL)
def test_nothing_is_lost_or_foreign_and_nothing_resets_in_flight(replay, name):
    flown = replay(name)
    stats = flown.vehicle.stats()
    assert (stats.packets_lost, stats.bytes_bad, stats.packets_foreign) == (0, 0, 0)
    assert stats.packets_received >= flown.frame_count - 5  # the very last may be a tick away
    assert flown.vehicle.info.autopilot == ("px4" if name.startswith("px4") else "ardupilot")
    kinds = {event.kind for event in flown.events}
    assert kinds <= {EventKind.STATUS_TEXT}
    armed_epochs = {state.frame_epoch for _, state in flown.states if state.armed}
    assert len(armed_epochs) <= 1
    for _, state in flown.states:
        with pytest.raises(ValueError, match="read-only"):
            state.position_ned_m[0] = 1.0
        break


@pytest.mark.parametrize("name", ALL)
def test_local_and_global_position_agree_on_real_autopilots(replay, name):
    """What the loop holds for is a metre; real vehicles stay within centimetres."""
    residuals_m = [state.frame_residual_m for _, state in replay(name).states]
    known_m = [residual_m for residual_m in residuals_m if residual_m is not None]
    assert len(known_m) > 0.8 * len(residuals_m)
    assert max(known_m) < 0.1


def test_px4_short_flight(replay):
    flown = replay(PX4_SHORT)
    assert flown.modes() == ["AUTO.LOITER", "OFFBOARD", "AUTO.LAND"]
    assert flown.first(lambda s: s.ready_to_arm) == pytest.approx(4.7, abs=0.2)
    assert flown.first(lambda s: s.position_valid) == pytest.approx(3.6, abs=0.2)
    assert flown.first(lambda s: s.armed) == pytest.approx(6.7, abs=0.2)
    assert flown.first(lambda s: s.landed.name == "IN_AIR") == pytest.approx(8.4, abs=0.3)
    assert flown.first(lambda s: s.mode.name == "LAND") == pytest.approx(26.8, abs=0.2)
    state = flown.state_at(10.0)
    assert state.origin.latitude_deg == pytest.approx(47.397743, abs=1e-5)
    assert state.origin.longitude_deg == pytest.approx(8.545594, abs=1e-5)
    assert min(s.position_ned_m[2] for _, s in flown.states) == pytest.approx(-10, abs=1.0)
    assert max(s.velocity_ned_mps[0] for _, s in flown.states) == pytest.approx(2.0, rel=0.25)
    assert flown.vehicle.stats().rates_hz["ATTITUDE"] == pytest.approx(97, abs=5)
    assert not flown.texts()  # PX4 sends none to a companion


def test_ardupilot_short_flight(replay):
    flown = replay(AP_SHORT)
    assert flown.modes() == ["STABILIZE", "GUIDED", "LAND"]
    assert flown.first(lambda s: s.position_valid and s.ready_to_arm) == pytest.approx(41, abs=1)
    assert flown.first(lambda s: s.armed) == pytest.approx(43.1, abs=0.2)
    assert flown.first(lambda s: s.landed.name == "TAKING_OFF") == pytest.approx(46.2, abs=0.3)
    assert flown.first(lambda s: s.landed.name == "IN_AIR") == pytest.approx(53.2, abs=0.3)
    assert flown.state_at(60.0).position_ned_m[2] == pytest.approx(-10.0, abs=0.2)
    assert flown.state_at(88.0).armed
    assert not flown.states[-1][1].armed
    assert flown.states[-1][1].landed.name == "ON_GROUND"
    origin = flown.states[-1][1].origin
    assert (origin.latitude_deg, origin.longitude_deg) == pytest.approx(
        (-35.363261, 149.16523), abs=1e-5
    )
    assert "EKF3 IMU0 is using GPS" in flown.texts()
    assert flown.texts()[-1] == "Disarming motors"


def test_px4_setpoint_loss_shows_as_return_and_critical(replay):
    flown = replay("px4_flight_offboard_velocity")
    assert flown.modes() == [
        "AUTO.LOITER", "OFFBOARD", "AUTO.RTL", "OFFBOARD", "AUTO.LOITER", "OFFBOARD", "AUTO.LAND",
        "OFFBOARD",
    ]  # fmt: skip
    lost = flown.state_at(38.5)
    assert (lost.mode.name, lost.system_status.name) == ("RETURN", "CRITICAL")
    assert "RTL: start return at 520 m (30 m above destination)" in flown.texts()
    assert "Arming denied: Resolve system health failures first" not in flown.texts()


def test_px4_texts_are_joined(replay):
    texts = replay("px4_early_requests").texts()
    assert "Arming denied: Resolve system health failures first" in texts
    assert not any(text.endswith(("\t", "firs")) for text in texts)


def test_px4_without_a_stream_is_never_ready(replay):
    flown = replay("px4_early_requests")
    waiting = [s for time_s, s in flown.states if 5.0 < time_s < 60.0]
    assert {s.mode_name for s in waiting} == {"OFFBOARD"}
    assert not any(s.ready_to_arm for s in waiting)


def test_px4_pilot(replay):
    flown = replay("px4_pilot_takeover")
    assert flown.modes()[:8] == [
        "AUTO.LOITER", "OFFBOARD", "POSCTL", "OFFBOARD", "POSCTL", "OFFBOARD", "POSCTL", "OFFBOARD",
    ]  # fmt: skip
    assert flown.state_at(41.6).system_status.name == "CRITICAL"


def test_ardupilot_pilot_and_radio_failsafe(replay):
    flown = replay("ap_pilot_takeover_companion_port")
    assert flown.modes() == [
        "STABILIZE", "GUIDED", "LOITER", "GUIDED", "STABILIZE", "LOITER", "GUIDED", "RTL", "LAND",
    ]  # fmt: skip
    assert flown.state_at(85.5).system_status.name == "CRITICAL"
    assert "Radio Failsafe" in flown.texts()


def test_ardupilot_stays_in_guided_when_the_stream_stops(replay):
    flown = replay("ap_flight_guided_velocity")
    assert flown.modes() == ["STABILIZE", "GUIDED", "BRAKE", "GUIDED", "LAND"]
    fastest = max(s.velocity_ned_mps[0] for _, s in flown.states)
    assert fastest == pytest.approx(3.05, abs=0.1)


def test_ardupilot_without_gps_is_not_vouched_for(replay):
    flown = replay("ap_gps_loss_speedup10_until_ready")
    lost_s = next(time_s for time_s, s in flown.states if s.armed and not s.position_valid)
    land_s = flown.first(lambda s: s.mode.name == "LAND")
    assert lost_s == pytest.approx(31.9, abs=0.3)
    assert lost_s < land_s < lost_s + 2.0
    assert flown.state_at(land_s + 0.5).system_status.name == "CRITICAL"
    assert all(np.isfinite(s.position_ned_m).all() for _, s in flown.states)
