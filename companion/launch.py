"""What a flight and its replay have in common: from the options to the summary of the loop."""

import contextlib
import logging
from collections.abc import Callable

from companion.config import V_MAX_LOW_MPS, RunConfig
from companion.control import Flight, Mission
from companion.errors import LinkLostError, RefusedError
from companion.guidance.failsafe import SpeedCap, failsafe_of, parameters_wanted
from companion.guidance.reasons import Reason
from companion.guidance.shield import Shield
from companion.guidance.shield_limits import ShieldLimits
from companion.guidance.situation import Outcome, Plan
from companion.link.vehicle import MavlinkVehicle
from companion.policy.actor import Actor
from companion.positions import TargetSource
from companion.preflight import target_problem, target_warning
from companion.session.records import Event, Record
from companion.session.summary import Summary
from companion.vehicle import RequestKind, Severity
from companion.world.maps import Map, load_map

CONNECT_TIMEOUT_S = 10.0
PARAMETERS_TIMEOUT_S = 1.5
THINK_AHEAD_S = 0.002
"""Twice what policy and shield take on a cold cache. Whatever comes later than that, of positions
every 20 to 100 ms, is asked about again when the tick is due: so no sooner than needed."""
_ON_EXIT = {
    "hold": RequestKind.HOLD,
    "land": RequestKind.LAND,
    "rtl": RequestKind.RETURN,
    "none": None,
}
_LOG = logging.getLogger("companion")


def load_files(config: RunConfig) -> tuple[Map, Actor]:
    """Return map and actor, which fit each other and the target.

    Raises:
        CompanionError: If an option makes no sense, a file is wrong, or they do not fit.
    """
    config.check()
    city = load_map(config.map)
    actor = Actor.load(config.actor)
    actor.check_fits(city, config.v_max)
    target_enu_m = config.target_enu_m()
    if target_enu_m is not None:
        problem = target_problem(city, target_enu_m, config.margin)
        if problem:
            raise RefusedError(problem)
        warning = target_warning(city, target_enu_m, config.margin)
        if warning:
            _LOG.warning("%s", warning)
    if city.origin is None and city.launch_enu_m is None:
        raise RefusedError(f"map {city.name} has neither origin nor launch_m: it cannot be flown")
    return city, actor


def target_sysids(config: RunConfig) -> list[int]:
    """Return the systems whose positions are to be heard."""
    return [] if config.target_sysid is None else [config.target_sysid]


def speed_cap(vehicle: MavlinkVehicle, config: RunConfig) -> SpeedCap:
    """Return the speed to fly with, from what the vehicle would do without us; say it once.

    Raises:
        RefusedError: If no speed that is worth flying keeps blind travel within the margin.
    """
    info = vehicle.info
    parameters = vehicle.read_params(parameters_wanted(info.autopilot), PARAMETERS_TIMEOUT_S)
    failsafe = failsafe_of(info.autopilot, parameters, info.version)
    cap = failsafe.cap(config.v_max, config.margin, obey=config.cap_by_failsafe)
    if cap.v_max_mps < V_MAX_LOW_MPS:
        raise RefusedError(f"{cap.words}; too slow to fly: raise --margin or shorten the time-out")
    _LOG.info("%s", failsafe.sentence)
    if failsafe.assumed:
        _LOG.info("not read, defaults assumed: %s", ", ".join(failsafe.assumed))
    _LOG.log(logging.WARNING if cap.exceeds else logging.INFO, "%s", cap.words)
    return cap


def flight_shield(config: RunConfig, city: Map, v_max_mps: float) -> Shield:
    """Return the shield of a flight."""
    limits = ShieldLimits(
        v_max_mps=v_max_mps, margin_m=config.margin, period_s=1.0 / config.rate_hz
    )
    return Shield(city, limits)


def fly(
    vehicle: MavlinkVehicle,
    config: RunConfig,
    city: Map,
    actor: Actor,
    cap: SpeedCap,
    *,
    record: Callable[[Record], None],
    stop_requested: Callable[[], bool],
    start_s: float,
    alive: Callable[[str], None] | None = None,
) -> Summary:
    """Run the loop until it is over; whatever happens in it ends in a summary."""
    info = vehicle.info
    _LOG.info("vehicle %d: %s %s", info.system_id, info.autopilot, info.version)
    if city.origin is None:
        _LOG.warning(
            "map %s has no place on earth: the vehicle's local origin is taken to be at %s m",
            city.name,
            [] if city.launch_enu_m is None else city.launch_enu_m.tolist(),
        )
    severity = Severity.WARNING if cap.exceeds else Severity.INFO
    record(Event(vehicle.now_s() - start_s, severity, "companion", cap.words))
    plan = Plan(
        engage=config.engage,
        arm=config.arm,
        takeoff_m=config.takeoff,
        on_exit=_ON_EXIT[config.on_exit],
        shadow=config.shadow,
        stream_before_external=info.needs_stream_before_external,
    )
    target = TargetSource(config.target_enu_m(), config.target_geodetic(), config.target_sysid)
    flight = Flight(
        vehicle,
        Mission(city, actor, plan, target, cap.v_max_mps, config.rate_hz),
        flight_shield(config, city, cap.v_max_mps),
        record=record,
        stop_requested=stop_requested,
        session_start_s=start_s,
        alive=alive,
        think_ahead_s=THINK_AHEAD_S,
    )
    try:
        return flight.run()
    except LinkLostError as error:
        return flight.finish(Outcome.LINK_LOST, Reason.LINK_FAILED, str(error))
    except KeyboardInterrupt:
        words = "stopped at once by a second signal; left to the autopilot"
        return flight.finish(Outcome.STOPPED, Reason.SIGNAL, words)
    except Exception:
        _LOG.exception("internal error in the control loop; asking the vehicle to hold")
        with contextlib.suppress(LinkLostError):
            flight.abandon()
        words = "internal error in the control loop"
        return flight.finish(Outcome.FAILED, Reason.INTERNAL, words)
