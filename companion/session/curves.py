"""The plots of a session: one table, from which the recording and its layout are made."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from companion.arrays import FloatArray
from companion.session import colors
from companion.session.colors import Color
from companion.session.records import SessionStart, Tick

Value = float | None


@dataclass(frozen=True, slots=True)
class Line:
    """One line of a plot: what the legend says, its colour and width in points."""

    name: str
    """What the legend says; of a limit with its value: ``margin {margin_m:g} m``."""
    color: Color
    width: float = 1.8

    def named(self, start: SessionStart) -> "Line":
        """Return the line with the value of its limit in its name."""
        name = self.name.format(
            margin_m=start.margin_m,
            v_max_mps=start.v_max_mps,
            arrival_radius_m=start.arrival_radius_m,
        )
        return replace(self, name=name)


@dataclass(frozen=True, slots=True)
class Curve:
    """Lines that share a plot and are logged together."""

    path: str
    title: str
    lines: tuple[Line, ...]
    values: Callable[[Tick, SessionStart], Sequence[Value]]
    """One value for each line; ``None`` where there is none."""
    span: Callable[[SessionStart], tuple[float, float]] | None = None
    """Range of the y axis; fitted to the data without one."""
    legend_left: bool = False
    """Where the legend hides least: flights begin far from the target, low and slow."""

    def rows(self, ticks: Sequence[Tick], start: SessionStart) -> tuple[FloatArray, FloatArray]:
        """Return times, shape ``(N,)``, and values, shape ``(N, lines)``; NaN is a gap.

        Ticks at which no line has a value are left out.
        """
        values = np.array([self.values(tick, start) for tick in ticks], dtype=float)
        values[~np.isfinite(values)] = np.nan
        known = ~np.isnan(values).all(axis=-1)
        time_s = np.array([tick.time_s for tick in ticks])
        return time_s[known], values[known]


def _limit(value: Value, limit: float) -> tuple[Value, Value]:
    return (None, None) if value is None else (value, limit)


def _norm(vector: list[float] | None) -> Value:
    return None if vector is None else math.hypot(*vector)


def _part(vector: list[float] | None, index: int) -> Value:
    return None if vector is None else vector[index]


def _degrees(vector: list[float] | None, index: int) -> Value:
    return None if vector is None else math.degrees(vector[index])


def _parts(vector: list[float] | None) -> Sequence[Value]:
    return (None, None, None) if vector is None else vector


def _axis(name: str, index: int) -> Curve:
    return Curve(
        f"plots/velocity/{name}",
        f"Velocity {name} [m/s]",
        (Line("proposed", colors.PROPOSED, 1.2), Line("sent", colors.SENT), _MEASURED),
        lambda tick, _: (
            _part(tick.proposed_enu_mps, index),
            _part(tick.safe_enu_mps, index),
            _part(tick.velocity_enu_mps, index),
        ),
        lambda start: (-1.1 * start.v_max_mps, 1.1 * start.v_max_mps),
    )


_MEASURED = Line("measured", colors.MEASURED)

DISTANCE = Curve(
    "plots/distance",
    "Distance to target [m]",
    (Line("to target", colors.TARGET), Line("arrival {arrival_radius_m:g} m", colors.LIMIT, 1.0)),
    lambda tick, start: _limit(tick.distance_m, start.arrival_radius_m),
    lambda start: (0.0, math.hypot(*start.map.size_m[:2])),
)
CLEARANCE = Curve(
    "plots/clearance",
    "Clearance of obstacles and ground [m]",
    (Line("clearance", colors.MEASURED), Line("margin {margin_m:g} m", colors.DANGER, 1.0)),
    lambda tick, start: _limit(tick.clearance_m, start.margin_m),
    legend_left=True,
)
ALTITUDE = Curve(
    "plots/altitude",
    "Height above ground [m]",
    (Line("target", colors.TARGET), Line("vehicle", colors.MEASURED)),
    lambda tick, _: (_part(tick.target_enu_m, 2), _part(tick.position_enu_m, 2)),
    legend_left=True,
)
SPEED = Curve(
    "plots/speed",
    "Speed [m/s]",
    (Line("cap, v_max {v_max_mps:g} m/s", colors.LIMIT, 1.0), Line("sent", colors.SENT), _MEASURED),
    lambda tick, start: (
        *_limit(_norm(tick.velocity_enu_mps), tick.speed_cap_mps or start.v_max_mps)[1:],
        _norm(tick.safe_enu_mps),
        _norm(tick.velocity_enu_mps),
    ),
    lambda start: (0.0, 1.15 * start.v_max_mps),
    legend_left=True,
)
EAST, NORTH, UP = _axis("east", 0), _axis("north", 1), _axis("up", 2)
ACTION = Curve(
    "plots/policy/action",
    "Action, normalised",
    (Line("rho", colors.SENT), Line("phi", colors.PROPOSED), Line("psi", colors.EXTRA)),
    lambda tick, _: _parts(tick.action),
    lambda _: (-1.1, 1.1),
)
RHO = Curve(
    "plots/policy/rho",
    "Step rho [fraction of the edge]",
    (Line("rho", colors.SENT),),
    lambda tick, _: (_part(tick.spherical, 0),),
)
ANGLES = Curve(
    "plots/policy/angles",
    "Angles [deg]",
    (Line("phi, from straight up", colors.PROPOSED), Line("psi, azimuth", colors.EXTRA)),
    lambda tick, _: (_degrees(tick.spherical, 1), _degrees(tick.spherical, 2)),
)
LOOP = Curve(
    "plots/health/loop",
    "Control loop [ms]",
    (Line("latency", colors.MEASURED), Line("behind its deadline", colors.PROPOSED)),
    lambda tick, _: (tick.latency_ms, tick.lateness_ms),
)
AGES = Curve(
    "plots/health/ages",
    "Age of what we know [s]",
    (
        Line("heartbeat", colors.LIMIT),
        Line("position", colors.MEASURED),
        Line("target", colors.TARGET),
    ),
    lambda tick, _: (tick.link_age_s, tick.position_age_s, tick.target_age_s),
)
BATTERY = Curve(
    "plots/health/battery",
    "Battery [%]",
    (Line("battery", colors.SENT),),
    lambda tick, _: (None if tick.battery_fraction is None else 100.0 * tick.battery_fraction,),
    lambda _: (0.0, 105.0),
)

CURVES = (
    *(DISTANCE, CLEARANCE, ALTITUDE, SPEED),
    *(EAST, NORTH, UP),
    *(ACTION, RHO, ANGLES),
    *(LOOP, AGES, BATTERY),
)

RATES_PATH = "plots/health/rates"
"""One entity for each message name: names are not known beforehand."""
RATES_TITLE = "Messages [Hz]"
CHARTED = (
    *("HEARTBEAT", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "ATTITUDE"),
    *("GPS_RAW_INT", "SYS_STATUS", "SET_POSITION_TARGET_LOCAL_NED"),
)
"""Messages whose rates are shown; those of others are recorded too."""
OBSERVATION_PATH = "plots/policy/observation"
"""Columns of the actor's layout; those of the rays are beside it, ``plots/policy/wall``."""
OBSERVATION_TITLE = "Observation"


def observation_groups(columns: Sequence[str]) -> dict[str, list[int]]:
    """Return the columns of each plot of the observation by its path; rays have their own."""
    groups: dict[str, list[int]] = {}
    for index, column in enumerate(columns):
        name, _, number = column.rpartition("_")
        path = f"plots/policy/{name}" if number.isdigit() else OBSERVATION_PATH
        groups.setdefault(path, []).append(index)
    return groups


def observation_title(path: str) -> str:
    """Return what is written over a plot of the observation."""
    if path == OBSERVATION_PATH:
        return OBSERVATION_TITLE
    return f"Observation: {path.rpartition('/')[2]} by ray"


INTERVENED = Line("shield", colors.SHIELDED, 2.5)
INTERVENED_PATH = "plots/clearance/shield"
"""A point at the clearance of every tick at which the shield changed the velocity."""
