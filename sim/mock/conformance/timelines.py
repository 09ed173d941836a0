"""When things change and how often they are said: states, texts and rates."""

import math
from collections import Counter
from collections.abc import Callable
from typing import Any

from sim.mock.ardupilot.personality import ARDUPILOT
from sim.mock.conformance.recording import Recording
from sim.mock.conformance.replay import SAMPLED, Flown
from sim.mock.conformance.surroundings import Causes
from sim.mock.conformance.table import Row

TIMELINE_LIMIT_S = 0.2
RATE_LIMIT = 0.10
SETTLED_S = 2.0
"""Rates are counted from so long after the vehicle is ready."""
LANDING_LIMIT = 0.2
"""Moments that follow from how far it flew are compared as shares of the way there."""

NOT_SENT = frozenset(
    {
        "OPEN_DRONE_ID_LOCATION", "OPEN_DRONE_ID_SYSTEM", "COMMAND_LONG", "COMMAND_ACK",
        "PARAM_VALUE", "TERRAIN_REQUEST", "STATUSTEXT", "AUTOPILOT_VERSION", "GPS_GLOBAL_ORIGIN",
        "PING", "TIMESYNC",
    }
)  # fmt: skip
"""What is compared elsewhere, or is known to be left out: see the README of the mock."""
TEXT_EDGE_S = 2.0
NOT_TOLD = ("SIM ", "[logger]", "Preflight Fail")
"""Beginnings of texts of the simulator, not of the autopilot."""


def rows(recording: Recording, flown: Flown) -> list[Row]:
    """Return the comparison of all timelines."""
    found = _states(recording, flown)
    if recording.personality is ARDUPILOT:
        found.append(_shown_at_once(recording, flown))
    found += [_texts(recording, flown), _rates(recording, flown)]
    return [row for row in found if row is not None]


def _states(recording: Recording, flown: Flown) -> list[Row | None]:
    landed = {0: "undefined", 1: "on ground", 2: "in air", 3: "taking off", 4: "landing"}
    return [
        _agreement("mode, arming and state", "HEARTBEAT", recording, flown, _heartbeat_words),
        _agreement("landed state", "EXTENDED_SYS_STATE", recording, flown, landed.__getitem__),
        _agreement("estimator flags", "ESTIMATOR_STATUS", recording, flown, hex),
        _agreement("estimator flags", "EKF_STATUS_REPORT", recording, flown, hex),
    ]


def _agreement(
    what: str,
    name: str,
    recorded: Recording,
    flown: Flown,
    words: Callable[[Any], str],
) -> Row | None:
    """Compare every recorded report with what the mock would have said at about that moment.

    The deviation is by how much the mock is early or late: the time to the nearest moment at
    which it would have said the same. A report once a second is judged as exactly as this. What
    follows from a way flown, like a landing, may be off by a share of the time that it took.
    """
    causes = Causes.of(recorded)
    key = SAMPLED[name]
    theirs = recorded.of(name)
    sampled = flown.sampled[name]
    if not theirs or not sampled:
        return None
    ends = [t for t, _ in sampled[1:]] + [math.inf]
    spans = [(start, end, value) for (start, value), end in zip(sampled, ends, strict=True)]
    worst_s, limit_s, where = 0.0, TIMELINE_LIMIT_S, ""
    for t, message in theirs:
        wanted = key(message)
        off_s = min(
            (max(0.0, start - t, t - end) for start, end, value in spans if value == wanted),
            default=math.inf,
        )
        allowed_s = max(TIMELINE_LIMIT_S, LANDING_LIMIT * causes.since(t))
        if off_s / allowed_s > worst_s / limit_s:
            ours = next(
                value for start, end, value in reversed(spans) if start <= t or start == spans[0][0]
            )
            worst_s, limit_s = off_s, allowed_s
            where = f"{t:.1f} s: {words(wanted)}, mock {words(ours)}"
    changes = _changes([(t, key(m)) for t, m in theirs]), _changes(sampled)
    return Row(
        what, f"{len(changes[0])} states", f"{len(changes[1])} states",
        worst_s, limit_s, "s", where,
    )  # fmt: skip


