"""Whole flights of the companion against a mock vehicle that fails, on a virtual clock.

Real MAVLink bytes both ways, no sockets: the real loop and link in front of the real mock, whose
verdict counts. One row of ``ROWS`` for every safety event; run this file as a program to print
them as a table with the measured times::

    PYTHONPATH=. python tests/integration/test_fault_flights.py 2>/dev/null
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.control import Flight, Mission
from companion.guidance.shield import Shield, ShieldLimits
from companion.guidance.situation import Plan
from companion.link.autopilots import Px4
from companion.link.messages import velocity_of
from companion.link.opening import attach
from companion.policy.actor import Actor
from companion.positions import TargetSource
from companion.session.records import Event, Tick
from companion.world.frames import LocalTie
from companion.world.maps import load_map
from sim.mock.ardupilot.personality import ARDUPILOT
from sim.mock.bench import Bench
from sim.mock.faults import parse_fault
from sim.mock.placement import place_vehicle
from sim.mock.px4.personality import PX4
from sim.mock.vehicle import Settings

ENV1 = load_map("env1")
START_S = 1000.0
TICK_S = 0.01
AFTER_S = 4.0
"""Something happens so long after the first setpoint that flies the vehicle."""
PERSONALITIES = {"px4": PX4, "ardupilot": ARDUPILOT}
WALKER = "kind=circle,sysid=42,at=60:12:6,radius=6,speed=1"
HEARS = (
    "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "ATTITUDE", "SYS_STATUS", "EXTENDED_SYS_STATE",
    "ESTIMATOR_STATUS", "EKF_STATUS_REPORT", "ODOMETRY", "GPS_GLOBAL_ORIGIN", "HOME_POSITION",
    "STATUSTEXT", "TIMESYNC",
)  # fmt: skip


def message_id(frame):
    return int.from_bytes(frame[7:10], "little")


class Killed(BaseException):
    """The program is gone, as after SIGKILL."""


class Wire:
    """A ``companion.link`` transport whose other end is a mock vehicle in this process."""

    speaks_first = False
    send_errors = 0

    def __init__(self, vehicle):
        self.vehicle = vehicle
        self.time_s = 0.0
        self.sent = []
        """``(time_s, frame)`` of ours."""
        self.left_external_s = None
        """When the companion was handed a HEARTBEAT that shows that its mode is over."""
        self.muted = frozenset()
        """Message ids that do not come through."""
        self.killed = False
        self.stall_s = 0.0
        self.on_tick = lambda: None
        self._pending = []
        self._external = False

    def now(self):
        return START_S + self.time_s

    def wait(self, timeout_s):
        target_s = self.time_s + max(0.0, timeout_s) + self.stall_s
        away, self.stall_s = self.stall_s > 0.0, 0.0
        while (away or not self._pending) and self.time_s < target_s:
            self.pass_time(min(self.time_s + TICK_S, target_s))
        if self.killed:
            raise Killed

    def pass_time(self, time_s):
        self.time_s = time_s
        self.vehicle.advance(time_s)
        self.on_tick()
        self._pending += [data for _, data in self.vehicle.take_output()]

    def inject(self, system_id, component_id, message):
        """Let the companion hear somebody else on the link; the vehicle does not."""
        self._pending.append(message.pack(dialect.MAVLink(None, system_id, component_id)))

    def receive(self):
        got, self._pending = self._pending, []
        passed = [frame for frame in got if message_id(frame) not in self.muted]
        for frame in passed:
            if message_id(frame) == dialect.MAVLINK_MSG_ID_HEARTBEAT and frame[5:7] == b"\1\1":
                self._look_at(frame)
        return [("mock", frame) for frame in passed]

    def _look_at(self, frame):
        try:
            heartbeat = dialect.MAVLink(None).decode(bytearray(frame))
        except dialect.MAVError:  # corrupt: nobody has heard it
            return
        external = heartbeat.custom_mode in (4, 6 << 16)
        if self._external and not external and self.left_external_s is None:
            self.left_external_s = self.time_s
        self._external = external

    def reply_to(self, peer):
        pass

    def send(self, data):
        self.sent.append((self.time_s, data))
        self.vehicle.receive(0, data)

    def close(self):
        pass


class MoodyActor:
    """An actor that can be made to answer nonsense."""

    def __init__(self, actor):
        self._actor = actor
        self.bad_answers = 0

    def __getattr__(self, name):
        return getattr(self._actor, name)

    def act(self, observation):
        if self.bad_answers:
            self.bad_answers -= 1
            return np.full(3, np.nan, dtype=np.float32)
        return self._actor.act(observation)


class Flown:
    """One flight and everything about it."""

    def __init__(
        self,
        actor,
        *,
        happens=None,
        after_s=AFTER_S,
        autopilot="px4",
        targets=(),
        faults=(),
        radio=False,
        source=None,
        prepare=None,
        stop_at_s=200.0,
    ):
        personality = PERSONALITIES[autopilot]
        bench = Bench(
            Settings(place_vehicle(ENV1, None, personality), radio=radio, personality=personality),
            targets=targets,
            faults=faults,
            seed=3,
            hears=HEARS,
        )
        self.wire = wire = Wire(bench.vehicle)
        self.vehicle = bench.vehicle
        self.targets = [target.sysid for target in bench.vehicle.targets]
        self.happened_s = None
        self.coasted_m = 0.0
        """How far it flew after the program was killed, until it stood still."""
        self._happens, self._due_s, self._after_s = happens, None, after_s
        wire.on_tick = self._watch
        self.stopping = False
        if prepare is not None:
            prepare(self)
        self.actor = MoodyActor(Actor.load(actor))
        link = attach(
            wire,
            url="bench",
            target_sysids=[source.system_id] if source and source.system_id else [],
            now=wire.now,
        )
        self.records = []
        flight = Flight(
            link,
            Mission(
                map=ENV1,
                actor=self.actor,
                plan=Plan(
                    engage=True, arm=True, takeoff_m=6.0,
                    stream_before_external=link.info.needs_stream_before_external,
                ),
                target=source or TargetSource(np.array([66.0, 10.0, 6.0])),
                v_max_mps=4.0,
                rate_hz=20.0,
            ),
            Shield(ENV1, ShieldLimits(v_max_mps=4.0)),
            record=self.records.append,
            stop_requested=lambda: self.stopping or wire.time_s > stop_at_s,
        )  # fmt: skip
        self.summary = None
        try:
            self.summary = flight.run()
        except Killed:
            self.ended_s = wire.time_s
            body = bench.vehicle.autopilot.body
            while wire.time_s < self.ended_s + 8.0 and np.hypot(*body.velocity_mps[:2]) > 0.2:
                wire.pass_time(wire.time_s + TICK_S)
                self.coasted_m += TICK_S * np.hypot(*body.velocity_mps[:2])
            self.stood_s = wire.time_s
        else:
            self.ended_s = wire.time_s
        self.verdict = bench.vehicle.report()
        self.events = [record.text for record in self.records if isinstance(record, Event)]
        self.ticks = [record for record in self.records if isinstance(record, Tick)]
        self.setpoints = [
            (time_s, velocity)
            for time_s, frame in wire.sent
            if (velocity := velocity_of(frame)) is not None
        ]

    def _watch(self):
        if self._due_s is None and self.vehicle.autopilot.steered:
            self._due_s = self.wire.time_s + self._after_s
        due = self._due_s is not None and self.wire.time_s >= self._due_s
        if due and self.happened_s is None and self._happens is not None:
            self.happened_s = self.wire.time_s
            self._happens(self)

    @property
    def end(self):
        return str(self.summary.outcome), self.summary.exit_code

    def told(self, text):
        return any(text in event for event in self.events)

    def still_s(self):
        """Return how long after the event setpoints went on to move it, to the first that rests."""
        times_s = [time_s for time_s, velocity in self.setpoints if time_s >= self.happened_s]
        moving_s = [
            time_s
            for time_s, velocity in self.setpoints
            if time_s >= self.happened_s and velocity.any()
        ]
        resting_s = [time_s for time_s in times_s if time_s not in moving_s]
        first_rest_s = min(resting_s, default=np.inf)
        before_rest = [time_s for time_s in moving_s if time_s < first_rest_s]
        return max(before_rest, default=self.happened_s) - self.happened_s

    def silent_s(self):
        """Return how long after the event the very last setpoint left."""
        times_s = [time_s for time_s, _ in self.setpoints if time_s >= self.happened_s]
        return max(times_s, default=self.happened_s) - self.happened_s

    def check_conduct(self):
        """What must hold in every flight, whatever happens."""
        assert self.verdict["contacts"] == []
        assert all(np.isfinite(velocity).all() for _, velocity in self.setpoints)
        ids = [message_id(frame) for _, frame in self.wire.sent]
        assert dialect.MAVLINK_MSG_ID_PARAM_SET not in ids, "a parameter was written"
        heartbeats = [
            frame for _, frame in self.wire.sent
            if message_id(frame) == dialect.MAVLINK_MSG_ID_HEARTBEAT
        ]  # fmt: skip
        assert {frame[14] for frame in heartbeats} == {dialect.MAV_TYPE_ONBOARD_CONTROLLER}
        if self.wire.left_external_s is not None:
            late = [t for t, _ in self.setpoints if t > self.wire.left_external_s]
            assert late == [], "setpoints after the HEARTBEAT that ended our mode"


# -- what can happen ---------------------------------------------------------------------------


def fault(text) -> Callable[[Flown], None]:
    """A fault of the mock's own, by its ``--fault`` text; ``for=SECONDS`` ends it."""

    def happens(flown):
        parsed = parse_fault(
            text, links=1, targets=flown.targets, personality=flown.vehicle.settings.personality
        )
        undo = parsed.act(flown.vehicle)
        if undo is not None and np.isfinite(parsed.duration_s):
            end_s, before = flown.wire.time_s + parsed.duration_s, flown.wire.on_tick

            def on_tick():
                before()
                if flown.wire.time_s >= end_s:
                    undo()
                    flown.wire.on_tick = before

            flown.wire.on_tick = on_tick

    return happens


