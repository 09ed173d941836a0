"""What was asked and what was answered."""

import math
from typing import Any

from sim.mock.conformance.recording import Recording
from sim.mock.conformance.replay import Flown
from sim.mock.conformance.table import Row

ANSWER_LIMIT_S = 0.2
CLIENTS_ONLY = 0
"""COMMAND_ACK for system 0 is one of the autopilot's own parts to another."""


def rows(recording: Recording, flown: Flown) -> list[Row]:
    """Return the comparison of all answers."""
    return [row for row in (_acks(recording, flown), _parameters(recording, flown)) if row]


def _acks(recording: Recording, flown: Flown) -> Row | None:
    theirs, ours = (_answers(side.of("COMMAND_ACK")) for side in (recording, flown))
    if not theirs and not ours:
        return None
    where, worst_s = "", 0.0
    for index in range(max(len(theirs), len(ours))):
        their = theirs[index] if index < len(theirs) else None
        our = ours[index] if index < len(ours) else None
        if their is None or our is None or their[1:] != our[1:]:
            worst_s = math.inf
            where = f"{_words(their)}, mock {_words(our)}"
            break
        if abs(their[0] - our[0]) > worst_s:
            worst_s, where = abs(their[0] - our[0]), _words(their)
    return Row(
        "answers to commands", f"{len(theirs)} ACKs", f"{len(ours)} ACKs",
        worst_s, ANSWER_LIMIT_S, "s", where,
    )  # fmt: skip


def _answers(acks: list[tuple[float, Any]]) -> list[tuple[float, int, int, int, int]]:
    return [
        (t, m.command, m.result, m.target_system, m.target_component)
        for t, m in acks
        if m.target_system != CLIENTS_ONLY
    ]


def _words(answer: tuple[float, int, int, int, int] | None) -> str:
    if answer is None:
        return "no answer"
    t, command, result, system, component = answer
    return f"{t:.1f} s: {command} -> {result} for {system}/{component}"


def _parameters(recording: Recording, flown: Flown) -> Row | None:
    """Compare the parameters that were read: those known to the mock, and their defaults."""
    theirs, ours = (
        {m.param_id: m.param_type for _, m in side.of("PARAM_VALUE")} for side in (recording, flown)
    )
    asked = [name for name in theirs if name in ours]
    if not asked:
        return None
    wrong = [name for name in asked if theirs[name] != ours[name]] + flown.parameters_differ
    return Row(
        "parameters read", f"{len(asked)} known", f"{len(flown.parameters_differ)} adopted",
        len(wrong), 0, "wrong", " ".join(wrong[:6]),
    )  # fmt: skip
