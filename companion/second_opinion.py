"""How another actor would have decided in every situation of a recorded flight.

The vehicle's path stays that of the flight: each tick is one situation, and the other actor and
the shield are asked what they would make of it. Where that would have led is for a simulation.
"""

import math
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import SupportsFloat

import msgspec
import numpy as np

from companion import clock
from companion.guidance.drift import Drift
from companion.guidance.guidance import propose
from companion.guidance.guide import Guide
from companion.guidance.situation import Phase
from companion.launch import flight_shield
from companion.policy.actor import Actor
from companion.recording import actor_record
from companion.replay import RecordedSession
from companion.session.folder import create_session_folder, write_config, write_summary
from companion.session.records import Record, SessionEnd, SessionStart, Tick
from companion.session.summary import Summary

_MUCH_MPS = 0.5


class SecondOpinion(msgspec.Struct, frozen=True, kw_only=True):
    """How the other actor compares, over the ticks in which the policy flew."""

    actor: str
    session_dir: str
    ticks: int
    much_different_ticks: int
    """The velocity after the shield differs by more than 0.5 m/s."""
    mean_difference_mps: float | None
    largest_difference_mps: float | None
    interventions_then: int
    interventions_now: int
    """Of the shield."""


class Opinion:
    """Turns the ticks of a replay into those of the other actor."""

    def __init__(self, session: RecordedSession, actor: Actor) -> None:
        """Refuse what does not fit.

        Raises:
            ActorError: If the actor does not fit map or speed of the flight.
        """
        self._v_max_mps = session.inputs.start.v_max_mps
        actor.check_fits(session.map, self._v_max_mps)
        self._map, self._actor = session.map, actor
        self._guide = Guide(session.map, actor.contract.layout)
        self._shield = flight_shield(session.config, session.map, self._v_max_mps)
        self.differences_mps: list[float] = []
        self.interventions_then = 0
        self.reasons_now: Counter[str] = Counter()

    def tick(self, tick: Tick) -> Tick:
        """Return the tick as it would have been."""
        if tick.proposed_enu_mps is None:
            return tick
        position, velocity = np.array(tick.position_enu_m), np.array(tick.velocity_enu_mps)
        target = np.array(tick.target_enu_m)
        proposal = propose(
            self._actor,
            self._map,
            position_enu_m=position,
            velocity_enu_mps=velocity,
            target_enu_m=target,
            v_max_mps=self._v_max_mps,
            ahead=self._guide.ahead(position, target),
        )
        self._guide.work(position, target)
        now = msgspec.structs.replace(
            tick,
            observation=_list(proposal.observation),
            action=_list(proposal.action),
            spherical=list(proposal.spherical),
            proposed_enu_mps=_list(proposal.velocity_enu_mps),
        )
        if tick.clearance_m is None or tick.supervisor != Phase.ENGAGED:  # the policy did not fly
            return now
        drift_mps = np.zeros(3) if tick.drift_enu_mps is None else np.array(tick.drift_enu_mps)
        decision = self._shield.check(
            proposal.velocity_enu_mps,
            position_enu_m=position,
            velocity_now_enu_mps=velocity,
            drift=Drift(drift_mps, tick.gust_mps),
        )
        self.interventions_then += tick.intervened
        if decision.intervened:
            self.reasons_now[decision.reason.value] += 1
        if tick.safe_enu_mps is not None:
            self.differences_mps.append(math.dist(decision.velocity_enu_mps, tick.safe_enu_mps))
        return msgspec.structs.replace(
            now,
            safe_enu_mps=None if tick.safe_enu_mps is None else _list(decision.velocity_enu_mps),
            clearance_m=decision.clearance_m,
            shield_reason=decision.reason,
            intervened=decision.intervened,
        )


def second_opinion(session: RecordedSession, actor: Actor, parent: Path) -> SecondOpinion:
    """Replay a session with another actor in mind and write a session folder of it.

    Raises:
        ActorError: If the actor does not fit map or speed of the flight.
        CompanionError: If the session cannot be replayed, or the folder cannot be written.
    """
    opinion = Opinion(session, actor)
    records: list[Record] = []

    def take(record: Record) -> None:
        records.append(opinion.tick(record) if isinstance(record, Tick) else record)

    session.replay(take)
    folder = create_session_folder(parent, clock.utc_now())
    flown = session.inputs.summary or Summary(outcome="cut_off", reason="", exit_code=0)
    summary = msgspec.structs.replace(
        flown,
        outcome="replayed",
        reason=f"what {actor.name} would have decided on the way that "
        f"{session.actor.name} flew in {session.folder.name}",
        exit_code=0,
        session_dir=str(folder),
        shield_interventions=opinion.reasons_now.total(),
        shield_reasons=dict(opinion.reasons_now.most_common()),
    )
    start = msgspec.structs.replace(
        session.inputs.start,
        session_id=folder.name,
        actor=actor_record(actor),
        config={**session.inputs.start.config, "actor": actor.name},
    )
    write_config(folder, start.config)
    _write_recording(folder, start, records, summary)
    write_summary(folder, summary)
    differences = np.array(opinion.differences_mps)
    return SecondOpinion(
        actor=actor.name,
        session_dir=str(folder),
        ticks=len(differences),
        much_different_ticks=int((differences > _MUCH_MPS).sum()),
        mean_difference_mps=float(differences.mean()) if len(differences) else None,
        largest_difference_mps=float(differences.max()) if len(differences) else None,
        interventions_then=opinion.interventions_then,
        interventions_now=opinion.reasons_now.total(),
    )


def words(opinion: SecondOpinion) -> str:
    """Return the comparison for people."""
    if not opinion.ticks:
        return f"{opinion.actor}: the policy never flew; see {opinion.session_dir}"
    return (
        f"{opinion.actor} in the same {opinion.ticks} situations: the velocity sent differs by "
        f"{opinion.mean_difference_mps:.2f} m/s on average, {opinion.largest_difference_mps:.2f} "
        f"m/s at most, by more than {_MUCH_MPS} m/s in {opinion.much_different_ticks};\n"
        f"  the shield would step in {opinion.interventions_now} times instead of "
        f"{opinion.interventions_then}\n"
        f"  see it: companion review {opinion.session_dir}"
    )


def _write_recording(
    folder: Path, start: SessionStart, records: list[Record], summary: Summary
) -> None:
    from companion.session.streams import file_output

    output = file_output(folder, footer=True)
    output.write(start)
    for record in records:
        output.write(record)
    output.write(SessionEnd(summary))
    output.close()


def _list(values: Iterable[SupportsFloat]) -> list[float]:
    return [float(value) for value in values]
