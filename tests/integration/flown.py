"""Whole flights of the companion in front of a mock vehicle, on a virtual clock.

Real MAVLink bytes both ways, no sockets: the real loop and link in front of the real mock, whose
verdict counts. And what may happen on the way, for tests to choose from.
"""

from collections.abc import Callable

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.control import Flight, Mission
from companion.guidance.shield import Shield
from companion.guidance.shield_limits import ShieldLimits
from companion.guidance.situation import Plan
from companion.launch import THINK_AHEAD_S
from companion.link.messages import velocity_of
from companion.link.opening import attach
from companion.policy.actor import Actor
from companion.positions import TargetSource
from companion.session.records import Event, Tick
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
BOTH = ("px4", "ardupilot")
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
        self._changes = None
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
        if self._changes is not None:
            passed = [self._changed(frame) for frame in passed]
        for frame in passed:
            if message_id(frame) == dialect.MAVLINK_MSG_ID_HEARTBEAT and frame[5:7] == b"\1\1":
                self._look_at(frame)
        return [("mock", frame) for frame in passed]

    def change(self, changes):
        """Let ``changes(message)`` alter every message from now on."""
        self._changes = changes

    def _changed(self, frame):
        try:
            message = dialect.MAVLink(None).decode(bytearray(frame))
        except dialect.MAVError:
            return frame
        if isinstance(message, dialect.MAVLink_unknown):
            return frame
        self._changes(message)
        sender = dialect.MAVLink(None, message.get_srcSystem(), message.get_srcComponent())
        sender.seq = message.get_seq()
        return message.pack(sender)

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
            think_ahead_s=THINK_AHEAD_S,
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


def changes(name, **values) -> Callable[[Flown], None]:
    """Let fields of a message be other ones; ``None`` freezes what they were at first."""

    def happens(flown):
        kept = {}

        def change(message):
            if message.get_type() != name:
                return
            for key, value in values.items():
                if value is None:
                    value = kept.setdefault(key, getattr(message, key))
                setattr(message, key, value)

        flown.wire.change(change)

    return happens
