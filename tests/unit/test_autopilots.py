import math
import struct

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.errors import RefusedError
from companion.link.autopilots import ArduPilot, Px4, autopilot_of
from companion.vehicle import FlightMode, LandedState, SystemStatus

GROUND, AIR = LandedState.ON_GROUND, LandedState.IN_AIR


def test_firmware_and_kind_decide():
    assert autopilot_of(12, 2).name == "px4"
    assert autopilot_of(3, 13).name == "ardupilot"
    with pytest.raises(RefusedError, match="MAV_AUTOPILOT 4"):
        autopilot_of(4, 2)
    for plane_or_vtol in (1, 10, 20):
        with pytest.raises(RefusedError, match=f"MAV_TYPE {plane_or_vtol}"):
            autopilot_of(3, plane_or_vtol)


@pytest.mark.parametrize(
    ("custom_mode", "name", "mode"),
    [  # as heartbeats of PX4 1.18 showed them
        (0x03040000, "AUTO.LOITER", FlightMode.HOLD),
        (0x00060000, "OFFBOARD", FlightMode.EXTERNAL),
        (0x00030000, "POSCTL", FlightMode.OTHER),
        (0x05040000, "AUTO.RTL", FlightMode.RETURN),
        (0x06040000, "AUTO.LAND", FlightMode.LAND),
        (0x02040000, "AUTO.TAKEOFF", FlightMode.TAKEOFF),
        (0x04040000, "AUTO.MISSION", FlightMode.OTHER),
        (0x77040000, "AUTO.119", FlightMode.OTHER),
        (0x00550000, "MODE 85.0", FlightMode.OTHER),
        (0xFFFFFFFF, "MODE 255.255", FlightMode.OTHER),
        (0, "MODE 0.0", FlightMode.OTHER),
    ],
)
def test_px4_modes(custom_mode, name, mode):
    assert (Px4().mode_name(custom_mode), Px4().mode(custom_mode)) == (name, mode)


@pytest.mark.parametrize(
    ("custom_mode", "name", "mode"),
    [
        (0, "STABILIZE", FlightMode.OTHER),
        (4, "GUIDED", FlightMode.EXTERNAL),
        (5, "LOITER", FlightMode.HOLD),
        (6, "RTL", FlightMode.RETURN),
        (9, "LAND", FlightMode.LAND),
        (17, "BRAKE", FlightMode.HOLD),
        (20, "GUIDED_NOGPS", FlightMode.OTHER),
        (4294967295, "MODE 4294967295", FlightMode.OTHER),
    ],
)
def test_ardupilot_modes(custom_mode, name, mode):
    assert (ArduPilot().mode_name(custom_mode), ArduPilot().mode(custom_mode)) == (name, mode)


@pytest.mark.parametrize("mode", ["external", "hold", "land", "return"])
def test_asking_for_a_mode_asks_for_the_one_that_shows_as_it(mode):
    wanted = FlightMode(mode)
    flags, main, sub, *rest = Px4().set_mode(wanted).params
    assert (flags, rest) == (1.0, [0.0] * 4)
    assert Px4().mode(int(main) << 16 | int(sub) << 24) is wanted
    flags, number, *rest = ArduPilot().set_mode(wanted).params
    assert (flags, rest) == (1.0, [0.0] * 5)
    assert ArduPilot().mode(int(number)) is wanted


def test_ardupilot_holds_by_brake_not_by_the_pilots_throttle():
    assert ArduPilot().set_mode(FlightMode.HOLD).params[1] == 17


def test_take_off_altitudes():
    command = Px4().take_off(10.0, 489.4)
    assert command.number == dialect.MAV_CMD_NAV_TAKEOFF
    assert command.params[6] == 499.4
    assert all(map(math.isnan, command.params[3:6]))
    assert Px4().take_off(10.0, None) is None
    assert ArduPilot().take_off(10.0, 584.0).params == (0, 0, 0, 0, 0, 0, 10.0)
    assert ArduPilot().take_off(10.0, None).params[6] == 10.0


