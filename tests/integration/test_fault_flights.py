"""The table of safety events: what the companion makes of each, and how long it takes.

One row of ``ROWS`` for every event, flown in front of the mock vehicle (``flown``); run this file
as a program to print them as a table with the measured times::

    PYTHONPATH=. python tests/integration/test_fault_flights.py 2>/dev/null
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.positions import TargetSource
from tests.integration.flown import (
    AFTER_S,
    BOTH,
    WALKER,
    Flown,
    breaks,
    changes,
    dies,
    fault,
    hears,
    is_stopped,
    loses,
    stalls,
)

GO_TO = dialect.MAVLink_command_int_message(
    1, 1, 0, dialect.MAV_CMD_DO_REPOSITION, 0, 0, -1, 1, 0, 0, 473977420, 85455940, 500
)
STEER = dialect.MAVLink_set_position_target_global_int_message(
    1, 1, 1, 6, 3527, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0
)
PAUSE = dialect.MAVLink_command_long_message(
    1, 191, dialect.MAV_CMD_DO_PAUSE_CONTINUE, 0, 0, 0, 0, 0, 0, 0, 0
)


FROZEN = dict.fromkeys(("x", "y", "z", "vx", "vy", "vz"))
AT_REST = dict.fromkeys(("vx", "vy", "vz"), 0.0)
ELSEWHERE = dialect.MAVLink_local_position_ned_message(5000, 40.0, 40.0, -40.0, 0.0, 0.0, 0.0)


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
    Row("positions become NaN", changes("LOCAL_POSITION_NED", x=np.nan),
        "link_lost position_late", 4, 0.4),
    Row("velocities become infinite", changes("LOCAL_POSITION_NED", vy=np.inf),
        "link_lost position_late", 4, 0.4),
    Row("the position freezes, its times go on", changes("LOCAL_POSITION_NED", **FROZEN),
        "position_lost position_frozen", 4, 0.8),
    Row("it freezes and says it stands", changes("LOCAL_POSITION_NED", **FROZEN | AT_REST),
        "position_lost position_frozen", 4, 1.3),
    Row("the position jumps far outside the map", changes("LOCAL_POSITION_NED", x=-900.0),
        "position_lost *", 4, 0.5),
    Row("another vehicle sends positions", hears(7, 1, ELSEWHERE), "arrived arrived", 0, ON),
    Row("another component of ours sends positions", hears(1, 200, ELSEWHERE),
        "arrived arrived", 0, ON),
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
    Row("the target is far outside the map", fault("kind=target_jump,east=400"),
        "target_lost target_outside", 4, 1.2, pursues=True),
    Row("the target is at (0, 0)", changes("GLOBAL_POSITION_INT", lat=0, lon=0),
        "target_lost target_silent", 4, 2.2, pursues=True),
    Row("the target repeats itself", fault("kind=target_freeze"),
        "target_lost target_silent", 4, 2.2, pursues=True),
    Row("the target is silent for 1.2 s", fault("kind=target_stale,for=1.2"),
        "arrived arrived", 0, ON, pursues=True),
    Row("the target jumps 40 m for 0.3 s", fault("kind=target_jump,for=0.3"),
        "arrived arrived", 0, ON, pursues=True),
    Row("the policy answers NaN for a moment", breaks(2), "arrived arrived", 0, ON,
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
