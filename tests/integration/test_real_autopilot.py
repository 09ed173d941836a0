"""Whole missions on a real autopilot or its simulator, where COMPANION_TEST_CONNECT holds its URL.

It is armed and flown over 80 m by 80 m, up to 20 m high: on a simulator first. It stands where its
local origin is, at launch of map ``free``, x east and y north. What was measured is printed
(``pytest -rP``); README says how to start simulators.
"""

import json
import os
import subprocess
import time

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.guidance.failsafe import REACTION_S, failsafe_of
from tests.integration.real_wire import MODES, RealWire
from tests.integration.running import COMPANION, free_port

REAL_URL = os.environ.get("COMPANION_TEST_CONNECT", "")
pytestmark = [
    pytest.mark.skipif(not REAL_URL, reason="COMPANION_TEST_CONNECT is not set"),
    pytest.mark.timeout(300),
]
LAUNCH_ENU_M = np.array((10.0, 10.0, 0.0))
CORNERS_ENU_M = np.array([(x, y, 15.0) for x in (15.0, 85.0) for y in (15.0, 85.0)])
UP = ("--arm", "--takeoff", "10", "--engage")
ARRIVAL_M = 5.0
AT_SPEED_MPS = 3.0
BATTERY_PERCENT = 35
"""Below a quarter the companion refuses to fly."""
SLOWER = 0.1
"""By this share of its speed it has slowed down when it counts as braking."""
TICK_S = 0.05
BEACON = 42


@pytest.fixture(scope="module")
def site():
    """The wire to the autopilot, ready to be armed."""
    wire = RealWire(REAL_URL)
    wire.start()
    wire.listen()
    yield wire
    wire.close()


@pytest.fixture
def wire(site):
    if 0 <= site.battery_percent < BATTERY_PERCENT:
        pytest.skip(f"battery at {site.battery_percent} %")
    yield site
    site.cut = False
    site.land()


@pytest.fixture
def fly(wire, run):
    def start(*options):
        port = free_port()
        wire.lead_to(port)
        return run("--connect", f"udp:127.0.0.1:{port}", "--map", "free", *options)

    return start


def on_map(position_ned_m):
    north_m, east_m, down_m = position_ned_m
    return LAUNCH_ENU_M + np.array((east_m, north_m, -down_m))


def far_off(wire):
    """Return the corner of the square that is farthest from the vehicle."""
    here_enu_m = on_map(wire.position_ned_m)
    return CORNERS_ENU_M[np.linalg.norm(CORNERS_ENU_M - here_enu_m, axis=1).argmax()]


def on_earth(wire, position_enu_m):
    """Return latitude and longitude (1e-7 deg) and altitude (m) of a point on the map."""
    here = wire.newest("GLOBAL_POSITION_INT")
    east_m, north_m, up_m = position_enu_m - on_map(wire.position_ned_m)
    latitude = here.lat + north_m / 0.0111319
    longitude = here.lon + east_m / 0.0111319 / np.cos(np.radians(here.lat / 1e7))
    return round(latitude), round(longitude), here.alt / 1e3 + up_m


def text(numbers):
    return ",".join(f"{number:.7f}" for number in numbers)


def is_at(wire, target_enu_m):
    distance_m = float(np.linalg.norm(on_map(wire.position_ned_m) - target_enu_m))
    assert distance_m < ARRIVAL_M + 1.0
    return distance_m


def tell(name, **numbers):
    words = (f"{key} {value:.3g}" for key, value in numbers.items() if value is not None)
    print(f"{name}: {', '.join(words)}")


def tell_summary(name, summary, **more):
    keys = ("duration_s", "setpoint_rate_hz", "longest_gap_ms", "latency_p50_ms",
            "latency_p99_ms", "velocity_lag_s", "link_loss_percent")  # fmt: skip
    tell(name, **{key: summary[key] for key in keys}, **more)


def check_arrival(wire, summary, target_enu_m, name):
    assert (summary["outcome"], summary["exit_code"]) == ("arrived", 0), summary["reason"]
    distance_m = is_at(wire, target_enu_m)
    wire.wait(lambda: wire.is_in("hold"), 5.0, "not given back in hold")
    assert wire.armed
    assert len(wire.setpoints()) == summary["setpoints_sent"]
    assert wire.setpoints(wire.left_mode_s("external") + TICK_S) == []
    tell_summary(name, summary, final_m=summary["final_distance_m"], seen_final_m=distance_m)


def preflight(wire, *options):
    port = free_port()
    wire.lead_to(port)
    command = [*COMPANION, "preflight", "--connect", f"udp:127.0.0.1:{port}", "--map", "free"]
    finished = subprocess.run(
        [*command, "--json", *options], capture_output=True, text=True, timeout=60
    )
    return json.loads(finished.stdout)


def fast(wire):
    return wire.is_in("external") and wire.speed_mps > AT_SPEED_MPS


# -- missions ----------------------------------------------------------------------------------


