"""The mock against a recorded ArduCopter: same requests, then compare answers and timelines.

One flight is in ``tests/data``; the others run where COMPANION_CAPTURES names their folder.
"""

import bisect
import collections
import os
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock.ardupilot.personality import ARDUPILOT
from sim.mock.bench import Bench
from sim.mock.placement import place_vehicle
from sim.mock.vehicle import Settings

SHORT = "ap_short_flight_companion"
BOOT_S = 41.6
FIRST_S = 1.0
"""ArduPilot's clock when its first byte was recorded."""
NOT_SENT = {"TERRAIN_REQUEST", "PARAM_VALUE"}
"""What it sends by itself and the mock leaves out."""
PILOT = ((65.76, "loiter"), (73.77, "stabilize"), (74.38, "loiter"), (76.18, "guided"))
"""When the pilot's switch moved in the recorded take-over; then the transmitter failed."""
RADIO_LOST_S, RADIO_BACK_S = 86.28, 91.27

BOOTING = 1
JUST_LANDED = (0xD9, 9, 3)

CAPTURES = os.environ.get("COMPANION_CAPTURES")
NAMES = (
    SHORT,
    "ap_early_requests",
    "ap_flight_guided_velocity",
    "ap_gcs_failsafe",
    "ap_pilot_takeover_companion_port",
)


def is_autopilots(frame):
    return (frame[5], frame[6]) == (1, 1)


class Flight:
    """A recording and what the mock made of the same requests."""

    def __init__(self, name, frames):
        first = next(t for t, frame in frames if is_autopilots(frame))
        self.name = name
        self.frames = [(t - first + FIRST_S, frame) for t, frame in frames]
        self.end_s = self.frames[-1][0]
        self.theirs = collections.defaultdict(list)
        self.ours = collections.defaultdict(list)
        parser = mavlink.MAVLink(None)
        for t, frame in self.frames:
            if is_autopilots(frame):
                message = parser.decode(bytearray(frame))
                self.theirs[message.get_type()].append((t, message))
        self._replay()

    def _replay(self):
        place = place_vehicle(None, None, ARDUPILOT)
        bench = Bench(Settings(place, boot_s=BOOT_S, radio=True, personality=ARDUPILOT))
        copter = bench.vehicle.autopilot
        events = [(t, lambda f=f: bench.vehicle.receive(0, f)) for t, f in self.frames]
        events = [event for event, (_, f) in zip(events, self.frames, strict=True)
                  if not is_autopilots(f)]  # fmt: skip
        if "pilot" in self.name:
            for t, mode in PILOT:
                events.append((t, lambda m=mode: copter.choose_mode(m, by_pilot=True)))
            events.append((RADIO_LOST_S, lambda: copter.lose_radio(lost=True)))
            events.append((RADIO_BACK_S, lambda: copter.lose_radio(lost=False)))
        for t, act in sorted(events, key=lambda event: event[0]):
            bench.run(max(0.0, t - bench.time_s))
            act()
        bench.run(max(0.0, self.end_s + 1.0 - bench.time_s))  # one more heartbeat
        for received in bench.received:
            if is_autopilots(received.packet[:]):
                self.ours[received.name].append((received.time_s, received.message))

    def timelines(self, name, key):
        """Return (theirs, ours) as lists of (time, value) of every change."""
        return tuple(changes(side[name], key) for side in (self.theirs, self.ours))


def changes(messages, key):
    found = []
    for time_s, message in messages:
        value = key(message)
        if not found or found[-1][1] != value:
            found.append((time_s, value))
    return found


def agree(expected, found, abs_s):
    assert [value for _, value in found] == [value for _, value in expected]
    assert [t for t, _ in found] == pytest.approx([t for t, _ in expected], abs=abs_s)


@pytest.fixture(scope="module", params=NAMES)
def flight(request, recorded_flight, tlog_reader):
    if request.param == SHORT:
        return Flight(SHORT, recorded_flight(SHORT))
    if CAPTURES is None:
        pytest.skip("COMPANION_CAPTURES names no folder of recordings")
    data = (Path(CAPTURES) / f"{request.param}.tlog").read_bytes()
    return Flight(request.param, tlog_reader(data))


