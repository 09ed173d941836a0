"""The loop: wait, look, decide, send, record. One policy step, one frame; nothing is re-sent.

The same loop flies a real autopilot, the mock vehicle on a socket and ``sim.vehicle``. It holds
no thread and reads no clock: time is the vehicle's. When the loop stops, the stream stops.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from companion.announcing import Announcer
from companion.arrays import FloatArray
from companion.commands import Commands
from companion.guarding import Guard
from companion.guidance.guidance import Proposal
from companion.guidance.limits import ARRIVAL_RADIUS_M
from companion.guidance.reasons import Reason
from companion.guidance.shield import Shield, ShieldDecision
from companion.guidance.situation import Directive, Outcome, Phase, Plan, Situation, Stream
from companion.guidance.supervisor import Supervisor
from companion.guidance.target import TargetEstimate, TargetTier
from companion.policy.actor import Actor
from companion.positions import Pose, Positions, TargetSource
from companion.preflight import refusal, waiting_for
from companion.proposing import Proposer
from companion.recording import tick_record
from companion.session.records import Record
from companion.session.summary import Summary
from companion.tally import Tally
from companion.vehicle import (
    EventKind,
    FlightMode,
    RequestKind,
    Severity,
    Vehicle,
    VehicleEvent,
    VehicleState,
)
from companion.watching import Watch
from companion.world.maps import Map

HEARTBEAT_PERIOD_S = 1.0
MOVING_TARGET_MPS = 0.2
ABANDON_S = 2.0
ON_TIME_S = 0.005
"""A tick no later than this decides for the moment it was due."""
RATES_PERIOD_S = 1.0
_ZERO = np.zeros(3)


@dataclass(frozen=True, slots=True)
class Mission:
    """What is to be flown."""

    map: Map
    actor: Actor
    plan: Plan
    target: TargetSource
    v_max_mps: float
    rate_hz: float


class Flight:
    """One run of the loop over one vehicle."""

    def __init__(
        self,
        vehicle: Vehicle,
        mission: Mission,
        shield: Shield,
        *,
        record: Callable[[Record], None],
        stop_requested: Callable[[], bool],
        session_start_s: float | None = None,
        alive: Callable[[str], None] | None = None,
        think_ahead_s: float = 0.0,
    ) -> None:
        """Prepare a flight; nothing is sent before ``run``.

        Args:
            vehicle: The backend, already found.
            mission: What is to be flown.
            shield: Stands between the policy and the wire.
            record: Takes a copy of everything; must never block.
            stop_requested: Asked once a tick; ``True`` ends the flight in an orderly way.
            session_start_s: Zero of the recorded times; now, if not given.
            alive: Told the phase at the end of every tick, for a watchdog; must never block.
            think_ahead_s: So long before a tick policy and shield are asked about the position
                that is there by then; the tick asks again only if a newer one has come. Changes
                nothing but the latency.
        """
        self._vehicle, self._mission, self._shield = vehicle, mission, shield
        self._guard = Guard(shield)
        self._record, self._stop_requested, self._alive = record, stop_requested, alive
        self._think_ahead_s = think_ahead_s
        self._start_s = vehicle.now_s()
        self._session_start_s = self._start_s if session_start_s is None else session_start_s
        self._positions = Positions(
            mission.map, mission.target, earth_radius_m=vehicle.info.earth_radius_m
        )
        self._proposer = Proposer(mission.map, mission.actor, mission.v_max_mps)
        self._watch = Watch(
            shield, mission.actor.contract, mission.v_max_mps, start_s=self._start_s
        )
        self._supervisor = Supervisor(mission.plan, now_s=self._start_s)
        self._tally = Tally(mission.map, record, start_s=self._start_s, rate_hz=mission.rate_hz)
        self._policy_failures = 0
        self._heartbeat_due_s = self._start_s
        self._rates_due_s = self._start_s
        self._announcer = Announcer(
            vehicle, record, start_s=self._session_start_s, silent=mission.plan.shadow
        )
        self._commands = Commands(
            mission.map,
            self._positions,
            target_given=mission.target.given,
            margin_m=shield.limits.margin_m,
        )
        vehicle.judge_commands(self._commands.judge)

    def run(self) -> Summary:
        """Fly until the supervisor says it is over; return what happened."""
        period_s = 1.0 / self._mission.rate_hz
        tick = 0
        while True:
            deadline_s = self._start_s + tick * period_s
            if self._think_ahead_s > 0.0:
                self._vehicle.wait_until(deadline_s - self._think_ahead_s)
                self._think_ahead(deadline_s)
            self._vehicle.wait_until(deadline_s)
            directive = self._step(deadline_s)
            if directive.outcome is not None:
                return self.finish(directive.outcome, directive.code, directive.reason)
            # Absolute deadlines: a late tick is counted and skipped, never made up for.
            due = math.ceil((self._vehicle.now_s() - self._start_s) / period_s - 1e-6)
            self._tally.metrics.late_ticks += max(0, due - tick - 1)
            tick = max(tick + 1, due)

    def abandon(self) -> None:
        """Ask the vehicle to hold after an error of our own, streaming zero until it does."""
        phases = (Phase.ENGAGED, Phase.HOLDING, Phase.HANDING_OVER)
        state = self._vehicle.state()
        if self._mission.plan.shadow or self._supervisor.phase not in phases:
            return
        if state is None or state.mode is not FlightMode.EXTERNAL:
            return
        self._vehicle.request(RequestKind.HOLD)
        give_up_s = self._vehicle.now_s() + ABANDON_S
        while self._vehicle.now_s() < give_up_s:
            state = self._vehicle.state()
            if state is None or state.mode is not FlightMode.EXTERNAL:
                return
            self._vehicle.send_velocity(_ZERO)
            self._vehicle.wait_until(self._vehicle.now_s() + 1.0 / self._mission.rate_hz)

    def _step(self, deadline_s: float) -> Directive:
        now_s = self._vehicle.now_s()
        state, events = self._vehicle.state(), list(self._vehicle.take_events())
        due_s = deadline_s if now_s - deadline_s < ON_TIME_S else now_s
        pose, target = self._look(state, due_s)
        proposal = self._proposer.propose(pose, target)
        if proposal is not None:
            usable = all(map(math.isfinite, proposal.velocity_enu_mps.tolist()))
            self._policy_failures = 0 if usable else self._policy_failures + 1
        situation = self._situation(now_s, state, pose, target, events)

        directive = self._supervisor.update(situation)
        if directive.request is not None:
            self._vehicle.request(directive.request, altitude_m=self._mission.plan.takeoff_m)
        self._watch.before_sending(state, pose)
        decision = self._shielded(directive, pose, proposal)
        sent = self._send(directive, decision)
        self._watch.sent(sent)
        sent_s = self._vehicle.now_s()
        if now_s >= self._heartbeat_due_s:
            self._vehicle.send_heartbeat(directive.health)
            self._heartbeat_due_s = max(self._heartbeat_due_s + HEARTBEAT_PERIOD_S, now_s)

        latency_ms = None
        if sent is not None:
            # Reaction time: from the moment the position was there and the tick was due.
            asked_s = deadline_s if state is None else max(deadline_s, state.time_s)
            latency_ms = 1e3 * (sent_s - asked_s)
            self._tally.metrics.sent(sent_s, latency_ms)
        else:
            self._tally.metrics.withheld()
        self._tally.tick(directive, situation, pose, decision, self._watch.envelope)
        self._announcer.events(events)
        self._announcer.phase(directive, now_s)
        self._record(
            tick_record(
                start_s=self._session_start_s,
                situation=situation,
                directive=directive,
                pose=pose,
                target=target,
                proposal=proposal,
                decision=decision,
                sent_enu_mps=sent,
                latency_ms=latency_ms,
                lateness_ms=1e3 * (now_s - deadline_s),
                rates_hz=self._rates_hz(now_s),
                speed_cap_mps=self._watch.envelope.cap_mps,
                drift=self._watch.drift,
            )
        )
        flown = proposal if directive.stream is Stream.POLICY else None
        for text, severity in self._watch.after_sending(sent_s, state, pose, flown):
            self._announcer.log(text, severity, now_s)
            if severity <= Severity.WARNING:
                self._announcer.send(text, severity)
        if self._alive is not None:
            self._alive(directive.phase)
        self._proposer.look_ahead(pose, target)
        return directive

    def _think_ahead(self, deadline_s: float) -> None:
        """Ask policy and shield what they will most likely be asked again at ``deadline_s``."""
        state = self._vehicle.state()
        pose, target = self._look(state, deadline_s)
        proposal = self._proposer.propose(pose, target)
        if self._supervisor.phase is Phase.ENGAGED and pose is not None and proposal is not None:
            wanted_enu_mps = self._watch.envelope.limited(proposal.velocity_enu_mps)
            self._guard.check(wanted_enu_mps, pose, self._watch.expected_drift(state, pose))

    def _look(
        self, state: VehicleState | None, time_s: float
    ) -> tuple[Pose | None, TargetEstimate]:
        """Return where the vehicle was last seen, and the target as it stands at ``time_s``."""
        pose = self._positions.update(state, self._vehicle.targets())
        return pose, self._positions.target(time_s)

    def _situation(
        self,
        now_s: float,
        state: VehicleState | None,
        pose: Pose | None,
        target: TargetEstimate,
        events: list[VehicleEvent],
    ) -> Situation:
        mission, known = self._mission, target.position_enu_m
        distance_m = None
        if pose is not None and known is not None:
            offset_m = known - pose.position_enu_m
            distance_m = math.sqrt(float(offset_m @ offset_m))
        trusted = target.tier in (TargetTier.FRESH, TargetTier.COAST)
        foreign = [event.text for event in events if event.kind is EventKind.FOREIGN_SETPOINT]
        return Situation(
            now_s=now_s,
            vehicle=state,
            request=self._vehicle.request_status(),
            target=target.tier,
            target_age_s=0.0 if known is None else target.age_s,
            target_moving=_speed_mps(target.velocity_enu_mps) > MOVING_TARGET_MPS,
            target_off_map_m=0.0 if known is None else mission.map.outside_m(known),
            distance_m=distance_m,
            arrived=trusted and distance_m is not None and distance_m < ARRIVAL_RADIUS_M,
            height_m=0.0 if pose is None else pose.height_m,
            waiting_for=waiting_for(mission.map, state, pose, mission.target, target),
            refusal=refusal(
                mission.map,
                pose,
                target,
                takeoff_m=mission.plan.takeoff_m,
                margin_m=self._shield.limits.margin_m,
            )
            if self._supervisor.phase is Phase.PREFLIGHT
            else "",
            foreign_setpoint=foreign[-1] if foreign else "",
            rebooted=any(event.kind is EventKind.REBOOT for event in events),
            frame_moved=self._positions.take_frame_moved(),
            position_frozen=self._watch.is_frozen(state),
            off_map_m=0.0 if pose is None else mission.map.outside_m(pose.position_enu_m),
            policy_failures=self._policy_failures,
            frame_untied=self._positions.untied,
            stop_requested=self._stop_requested(),
            paused_by=self._commands.paused_by,
            target_changed=self._commands.take_target_changed(),
        )

    def _shielded(
        self, directive: Directive, pose: Pose | None, proposal: Proposal | None
    ) -> ShieldDecision | None:
        """Return what the shield makes of the proposal, or of a hold; ``None`` if not asked."""
        if pose is None:
            return None
        if directive.stream is Stream.POLICY and proposal is not None:
            wanted_enu_mps = self._watch.envelope.limited(proposal.velocity_enu_mps)
        elif directive.stream is Stream.HOLD:
            wanted_enu_mps = _ZERO
        else:
            return None
        return self._guard.check(wanted_enu_mps, pose, self._watch.drift)

    def _send(self, directive: Directive, decision: ShieldDecision | None) -> FloatArray | None:
        """Send at most one setpoint; return its velocity on the map, ``None`` if none left."""
        tie = self._positions.tie
        if directive.stream is Stream.NOTHING or self._mission.plan.shadow:
            return None
        if decision is None or tie is None:
            self._vehicle.send_velocity(_ZERO)
            return _ZERO
        self._vehicle.send_velocity(tie.velocity_to_local(decision.velocity_enu_mps))
        return decision.velocity_enu_mps

    def _rates_hz(self, now_s: float) -> Mapping[str, float] | None:
        """Return the measured rates of the link, once a second."""
        if now_s < self._rates_due_s:
            return None
        self._rates_due_s = now_s + RATES_PERIOD_S
        return self._vehicle.stats().rates_hz or None

    def finish(self, outcome: Outcome, code: Reason, reason: str) -> Summary:
        """Return the summary of what was flown so far."""
        return self._tally.summary(
            outcome, code, reason, now_s=self._vehicle.now_s(), stats=self._vehicle.stats()
        )


def _speed_mps(velocity_mps: FloatArray) -> float:
    return math.sqrt(float(velocity_mps @ velocity_mps))