def hears(system_id, component_id, message) -> Callable[[Flown], None]:
    return lambda flown: flown.wire.inject(system_id, component_id, message)


def loses(*names, for_s=np.inf, then=None) -> Callable[[Flown], None]:
    """These messages do not come through any more."""

    def happens(flown):
        ids = [getattr(dialect, f"MAVLINK_MSG_ID_{name}") for name in names]
        flown.wire.muted = frozenset(ids)
        if then is not None:
            then(flown)
        end_s, before = flown.wire.time_s + for_s, flown.wire.on_tick

        def on_tick():
            before()
            if flown.wire.time_s >= end_s:
                flown.wire.muted = frozenset()

        flown.wire.on_tick = on_tick

    return happens


def stalls(for_s) -> Callable[[Flown], None]:
    return lambda flown: setattr(flown.wire, "stall_s", for_s)


def breaks(answers) -> Callable[[Flown], None]:
    return lambda flown: setattr(flown.actor, "bad_answers", answers)


def is_stopped(flown):
    flown.stopping = True


def dies(flown):
    flown.wire.killed = True


GO_TO = dialect.MAVLink_command_int_message(
    1, 1, 0, dialect.MAV_CMD_DO_REPOSITION, 0, 0, -1, 1, 0, 0, 473977420, 85455940, 500
)
STEER = dialect.MAVLink_set_position_target_global_int_message(
    1, 1, 1, 6, 3527, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0
)
PAUSE = dialect.MAVLink_command_long_message(
    1, 191, dialect.MAV_CMD_DO_PAUSE_CONTINUE, 0, 0, 0, 0, 0, 0, 0, 0
)
BOTH = ("px4", "ardupilot")


