"""ArduCopter as a personality of the mock."""

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.world.frames import GeoPoint
from sim.mock.ardupilot.channel import CopterChannel
from sim.mock.ardupilot.copter import ArduCopter
from sim.mock.ardupilot.incoming import HANDLERS, is_for_us
from sim.mock.dynamics import Response
from sim.mock.geodesy import FlatProjection
from sim.mock.personality import Personality

ARDUPILOT = Personality(
    name="ardupilot",
    kind=ArduCopter,
    build=ArduCopter,
    open_channel=CopterChannel,
    rates_of=lambda ground: "HEARTBEAT until asked",
    handlers=HANDLERS,
    is_for_us=is_for_us,
    projection=FlatProjection,
    home=GeoPoint(-35.3632610, 149.1652299, 584.09),
    unsigned_allowed=(mavlink.MAVLINK_MSG_ID_RADIO_STATUS, mavlink.MAVLINK_MSG_ID_RADIO),
    trusts_usb=True,
    response=Response(
        velocity_lag_s=0.6,
        climb_lag_s=0.35,
        attitude_lag_s=0.2,
        thrust_lag_s=0.2,
        acceleration_xy_mps2=2.0,
        acceleration_up_mps2=1.1,
        acceleration_down_mps2=1.5,
    ),
    silent_faults=("origin_move",),
)
