"""What has to be so before a flight starts, as words: empty means nothing stands against it."""

import numpy as np

from companion.arrays import FloatArray
from companion.guidance.limits import (
    ARRIVAL_RADIUS_M,
    BATTERY_ENGAGE,
    OFF_MAP_M,
    POSITION_STALE_SOFT_S,
)
from companion.guidance.shield_limits import ShieldLimits
from companion.guidance.target import TargetEstimate
from companion.positions import Pose, TargetSource
from companion.vehicle import SystemStatus, VehicleState
from companion.world.geometry import Obstacles
from companion.world.maps import Map

POSITION_MIN_HZ = 10.0
"""Two positions may be lost before ``POSITION_STALE_SOFT_S`` is over."""
_ON_GROUND_M = 0.5
"""A vehicle on the ground reads a little above or below it."""
_STEP_M = 0.5
"""Between the places that are looked at round a target inside the margin."""


def _around() -> FloatArray:
    """Return the offsets of places round a target that count as arrived, the nearest first."""
    steps_m = np.arange(-ARRIVAL_RADIUS_M, ARRIVAL_RADIUS_M + _STEP_M, _STEP_M)
    offset_m = np.stack(np.meshgrid(steps_m, steps_m, steps_m), axis=-1).reshape(-1, 3)
    distance_m = np.sqrt(np.square(offset_m).sum(axis=1))
    order = distance_m.argsort(kind="stable")
    return np.asarray(offset_m[order][distance_m[order] < ARRIVAL_RADIUS_M - _STEP_M])


_AROUND_M = _around()


def waiting_for(
    city: Map,
    state: VehicleState | None,
    pose: Pose | None,
    source: TargetSource,
    target: TargetEstimate,
) -> str:
    """Return what is still missing for a flight and may yet come."""
    if state is None:
        return "no position from the vehicle yet"
    if pose is None:
        return "no origin from the vehicle yet (GPS_GLOBAL_ORIGIN): has it a GPS fix?"
    if not state.position_valid:
        return "the estimator does not vouch for the position"
    if source.expected and target.position_enu_m is None:
        if source.system_id is not None:
            return f"no position of target system {source.system_id} yet"
        return "no origin from the vehicle yet (GPS_GLOBAL_ORIGIN) to place the target"
    if source.system_id is not None and target.position_enu_m is not None:
        outside_m = city.outside_m(target.position_enu_m)
        if outside_m > OFF_MAP_M:
            return f"target system {source.system_id} is {outside_m:.0f} m outside map {city.name}"
    return ""


def refusal(
    city: Map,
    pose: Pose | None,
    target: TargetEstimate,
    *,
    takeoff_m: float | None,
    margin_m: float,
) -> str:
    """Return why a flight must not start at all."""
    if pose is None:
        return ""
    place = pose.position_enu_m
    above_ground = np.array([place[0], place[1], max(_ON_GROUND_M, place[2])])
    if not city.contains(above_ground):
        return (
            f"the vehicle is at {words(place)}, outside map {city.name}; "
            "use the map of where it stands"
        )
    if not city.is_free(above_ground):
        where = _obstacle_at(city, above_ground)
        return f"the vehicle is at {words(place)}, inside {where} of map {city.name}"
    if takeoff_m is not None:
        top = place + np.array([0.0, 0.0, takeoff_m])
        column = np.linspace(above_ground, top, max(2, int(takeoff_m)))
        lid = top + np.array([0.0, 0.0, margin_m])
        if not city.contains(lid) or not city.is_free(column[1:], margin_m).all():
            return (
                f"a take-off to {takeoff_m:g} m at {words(place)} comes nearer than "
                f"{margin_m:g} m to an obstacle or the edge of map {city.name}"
            )
    if target.position_enu_m is not None and not target.velocity_enu_mps.any():
        return target_problem(city, target.position_enu_m, margin_m)
    return ""


def target_problem(city: Map, position_enu_m: FloatArray, margin_m: float) -> str:
    """Return why a static target cannot be flown to."""
    if not city.contains(position_enu_m):
        size = " x ".join(f"{side:g}" for side in city.size_m)
        return f"target {words(position_enu_m)} is outside map {city.name} ({size} m)"
    if not city.is_free(position_enu_m):
        where = _obstacle_at(city, position_enu_m)
        return f"target {words(position_enu_m)} is inside {where} of map {city.name}"
    if _nearest_m(city, position_enu_m, margin_m) is None:
        return (
            f"target {words(position_enu_m)} is out of reach: nowhere within "
            f"{ARRIVAL_RADIUS_M:g} m of it does the shield keep its --margin of {margin_m:g} m"
        )
    return ""


def target_warning(city: Map, position_enu_m: FloatArray, margin_m: float) -> str:
    """Return what a pilot should know of a static target that can be flown to."""
    nearest_m = _nearest_m(city, position_enu_m, margin_m)
    if not nearest_m:
        return ""
    return (
        f"target {words(position_enu_m)} lies inside the shield's margin of {margin_m:g} m: the "
        f"vehicle comes no nearer to it than {nearest_m:.1f} m"
    )


def _nearest_m(city: Map, target_enu_m: FloatArray, margin_m: float) -> float | None:
    """Return how near to a target the shield lets a vehicle come, to half a metre.

    ``None`` where that is not near enough to arrive.
    """
    margins_m = np.array([margin_m, margin_m, ShieldLimits().min_height_m])
    for offset_m in (_AROUND_M[:1], _AROUND_M):  # most targets lie free
        place_m = target_enu_m + offset_m
        free = city.is_free(place_m, margin_m) & np.all(place_m >= margins_m, axis=1)
        free &= np.all(place_m <= city.size_m - margin_m, axis=1)
        if free.any():
            return float(np.linalg.norm(offset_m[free.argmax()]))
    return None


def unhealthy(state: VehicleState) -> list[str]:
    """Return what of the vehicle's own health stands against a flight."""
    reasons: list[str] = []
    if state.system_status >= SystemStatus.CRITICAL:
        reasons.append(f"the autopilot is in a failsafe ({state.system_status.name})")
    elif not state.armed and not state.ready_to_arm:
        words = "the autopilot's own pre-arm checks do not pass"
        if state.mode_name == "OFFBOARD":  # PX4 is back in the mode in which it was flown and left
            words += ": OFFBOARD wants a stream; select another mode, Hold for example"
        reasons.append(words)
    if state.battery_fraction is not None and state.battery_fraction < BATTERY_ENGAGE:
        reasons.append(f"battery at {100 * state.battery_fraction:.0f} %")
    return reasons


def untimely(rate_hz: float, oldest_s: float) -> str:
    """Return why the position comes too seldom or too late to fly by."""
    if rate_hz < POSITION_MIN_HZ:
        return f"the position comes {rate_hz:.1f} times a second; {POSITION_MIN_HZ:g} are needed"
    if oldest_s > POSITION_STALE_SOFT_S:
        return f"the position was {oldest_s:.2f} s old; the loop holds from {POSITION_STALE_SOFT_S}"
    return ""


def _obstacle_at(city: Map, position_enu_m: FloatArray) -> str:
    for name, footprint_m, height_m in zip(
        city.obstacle_names, city.footprints_m, city.heights_m, strict=True
    ):
        if Obstacles([footprint_m], [float(height_m)]).contains(position_enu_m):
            return f"obstacle {name}"
    return "an obstacle"


def words(position_enu_m: FloatArray) -> str:
    """Return a map position for people."""
    east_m, north_m, up_m = position_enu_m
    return f"({east_m:.1f}, {north_m:.1f}, {up_m:.1f})"
