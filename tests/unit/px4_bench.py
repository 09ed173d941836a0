"""What the tests of the mock PX4 share: a vehicle that is ready, armed or flying."""

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock.bench import Bench

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = range(5)
SET_MODE, ARM, TAKEOFF, LAND, RTL, REPOSITION = 176, 400, 22, 21, 20, 192
OFFBOARD = (1.0, 6.0)
LOITER = (1.0, 4.0, 3.0)
POSCTL = (1.0, 3.0)
NAN = math.nan


def booted(**options):
    bench = Bench(**options)
    bench.run(2.0)
    return bench


def flying(**options):
    """A vehicle in OFFBOARD at 10 m above home, reached on position setpoints."""
    bench = booted(**options)
    up = bench.position(0.0, 0.0, -10.0)
    bench.run(0.5, stream=up)
    assert bench.command(SET_MODE, *OFFBOARD) == ACCEPTED
    assert bench.command(ARM, 1.0) == ACCEPTED
    assert bench.run(15.0, stream=up, until=lambda: altitude_m(bench) > 9.5)
    bench.run(2.0, stream=up)
    return bench


def altitude_m(bench):
    return -bench.last("LOCAL_POSITION_NED").z


def mode(bench):
    return bench.last("HEARTBEAT").custom_mode


def state(bench):
    heartbeat = bench.last("HEARTBEAT")
    return heartbeat.base_mode, heartbeat.custom_mode, heartbeat.system_status


def gcs_heartbeat():
    return mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)


def sticks(**axes):
    return lambda: mavlink.MAVLink_manual_control_message(
        1, axes.get("x", 0), axes.get("y", 0), axes.get("z", 500), axes.get("r", 0), 0
    )