def test_preflight_says_go_and_moves_nothing(wire):
    found = preflight(wire, "--target", text(CORNERS_ENU_M[3]))
    assert found["go"], found["reasons"]
    assert found["assumed"] == []
    sent = {each.message.get_type() for each in wire.of_companion}
    assert sent <= {"HEARTBEAT", "COMMAND_LONG", "PARAM_REQUEST_READ", "TIMESYNC"}
    assert not wire.armed
    print(found["version"], found["failsafe"], *found["failsafe_notes"], sep="\n")
    tell("preflight", rate_hz=found["position_rate_hz"], age_s=found["position_age_max_s"],
         residual_m=found["tie_residual_m"], blind_m=found["blind_travel_m"])  # fmt: skip


def test_from_the_ground_to_the_target(wire, fly):
    target_enu_m = far_off(wire)
    summary = fly("--target", text(target_enu_m), *UP).finish(150.0)
    check_arrival(wire, summary, target_enu_m, "from the ground")


def test_in_the_air_it_waits_for_the_pilot(wire, fly):
    wire.take_off()
    target_enu_m = far_off(wire)
    started = fly("--target", text(target_enu_m))
    started.wait_for("the pilot selects")
    time.sleep(2.0)
    assert wire.is_in("hold")
    assert all(_is_zero(each.message) for each in wire.setpoints())
    assert wire.set_mode("external") == 0
    check_arrival(wire, started.finish(120.0), target_enu_m, "in the air")


def test_a_target_on_earth(wire, fly):
    target_enu_m = far_off(wire)
    latitude, longitude, altitude_m = on_earth(wire, target_enu_m)
    where = f"{latitude / 1e7:.7f},{longitude / 1e7:.7f},{altitude_m:.2f}"
    summary = fly(f"--target-global={where}", *UP).finish(150.0)
    check_arrival(wire, summary, target_enu_m, "--target-global")


@pytest.mark.parametrize("source", ["GLOBAL_POSITION_INT", "FOLLOW_TARGET"])
def test_another_vehicle_is_pursued(wire, fly, source):
    target_enu_m = far_off(wire)
    latitude, longitude, altitude_m = on_earth(wire, target_enu_m)
    started = fly("--target-sysid", BEACON, *UP)
    begin_s = time.monotonic()
    while started.process.poll() is None:
        time_ms = round(1e3 * (time.monotonic() - begin_s))
        message = dialect.MAVLink_global_position_int_message(
            time_ms, latitude, longitude, round(1e3 * altitude_m), 0, 0, 0, 0, 65535
        )
        if source == "FOLLOW_TARGET":
            nothing = [0.0] * 3
            message = dialect.MAVLink_follow_target_message(
                time_ms, 1, latitude, longitude, altitude_m, nothing, nothing,
                [1.0, 0.0, 0.0, 0.0], nothing, nothing, 0,
            )  # fmt: skip
        wire.tell_companion(message, (BEACON, 1))
        time.sleep(0.2)
    check_arrival(wire, started.finish(), target_enu_m, source)


def test_a_ground_station_sends_it_to_a_place(wire, fly):
    target_enu_m = far_off(wire)
    latitude, longitude, altitude_m = on_earth(wire, target_enu_m)
    started = fly(*UP)
    started.wait_for("the target is silent")
    wire.tell_companion(
        dialect.MAVLink_command_int_message(
            wire.system_id, 191, dialect.MAV_FRAME_GLOBAL, dialect.MAV_CMD_DO_REPOSITION,
            0, 0, -1.0, 0.0, 0.0, float("nan"), latitude, longitude, altitude_m,
        )
    )  # fmt: skip
    check_arrival(wire, started.finish(150.0), target_enu_m, "DO_REPOSITION")


def test_shadow_moves_nothing(wire, fly):
    wire.take_off()
    started = fly("--target", text(far_off(wire)), "--shadow")
    started.wait_for("engaged")
    time.sleep(5.0)
    started.process.terminate()
    summary = started.finish()
    assert (summary["outcome"], summary["setpoints_sent"]) == ("stopped", 0)
    assert wire.setpoints() == []
    commands = {
        each.message.command
        for each in wire.of_companion
        if each.message.get_type() == "COMMAND_LONG"
    }
    assert commands <= {dialect.MAV_CMD_SET_MESSAGE_INTERVAL, dialect.MAV_CMD_REQUEST_MESSAGE}
    assert wire.is_in("hold")


@pytest.mark.parametrize(("on_exit", "mode"), [("land", "land"), ("hold", "hold")])
def test_stopped_by_a_signal_it_gives_the_vehicle_back(wire, fly, on_exit, mode):
    started = fly("--target", text(far_off(wire)), *UP, "--on-exit", on_exit)
    wire.wait(lambda: fast(wire), 60.0)
    started.process.terminate()
    summary = started.finish()
    assert (summary["outcome"], summary["exit_code"]) == ("stopped", 130)
    assert "not confirmed" not in summary["reason"]
    assert wire.is_in(mode)
    assert wire.setpoints(wire.left_mode_s("external") + TICK_S) == []