@dataclass(frozen=True)
class Row:
    """One safety event and what the companion has to make of it."""

    event: str
    happens: Callable[[Flown], None]
    end: str
    """Outcome and reason code; ``None`` where the program is no more."""
    exit_code: int | None
    within_s: float
    """Nothing moves the vehicle by our will after this; infinite where the flight goes on."""
    autopilots: tuple[str, ...] = BOTH
    says: str = ""
    radio: bool = False
    pursues: bool = False
    options: dict = field(default_factory=dict)


HB = 1.1
"""A change of mode shows in the next HEARTBEAT: a second, and a tick."""
ON = np.inf
ROWS = (
    Row("the pilot selects another mode", fault("kind=rc_takeover"),
        "stood_down mode_changed", 7, HB, radio=True),
    Row("the ground station selects hold", fault("kind=gcs_mode"),
        "stood_down mode_changed", 7, HB),
    Row("a go-to is sent to the vehicle", hears(255, 190, GO_TO),
        "stood_down foreign_setpoint", 7, 0.1),
    Row("a setpoint of somebody else is heard", hears(255, 190, STEER),
        "stood_down foreign_setpoint", 7, 0.1),
    Row("a second companion steers it", fault("kind=second_companion"),
        "stood_down foreign_setpoint", 7, 0.2),
    Row("setpoints do not reach the autopilot", fault("kind=setpoint_deaf"),
        "stood_down failsafe", 7, 1.0 + HB, ("px4",)),
    Row("the transmitter is lost", fault("kind=rc_loss"),
        "stood_down failsafe", 7, 1.0 + HB, ("px4",), radio=True),
    Row("its geofence is breached", fault("kind=geofence,radius=5"),
        "stood_down *", 7, HB, ("px4",)),
    Row("the autopilot reboots", fault("kind=reboot"),
        "stood_down *", 7, 3.0),
    Row("the operator pauses by MAVLink", hears(255, 190, PAUSE),
        "stood_down paused", 7, 0.1),
    Row("SIGINT or SIGTERM", is_stopped, "stopped signal", 130, 0.1),
    Row("the program is killed", dies, "", None, 0.1),
    Row("the program is stopped for 0.5 s", stalls(0.5), "arrived arrived", 0, ON),
    Row("the program is stopped for 3 s", stalls(3.0), "stood_down failsafe", 7, 0.1, ("px4",)),
    Row("the program is stopped for 4 s", stalls(4.0), "arrived arrived", 0, ON, ("ardupilot",)),
    Row("nothing is heard for 0.4 s", fault("kind=link_loss,for=0.4"), "arrived arrived", 0, ON,
        says="position_late"),
    Row("nothing is heard any more", fault("kind=link_loss"), "link_lost position_late", 4, 0.4),
    Row("positions stop, heartbeats do not", loses("LOCAL_POSITION_NED"),
        "link_lost position_late", 4, 0.4),
    Row("heartbeats stop, positions do not", loses("HEARTBEAT"), "link_lost link_silent", 4, 3.1),
    Row("the estimator is reset", fault("kind=ekf_reset,north=3"), "arrived arrived", 0, ON,
        ("px4",), says="frame_moved"),
    Row("the local origin moves", fault("kind=origin_move,north=4"), "arrived arrived", 0, ON,
        ("px4",), says="frame_moved"),
    Row("the origin moves and it is not told",
        loses("GPS_GLOBAL_ORIGIN", "ODOMETRY", for_s=3.0, then=fault("kind=origin_move,north=4")),
        "arrived arrived", 0, ON, ("px4",), says="frame_untied"),
    Row("the origin moves and it is never told",
        loses("GPS_GLOBAL_ORIGIN", "ODOMETRY", then=fault("kind=origin_move,north=4")),
        "position_lost frame_untied", 4, 1.0, ("px4",)),
    Row("GPS is lost for good", fault("kind=gps_loss"), "*", None, 8.0),
    Row("the battery is at 10 %", fault("kind=battery_low,level=0.1"), "*", None, 1.2),
    Row("the target falls silent", fault("kind=target_stale"),
        "target_lost target_silent", 4, 2.2, pursues=True),
    Row("the target repeats itself", fault("kind=target_freeze"),
        "target_lost target_silent", 4, 2.2, pursues=True),
    Row("the target is silent for 1.2 s", fault("kind=target_stale,for=1.2"),
        "arrived arrived", 0, ON, pursues=True),
    Row("the target jumps 40 m for 0.3 s", fault("kind=target_jump,for=0.3"),
        "arrived arrived", 0, ON, pursues=True),
    Row("one answer of the policy is NaN", breaks(1), "arrived arrived", 0, ON,
        says="policy_unusable"),
    Row("all answers of the policy are NaN", breaks(10**6), "failed policy_unusable", 8, 0.1),
)  # fmt: skip
CASES = [(row, autopilot) for row in ROWS for autopilot in row.autopilots]


