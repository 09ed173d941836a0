"""Logs of flights with one fault each, made of real MAVLink bytes: does the review name it?"""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.review.log_flight import log_flight
from companion.review.log_story import read_story
from companion.review.words import report
from companion.vehicle import Severity
from sim.mock.fault_kinds import KINDS

OFFBOARD, RTL, POSCTL = 0x60000, 0x05040000, 0x30000
GOOD_FLAGS = 0x37F
RADIO = dialect.MAV_SYS_STATUS_SENSOR_RC_RECEIVER


def sys_status(enabled, healthy):
    return dialect.MAVLink_sys_status_message(enabled, enabled, healthy, 0, 15000, 0, 80, *[0] * 6)


def ask_to_arm(log, t, *, answer_s):
    ask = dialect.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
    if t == 5.0:
        log.add(t + 0.03, ask, 1, 191)
    if answer_s is not None and t == 5.0 + answer_s:
        log.add(t + 0.03, dialect.MAVLink_command_ack_message(400, 0, 0, 0, 1, 191))


def target(log, t, north):
    """System 42, so many units of 1e-5 degrees north."""
    at = dialect.MAVLink_global_position_int_message(
        0, 473977420 + round(100 * north), 85455940, 0, 0, 100, 0, 0, 0
    )
    log.add(t + 0.03, at, 42)


def found(story):
    return "\n".join(event.text for event in story.events if event.severity <= Severity.WARNING)


def test_a_flight_without_fault_has_nothing_that_stands_out(flight_log):
    flight_log.fly()
    story = read_story(flight_log.write())
    assert found(story) == ""
    assert dict(story.story.facts)["Setpoints"].startswith("200 at 10.0 Hz, from 1/191")