# -- what goes wrong ---------------------------------------------------------------------------


def test_a_pilot_takes_over_in_mid_flight(wire, fly):
    started = fly("--target", text(far_off(wire)), *UP)
    wire.wait(lambda: fast(wire), 60.0)
    asked_s = time.monotonic()
    assert wire.set_mode("hold") == 0
    summary = started.finish()
    assert (summary["outcome"], summary["exit_code"], summary["takeovers"]) == ("stood_down", 7, 1)
    shown_s = wire.left_mode_s("external")
    late = wire.setpoints(shown_s + TICK_S)
    assert late == []
    wire.wait(lambda: wire.speed_mps < 0.5, 10.0, "it flies on")
    assert wire.is_in("hold")
    last_s = max(each.time_s for each in wire.setpoints())
    tell("takeover", shown_s=shown_s - asked_s, silent_s=last_s - asked_s, after_shown=len(late))


def test_killed_the_vehicle_does_what_preflight_said(wire, fly):
    said = preflight(wire)
    started = fly("--target", text(far_off(wire)), *UP)
    wire.wait(lambda: fast(wire), 60.0)
    started.process.kill()
    started.process.wait()
    blind = _left_alone(wire)
    parameters, speed_mps = said["parameters"], blind["speed_mps"]
    failsafe = failsafe_of(said["autopilot"], parameters, said["version"])
    slower_s = REACTION_S + SLOWER * speed_mps / failsafe.brake_mps2
    assert blind["slower_s"] == pytest.approx(failsafe.loss_s + slower_s, abs=0.5)
    predicted_m = failsafe.blind_travel_m(speed_mps)
    tell("killed", **blind, predicted_m=predicted_m)
    print(said["failsafe"], wire.mode)
    assert blind["travel_m"] < 1.25 * predicted_m
    assert wire.is_in("external") is (wire.autopilot != dialect.MAV_AUTOPILOT_PX4)


def test_a_cut_link_ends_the_run_for_good(wire, fly):
    started = fly("--target", text(far_off(wire)), *UP)
    wire.wait(lambda: fast(wire), 60.0)
    wire.cut, cut_s = True, time.monotonic()
    blind = _left_alone(wire)
    summary = started.finish()
    ended_s = time.monotonic() - cut_s
    wire.cut = False
    assert (summary["outcome"], summary["exit_code"]) == ("link_lost", 4), summary["reason"]
    time.sleep(2.0)
    assert wire.setpoints(cut_s) == []
    tell("link cut", **blind, ended_s=ended_s)


def test_a_link_cut_for_a_moment_is_no_way_back_into_a_failsafe(wire, fly):
    """PX4 comes back to OFFBOARD by itself when a stream does, even from a failsafe."""
    started = fly("--target", text(far_off(wire)), *UP)
    wire.wait(lambda: fast(wire), 60.0)
    wire.cut, cut_s = True, time.monotonic()
    time.sleep(1.5)
    wire.cut, healed_s = False, time.monotonic()
    summary = started.finish()
    assert summary["exit_code"] in (4, 7), summary["reason"]
    moving = [each for each in wire.setpoints(healed_s) if not _is_zero(each.message)]
    tell("cut for 1.5 s", ended_s=time.monotonic() - cut_s, moving_after=len(moving),
         zeros_after=len(wire.setpoints(healed_s)) - len(moving))  # fmt: skip
    assert moving == []


def _left_alone(wire):
    """Return how a vehicle at speed comes to rest without us."""
    last_s = max(each.time_s for each in wire.setpoints())
    seen = [each for each in wire.heard("LOCAL_POSITION_NED") if each.time_s <= last_s][-1].message
    start_m, velocity_mps = np.array((seen.x, seen.y)), np.array((seen.vx, seen.vy))
    speed_mps = float(np.linalg.norm(velocity_mps))
    along = velocity_mps / speed_mps

    def ahead(passed):
        return float((np.array((passed.message.x, passed.message.y)) - start_m) @ along)

    def onward_mps(passed):
        return float(np.array((passed.message.vx, passed.message.vy)) @ along)

    def rests():
        newest = wire.heard("LOCAL_POSITION_NED", last_s)
        return newest and onward_mps(newest[-1]) < 0.2

    wire.wait(rests, 20.0, "it flies on for ever")
    track = wire.heard("LOCAL_POSITION_NED", last_s)
    cruise_mps = max(map(onward_mps, track))
    slower_s = max(each.time_s for each in track if onward_mps(each) >= (1 - SLOWER) * cruise_mps)
    return {
        "speed_mps": cruise_mps,
        "slower_s": slower_s - last_s,
        "travel_m": max(map(ahead, track)),
    }


def _is_zero(setpoint):
    return not (setpoint.vx or setpoint.vy or setpoint.vz)


def test_modes_are_known(site):
    assert site.autopilot in MODES