def fly(row, autopilot, actor):
    return Flown(
        actor,
        happens=row.happens,
        autopilot=autopilot,
        radio=row.radio,
        targets=[WALKER] if row.pursues else (),
        source=TargetSource(system_id=42) if row.pursues else None,
        after_s=2.0 if row.pursues else AFTER_S,
    )


@pytest.fixture
def actor(constant_actor):
    return constant_actor((0.2, 0.0, 0.0))


def test_nothing_wrong(actor):
    flown = Flown(actor)
    flown.check_conduct()
    assert flown.end == ("arrived", 0)
    assert flown.summary.link_loss_percent == 0.0


@pytest.mark.parametrize(
    ("row", "autopilot"),
    [
        # One autopilot of each row at every change; the other where there is time for it.
        pytest.param(
            row,
            autopilot,
            id=f"{row.event}-{autopilot}",
            marks=() if autopilot == row.autopilots[0] else pytest.mark.slow,
        )
        for row, autopilot in CASES
    ],
)
def test_every_safety_event(actor, row, autopilot):
    """The reaction is the one of the table, in its time; the vehicle touches nothing."""
    flown = fly(row, autopilot, actor)
    assert flown.happened_s is not None, "nothing has happened"
    flown.check_conduct()
    if flown.summary is not None and row.end != "*":
        outcome, code = row.end.split()
        assert flown.summary.outcome == outcome, (flown.summary.reason, flown.events)
        assert code in ("*", flown.summary.reason_code), flown.events
        assert flown.summary.exit_code == row.exit_code
    assert flown.still_s() <= row.within_s
    if row.says:
        assert flown.told(f"[{row.says}]"), flown.events