FAULTS = {
    "the stream stops": (
        {
            "sends": lambda t: t < 10,
            "mode": lambda t: OFFBOARD if t < 11 else RTL,
            "status": lambda t: 4 if t < 11 else 5,
        },
        "OFFBOARD -> AUTO.RTL: a FAILSAFE of the autopilot, 1.1 s after the last setpoint",
    ),
    "setpoints are lost on the way": (
        {
            "mode": lambda t: OFFBOARD if t < 11 else RTL,
            "status": lambda t: 4 if t < 11 else 5,
        },
        "although setpoints were SENT all the time",
    ),
    "PX4 takes OFFBOARD back": (
        {
            "sends": lambda t: t < 8 or t >= 14,
            "mode": lambda t: OFFBOARD if t < 9 or t >= 15 else RTL,
            "status": lambda t: 5 if 9 <= t < 15 else 4,
        },
        "AUTO.RTL -> OFFBOARD: BY ITSELF: setpoints flow again",
    ),
    "the pilot takes over": (
        {"mode": lambda t: OFFBOARD if t < 10 else POSCTL},
        "OFFBOARD -> POSCTL: nobody on this link asked: the pilot, someone else, or the autopilot",
    ),
    "a gap": ({"sends": lambda t: not 10 <= t < 11}, "no setpoint of 1/191 for 1.10 s"),
    "GPS": ({"fix": lambda t: 3 if t < 10 else 1}, "GPS LOST its fix"),
    "glitch": (
        {"flags": lambda t: GOOD_FLAGS if t < 10 else GOOD_FLAGS | 1024},
        "a GPS GLITCH",
    ),
    "estimator": (
        {"flags": lambda t: GOOD_FLAGS if t < 10 else 0x25},
        "NO LONGER vouches for the position (flags 0x25)",
    ),
    "a jump": (
        {"north": lambda t: 2.0 * t + (0.0 if t < 10 else 4.0)},
        "the position JUMPED by 4.0 m (+0.0 east, +4.0 north, +0.0 up)",
    ),
    "silence": ({"speaks": lambda t: not 10 <= t < 14}, "NOTHING was heard of the vehicle for 4."),
    "a rival": (
        {"extra": lambda log, t: log.setpoint(t + 0.05, 192) if t > 10 else None},
        "SEVERAL send setpoints at once: 1/191 and 1/192",
    ),
    "lost packets": (
        {"extra": lambda log, t: log.lose(1) if t % 1 == 0.5 else None},
        "of the vehicle's packets were LOST",
    ),
    "reset": (
        {
            "extra": lambda log, t: log.add(
                t + 0.03,
                dialect.MAVLink_odometry_message(
                    0, 1, 1, 0, 0, 0, [1, 0, 0, 0], *[0] * 6, [0] * 21, [0] * 21, int(t > 10)
                ),
            )
        },
        "the estimator RESET itself (counter 0 -> 1)",
    ),
    "reboot": (
        {
            "extra": lambda log, t: log.add(
                t + 0.03, dialect.MAVLink_system_time_message(0, round(1000 * (t % 10)))
            )
        },
        "the autopilot REBOOTED",
    ),
    "origin": (
        {
            "extra": lambda log, t: log.add(
                t + 0.03,
                dialect.MAVLink_gps_global_origin_message(
                    473977420 + (0 if t < 10 else 900), 85455940, 489400
                ),
            )
        },
        "the local ORIGIN moved by 10.0 m",
    ),
    "a frozen target": (
        {
            "extra": lambda log, t: log.add(
                t + 0.03,
                dialect.MAVLink_global_position_int_message(
                    0, 473977420 + round(100 * min(t, 10)), 85455940, 0, 0, 100, 0, 0, 0
                ),
                42,
            )
        },
        "system 42 repeats ONE report, as if frozen, since 10.0 s",
    ),
    "battery": (
        {
            "extra": lambda log, t: log.add(
                t + 0.03,
                dialect.MAVLink_sys_status_message(
                    0, 0, 0, 0, 15000, 0, 80 if t < 10 else 9, *[0] * 6
                ),
            )
        },
        "BATTERY at 9 %",
    ),
    "the pilot's radio": (
        {
            "extra": lambda log, t: log.add(t + 0.03, sys_status(RADIO, RADIO if t < 10 else 0)),
            "mode": lambda t: OFFBOARD if t < 12 else RTL,
            "status": lambda t: 4 if t < 12 else 5,
        },
        "a FAILSAFE of the autopilot, soon after this: radio control is UNHEALTHY",
    ),
    "a fence": (
        {
            "extra": lambda log, t: log.add(
                t + 0.03, dialect.MAVLink_fence_status_message(int(t > 10), 1, 1, 0)
            )
        },
        "the autopilot's GEOFENCE is breached",
    ),
    "a boot in the air": (
        {"status": lambda t: 4 if t < 10 else 1},
        "the autopilot BOOTS: it has restarted",
    ),
    "packets twice": (
        {"extra": lambda log, t: log.lose(-1) if t % 1 == 0.5 else None},
        "of the vehicle's packets came TWICE",
    ),
    "answers late": (
        {"extra": lambda log, t: ask_to_arm(log, t, answer_s=1.5)},
        "answers come LATE: 1.5 s to that to arm",
    ),
    "answers lost": (
        {"extra": lambda log, t: ask_to_arm(log, t, answer_s=None)},
        "no answer to 1/191, who asked for arm",
    ),
    "noise": (
        {"north": lambda t: 2.0 * t + (3.0 if round(10 * t) % 2 else 0.0)},
        "more times until 19.9 s, by up to 3.0 m: it is noisy, or its estimator does not settle",
    ),
    "a target falls silent": (
        {"extra": lambda log, t: target(log, t, t) if t < 10 else None},
        "system 42 is SILENT since 9.9 s",
    ),
    "a target jumps": (
        {"extra": lambda log, t: target(log, t, t + (0 if t < 10 else 100))},
        "system 42 JUMPED by 11",
    ),
    "two targets of one name": (
        {"extra": lambda log, t: target(log, t, t + 100 * (round(10 * t) % 2))},
        "system 42 reports from TWO PLACES",
    ),
}
BY_KIND = {
    "rc_takeover": "the pilot takes over",
    "rc_loss": "the pilot's radio",
    "gcs_mode": "the pilot takes over",
    "gps_glitch": "glitch",
    "gps_loss": "GPS",
    "ekf_reset": "reset",
    "origin_move": "origin",
    "setpoint_deaf": "setpoints are lost on the way",
    "battery_low": "battery",
    "battery_critical": "battery",
    "geofence": "a fence",
    "reboot": "a boot in the air",
    "second_companion": "a rival",
    "link_loss": "silence",
    "loss": "lost packets",
    "duplicate": "packets twice",
    "corrupt": "lost packets",
    "delay": None,  # what is late looks new: the companion tells it by the clocks of both
    "reorder": None,  # as "delay"
    "ack_lost": "answers lost",
    "ack_late": "answers late",
    "in_progress": None,  # as it should be
    "target_stale": "a target falls silent",
    "target_freeze": "a frozen target",
    "target_jump": "a target jumps",
    "target_clash": "two targets of one name",
}
"""Which of these flights stands for each fault of the mock."""


def test_every_fault_of_the_mock_is_named_or_excused():
    assert BY_KIND.keys() == KINDS.keys()
    assert {name for name in BY_KIND.values() if name} <= FAULTS.keys()


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named(flight_log, fault):
    changes, expected = FAULTS[fault]
    flight_log.fly(**changes)
    story = read_story(flight_log.write())
    assert expected in found(story)
    shown = report(log_flight(story))
    assert expected in " ".join(shown.split())
    assert max(map(len, shown.splitlines()[1:])) <= 80


def test_a_vehicle_that_does_not_follow_is_named(flight_log):
    for index in range(200):
        t = index / 10
        if index % 10 == 0:
            flight_log.heartbeat(t, OFFBOARD)
        flight_log.position(t + 0.01, 0.0, speed=0.0)
        flight_log.setpoint(t + 0.02)
    assert "did NOT FOLLOW its setpoints" in found(read_story(flight_log.write()))