def test_signs_of_a_take_off():
    assert Px4().takes_off(FlightMode.TAKEOFF, GROUND)
    assert not ArduPilot().takes_off(FlightMode.EXTERNAL, GROUND)
    for autopilot in (Px4(), ArduPilot()):
        assert autopilot.takes_off(FlightMode.EXTERNAL, LandedState.TAKING_OFF)
        assert autopilot.takes_off(FlightMode.EXTERNAL, AIR)
        assert not autopilot.takes_off(FlightMode.EXTERNAL, LandedState.LANDING)


def test_ready_to_arm():
    assert Px4().ready_to_arm(SystemStatus.STANDBY, None)
    assert not Px4().ready_to_arm(SystemStatus.UNINIT, True)
    assert not Px4().ready_to_arm(SystemStatus.STANDBY, False)
    assert ArduPilot().ready_to_arm(SystemStatus.STANDBY, True)
    assert not ArduPilot().ready_to_arm(SystemStatus.STANDBY, None)
    assert not ArduPilot().ready_to_arm(SystemStatus.BOOT, True)


@pytest.mark.parametrize(
    ("flags", "landed", "valid"),
    [  # ESTIMATOR_STATUS flags of PX4 1.18
        (0x00A4, GROUND, False),
        (0x00E5, GROUND, False),
        (0x03FF, GROUND, True),
        (0x037F, AIR, True),
        (0x03FF, AIR, False),  # CONST_POS_MODE is a fault in the air
        (0x0065, AIR, False),  # GPS lost
        (0x037F | 1024, AIR, False),
        (0x037F | 2048, AIR, False),
    ],
)
def test_px4_position_valid(flags, landed, valid):
    assert Px4().position_valid(flags, landed) is valid


@pytest.mark.parametrize(
    ("flags", "valid"),
    [  # EKF_STATUS_REPORT flags of ArduCopter 4.6.3
        (0x400, False),
        (0x000, False),
        (0x0A7, False),
        (0x33F, True),
        (0x025, False),
        (0x33F | 32768, False),
    ],
)
def test_ardupilot_position_valid(flags, valid):
    assert ArduPilot().position_valid(flags, AIR) is valid


def test_every_bit_that_position_needs_is_needed():
    for autopilot in (Px4(), ArduPilot()):
        for bit in (1, 2, 4, 32):
            assert not autopilot.position_valid(0x33F & ~bit, AIR)
        assert autopilot.position_valid(0x33F & ~8, AIR)
        assert autopilot.position_valid(0x33F & ~16, AIR)
        assert not autopilot.position_valid(0x33F & ~24, AIR)


@pytest.mark.parametrize(
    ("layout", "kind", "value"),
    [
        ("<i", dialect.MAV_PARAM_TYPE_INT32, -1),
        ("<i", dialect.MAV_PARAM_TYPE_INT32, -5000000),  # a signalling NaN as a float
        ("<i", dialect.MAV_PARAM_TYPE_INT32, 2**31 - 1),
        ("<I", dialect.MAV_PARAM_TYPE_UINT32, 2**32 - 1),
        ("<b", dialect.MAV_PARAM_TYPE_INT8, -128),
        ("<B", dialect.MAV_PARAM_TYPE_UINT8, 255),
        ("<h", dialect.MAV_PARAM_TYPE_INT16, -2),
        ("<H", dialect.MAV_PARAM_TYPE_UINT16, 65535),
        ("<f", dialect.MAV_PARAM_TYPE_REAL32, 0.5),
    ],
)
def test_px4_parameters_are_bytes(layout, kind, value):
    decoded = Px4().decode_param(struct.pack(layout, value).ljust(4, b"\0"), kind)
    assert (decoded, type(decoded)) == (value, type(value))


def test_ardupilot_parameters_are_cast():
    three = struct.pack("<f", 3.0)
    for kind, expected in ((2, 3), (6, 3), (9, 3.0)):
        decoded = ArduPilot().decode_param(three, kind)
        assert (decoded, type(decoded)) == (expected, type(expected))
    assert math.isnan(ArduPilot().decode_param(struct.pack("<f", math.nan), 6))


def test_estimator_health_is_among_the_streams():
    for autopilot in (Px4(), ArduPilot()):
        assert autopilot.estimator_message_id in autopilot.stream_rates_hz
        assert autopilot.stream_rates_hz[dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED] >= 20.0