@pytest.mark.parametrize(
    ("kind", "autopilot"),
    [("loss", "px4"), ("loss", "ardupilot"), ("duplicate", "px4"), ("corrupt", "px4")],
)
def test_a_bad_radio_is_flown_through(actor, kind, autopilot):
    flown = Flown(actor, faults=[f"t=6,kind={kind},percent=20"], autopilot=autopilot)
    flown.check_conduct()
    assert flown.end == ("arrived", 0), flown.summary.reason


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
@pytest.mark.parametrize("autopilot", BOTH)
def test_takeover_at_any_moment_on_the_wire(actor, autopilot):
    """Two hundred moments of a whole flight, each mode a pilot may choose."""
    rng = np.random.default_rng(7)
    modes = {"px4": ("posctl", "altctl", "loiter", "rtl", "land")}.get(autopilot, ("loiter", "rtl"))
    for _ in range(100):
        text = f"t={rng.uniform(0.0, 26.0):.2f},kind=rc_takeover,mode={rng.choice(modes)}"
        flown = Flown(actor, faults=[text], autopilot=autopilot, radio=True)
        flown.check_conduct()
        assert flown.end[1] in (0, 6, 7), (text, flown.summary)


# -- the table ---------------------------------------------------------------------------------


def line_of(row, autopilot, flown):
    """Return one line of the table of reactions, with the times measured in this flight."""
    if flown.summary is None:
        stood_s = flown.stood_s - flown.happened_s
        mode = flown.verdict["timeline"][-1][1]
        end = f"the autopilot stops it after {flown.coasted_m:.1f} m, {stood_s:.1f} s ({mode})"
        ended = "-"
    else:
        end = f"{flown.summary.outcome} [{flown.summary.reason_code}], exit {flown.end[1]}"
        ended = f"{flown.ended_s - flown.happened_s:.2f} s"
        if flown.end[1] == 0:
            holds = [text for text in flown.events if text.startswith("holding: ")]
            codes = sorted({text[text.index("[") :] for text in holds})
            end = f"holds {', '.join(codes) or 'nothing'}; flies on"
            ended = "-"
    still, silent = f"{flown.still_s():.2f} s", f"{flown.silent_s():.2f} s"
    if flown.summary is not None and flown.end[1] == 0:
        silent = "-"
        still = "-" if "nothing" in end else still
    return f"| {row.event} | {autopilot} | {end} | {still} | {silent} | {ended} |"


def main():
    """Fly every row with the bundled actor and print the table."""
    print("| event | vehicle | reaction | still after | silent after | run ends after |")
    print("|---|---|---|---|---|---|")
    for row, autopilot in CASES:
        print(line_of(row, autopilot, fly(row, autopilot, "paper-free")), flush=True)


if __name__ == "__main__":
    main()
