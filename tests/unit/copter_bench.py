"""What the tests of the mock ArduCopter share: a vehicle that is ready, armed or flying."""

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock.ardupilot.personality import ARDUPILOT
from sim.mock.bench import Bench
from sim.mock.placement import place_vehicle
from sim.mock.vehicle import Settings

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = range(5)
SET_MODE, ARM, TAKEOFF, LAND_NOW, RTL_NOW, REPOSITION, INTERVAL, REQUEST = (
    176, 400, 22, 21, 20, 192, 511, 512,
)  # fmt: skip
STABILIZE, AUTO, GUIDED, LOITER, RTL, LAND, BRAKE = 0, 3, 4, 5, 6, 9, 17


def copter(boot_s=1.5, **options):
    settings = {key: options.pop(key) for key in ("radio",) if key in options}
    place = place_vehicle(None, None, ARDUPILOT)
    return Bench(Settings(place, boot_s=boot_s, personality=ARDUPILOT, **settings), **options)


def booted(**options):
    """One that is ready, with the messages asked for that the tests look at."""
    bench = copter(**options)
    for name, rate_hz in (
        ("LOCAL_POSITION_NED", 20.0),
        ("ATTITUDE", 20.0),
        ("EKF_STATUS_REPORT", 10.0),
        ("EXTENDED_SYS_STATE", 10.0),
        ("SYS_STATUS", 5.0),
        ("POSITION_TARGET_LOCAL_NED", 5.0),
    ):
        number = getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
        assert bench.command(INTERVAL, number, 1e6 / rate_hz) == ACCEPTED
    bench.run(2.0)
    return bench


def mode(bench, number):
    return bench.command(SET_MODE, 1.0, number)


def armed(**options):
    bench = booted(**options)
    assert mode(bench, GUIDED) == ACCEPTED
    assert bench.command(ARM, 1.0) == ACCEPTED
    return bench


def flying(altitude=10.0, **options):
    """One in GUIDED, taken off and steady."""
    bench = armed(**options)
    assert bench.command(TAKEOFF, 0, 0, 0, 0, 0, 0, altitude) == ACCEPTED
    assert bench.run(30.0, until=lambda: landed_state(bench) == 2)
    bench.run(2.0)
    return bench


def steady(bench, *velocity, duration_s=4.0, **options):
    """Fly a velocity until it is reached."""
    bench.run(duration_s, stream=bench.velocity(*velocity), **options)
    return bench


def position(bench):
    last = bench.last("LOCAL_POSITION_NED")
    return last.x, last.y, last.z


def landed_state(bench):
    return bench.last("EXTENDED_SYS_STATE").landed_state


def speed(bench):
    last = bench.last("LOCAL_POSITION_NED")
    return last.vx, last.vy, last.vz


def state(bench):
    heartbeat = bench.last("HEARTBEAT")
    return heartbeat.base_mode, heartbeat.custom_mode, heartbeat.system_status


def autopilot(bench):
    return bench.vehicle.autopilot


def gcs_heartbeat():
    return mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
