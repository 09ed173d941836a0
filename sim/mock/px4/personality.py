"""PX4 as a personality of the mock."""

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.world.frames import GeoPoint
from sim.mock.dynamics import Response
from sim.mock.geodesy import SphericalProjection
from sim.mock.personality import Personality
from sim.mock.px4.channel import Px4Channel
from sim.mock.px4.commander import Px4
from sim.mock.px4.incoming import HANDLERS, is_for_us

PX4 = Personality(
    name="px4",
    kind=Px4,
    build=Px4,
    open_channel=Px4Channel,
    rates_of=lambda ground: "ground-station rates" if ground else "onboard rates",
    handlers=HANDLERS,
    is_for_us=is_for_us,
    projection=SphericalProjection,
    home=GeoPoint(47.397742, 8.545594, 489.4),
    unsigned_allowed=(
        mavlink.MAVLINK_MSG_ID_HEARTBEAT,
        mavlink.MAVLINK_MSG_ID_RADIO_STATUS,
        mavlink.MAVLINK_MSG_ID_ADSB_VEHICLE,
        mavlink.MAVLINK_MSG_ID_COLLISION,
    ),
    response=Response(
        velocity_lag_s=1.0 / 1.8,
        climb_lag_s=1.0 / 4.0,
        attitude_lag_s=0.35,
        drag_per_s=1.1,
        integral_per_s2=0.4,
        climb_integral_per_s2=2.0,
        acceleration_xy_mps2=5.0,
        acceleration_up_mps2=2.0,
        acceleration_down_mps2=3.0,
    ),
)