def _shown_at_once(recording: Recording, flown: Flown) -> Row:
    """Compare when HEARTBEATs that show a new mode are sent: ArduPilot does not wait."""
    theirs, ours = (
        _changes([(t, m.custom_mode) for t, m in side if t >= recording.start_s + 2.0])[1:]
        for side in (recording.of("HEARTBEAT"), flown.of("HEARTBEAT"))
    )
    same = [mode for _, mode in theirs] == [mode for _, mode in ours]
    offs = (
        [abs(a - b) for (a, _), (b, _) in zip(theirs, ours, strict=False)] if same else [math.inf]
    )
    return Row(
        "HEARTBEAT of a new mode", f"{len(theirs)} modes", f"{len(ours)} modes",
        max(offs, default=0.0), TIMELINE_LIMIT_S, "s",
    )  # fmt: skip


def _texts(recording: Recording, flown: Flown) -> Row | None:
    """Compare what is said, in order, from the first to the last recorded text.

    IMU0 and IMU1 may speak in either order.
    """
    said = recording.of("STATUSTEXT")
    if not said:
        return None
    start_s, end_s = said[0][0] - TEXT_EDGE_S, recording.end_s
    theirs, ours = (
        [
            text
            for text in _joined([(t, m) for t, m in side if start_s <= t <= end_s])
            if not text.startswith(NOT_TOLD)
        ]
        for side in (said, flown.of("STATUSTEXT"))
    )
    if not theirs and not ours:
        return None
    missing, extra = Counter(theirs) - Counter(ours), Counter(ours) - Counter(theirs)
    where = "; ".join([f"not said: {t}" for t in missing] + [f"only the mock: {t}" for t in extra])
    wrong = sum(missing.values()) + sum(extra.values())
    if not wrong and theirs != ours:
        wrong, where = 1, "another order"
    return Row("texts", str(len(theirs)), str(len(ours)), wrong, 0, "texts", where)


def _rates(recording: Recording, flown: Flown) -> Row:
    """Compare how often each message came, once the vehicle was ready."""
    start_s, end_s = max(recording.boot_s, recording.start_s) + SETTLED_S, recording.end_s
    duration_s = max(end_s - start_s, 1e-3)
    worst, where, compared = 0.0, "", 0
    for name, messages in recording.messages.items():
        if name in NOT_SENT:
            continue
        theirs, ours = (
            sum(start_s < t <= end_s for t, _ in side) for side in (messages, flown.of(name))
        )
        compared += 1
        # Two messages more or less are a matter of phase.
        share = max(0.0, abs(ours - theirs) - 2.0) / max(theirs, 1)
        if share > worst:
            worst = share
            where = f"{name} {theirs / duration_s:.2f} Hz, mock {ours / duration_s:.2f} Hz"
    return Row(
        "message rates", f"{compared} messages", f"{duration_s:.0f} s",
        100.0 * worst, 100.0 * RATE_LIMIT, "%", where,
    )  # fmt: skip


def _joined(texts: list[tuple[float, Any]]) -> list[str]:
    joined: list[str] = []
    for _, message in texts:
        if message.chunk_seq > 0 and joined:
            joined[-1] += message.text
        else:
            joined.append(message.text)
    return [text.rstrip("\t").replace("IMU1", "IMU0") for text in joined]


def _changes(reports: list[tuple[float, Any]]) -> list[tuple[float, Any]]:
    changes: list[tuple[float, Any]] = []
    for t, value in reports:
        if not changes or changes[-1][1] != value:
            changes.append((t, value))
    return changes


def _heartbeat_words(state: tuple[int, int, int]) -> str:
    base_mode, custom_mode, status = state
    return f"{base_mode:#x}/{custom_mode:#x}/{status}"