def test_every_command_gets_the_recorded_answer(flight):
    theirs, ours = (
        [(m.command, m.result, m.target_component) for _, m in side["COMMAND_ACK"]]
        for side in (flight.theirs, flight.ours)
    )
    assert ours == theirs
    for (t, _), (recorded_s, _) in zip(
        flight.ours["COMMAND_ACK"], flight.theirs["COMMAND_ACK"], strict=True
    ):
        assert t == pytest.approx(recorded_s, abs=0.2)


def test_modes_change_as_recorded_within_a_fifth_of_a_second(flight):
    # The first heartbeats of a boot race with the first requests.
    expected, found = (
        [(t, mode) for t, mode in side if t > 3.0]
        for side in flight.timelines("HEARTBEAT", lambda m: m.custom_mode)
    )
    agree(expected, found, 0.2)


def test_heartbeat_shows_the_recorded_states_in_order(flight):
    def key(message):
        return message.base_mode, message.custom_mode, message.system_status

    # The first heartbeats of a boot race with the first requests; landed and disarmed are half a
    # second apart, and one of the two may fall between heartbeats.
    expected, found = (
        [value for _, value in side if value[2] != BOOTING and value != JUST_LANDED]
        for side in flight.timelines("HEARTBEAT", key)
    )
    assert found == expected


def test_arming_and_landing_show_when_recorded(flight):
    # Once a second: when one shows a change depends on its phase.
    def armed(message):
        return bool(message.base_mode & 0x80)

    agree(*flight.timelines("HEARTBEAT", armed), 1.5)


def test_landed_state_changes_as_recorded(flight):
    expected, found = flight.timelines("EXTENDED_SYS_STATE", lambda m: m.landed_state)
    agree(expected, found, 1.05)


def test_estimator_flags_go_through_the_recorded_stages(flight):
    expected, found = flight.timelines("EKF_STATUS_REPORT", lambda m: m.flags)
    agree(expected, found, 0.3)


def test_setpoint_echo_shows_the_recorded_masks(flight):
    expected, found = flight.timelines("POSITION_TARGET_LOCAL_NED", lambda m: m.type_mask)
    assert [value for _, value in found] == [value for _, value in expected]


def test_texts_are_the_recorded_ones_in_order(flight):
    # IMU0 and IMU1 may speak in either order; the simulator's own text is not the autopilot's.
    theirs, ours = (
        [m.text.replace("IMU1", "IMU0") for _, m in side["STATUSTEXT"] if m.text[:3] != "SIM"]
        for side in (flight.theirs, flight.ours)
    )
    if flight.name == "ap_early_requests":
        ours.remove("No such mode 500")  # the recording ends before it
    assert ours == theirs


def test_rates_are_within_ten_percent(flight):
    start_s = 46.0
    duration_s = flight.end_s - start_s
    for name, messages in flight.theirs.items():
        if name in NOT_SENT or name in ("COMMAND_ACK", "STATUSTEXT"):
            continue
        rate_hz, found_hz = (
            sum(start_s < t <= flight.end_s for t, _ in side) / duration_s
            for side in (messages, flight.ours[name])
        )
        # What is sent in some modes only follows their length.
        slack = max(0.1 * rate_hz, 2.1 / duration_s)
        if name == "POSITION_TARGET_GLOBAL_INT":
            slack = max(slack, 0.3 * rate_hz)
        assert found_hz == pytest.approx(rate_hz, abs=slack), name


def test_it_flies_where_the_recorded_one_flew(flight):
    ours = flight.ours["LOCAL_POSITION_NED"]
    stamps = [t for t, _ in ours]
    level, height = [], []
    for t, there in flight.theirs["LOCAL_POSITION_NED"]:
        if t < 43.0:
            continue
        here = ours[min(len(ours) - 1, bisect.bisect(stamps, t))][1]
        level.append(max(abs(here.x - there.x), abs(here.y - there.y)))
        height.append(abs(here.z - there.z))
    returns = "failsafe" in flight.name or "pilot" in flight.name
    assert max(level) < (7.0 if returns else 0.8)  # its return accelerates more gently
    assert max(height) < (2.0 if returns else 0.8)
