"""The plots of a telemetry log that was not recorded here."""

import math

from companion.session import colors
from companion.session.curves import AGES as _AGES
from companion.session.curves import BATTERY, Curve, Line, Value
from companion.session.records import SessionStart, Tick

_MEASURED = Line("measured", colors.MEASURED)
_SETPOINT = Line("setpoint", colors.SENT)
_WANTED = Line("autopilot's own wish", colors.EXTRA, 1.2)


def _axis(name: str, index: int) -> Curve:
    def values(tick: Tick, _: SessionStart) -> tuple[Value, Value, Value]:
        return (
            _part(tick.proposed_enu_mps, index),
            _part(tick.safe_enu_mps, index),
            _part(tick.velocity_enu_mps, index),
        )

    return Curve(
        f"plots/velocity/{name}",
        f"Velocity {name} [m/s]",
        (_WANTED, _SETPOINT, _MEASURED),
        values,
    )


def _part(vector: list[float] | None, index: int) -> Value:
    return None if vector is None else vector[index]


def _length(vector: list[float] | None) -> Value:
    return None if vector is None else math.hypot(*vector)


def _degrees(tick: Tick, index: int) -> Value:
    return None if tick.attitude_rad is None else math.degrees(tick.attitude_rad[index])


ALTITUDE = Curve(
    "plots/altitude",
    "Height above take-off [m]",
    (Line("vehicle", colors.MEASURED),),
    lambda tick, _: (_part(tick.position_enu_m, 2),),
    legend_left=True,
)
CLEARANCE = Curve(
    "plots/clearance",
    "Clearance of obstacles [m]",
    (Line("clearance", colors.MEASURED),),
    lambda tick, _: (tick.clearance_m,),
)
"""Of logs that are laid over a map."""
SPEED = Curve(
    "plots/speed",
    "Speed [m/s]",
    (_SETPOINT, _MEASURED),
    lambda tick, _: (_length(tick.safe_enu_mps), _length(tick.velocity_enu_mps)),
    legend_left=True,
)
VELOCITY = (_axis("east", 0), _axis("north", 1), _axis("up", 2))
TILT = Curve(
    "plots/attitude",
    "Roll and pitch [deg]",
    (Line("roll", colors.PROPOSED), Line("pitch", colors.MEASURED)),
    lambda tick, _: (_degrees(tick, 0), _degrees(tick, 1)),
)
YAW = Curve(
    "plots/yaw",
    "Heading [deg]",
    (Line("yaw, clockwise from north", colors.EXTRA),),
    lambda tick, _: (_degrees(tick, 2),),
)
AGES = Curve(
    _AGES.path,
    _AGES.title,
    _AGES.lines[:2],
    lambda tick, _: (tick.link_age_s, tick.position_age_s),
)
HEALTH = (AGES, BATTERY)
LOG_CURVES = (ALTITUDE, CLEARANCE, SPEED, TILT, *VELOCITY, YAW, *HEALTH)
