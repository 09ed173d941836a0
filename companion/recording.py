"""What the flying process says of itself to the session: one turn of the loop, its actor."""

import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version

from companion.arrays import Float32Array, FloatArray
from companion.guidance.drift import Drift
from companion.guidance.guidance import Proposal
from companion.guidance.shield import ShieldDecision
from companion.guidance.situation import Directive, Situation
from companion.guidance.target import TargetEstimate
from companion.policy.actor import Actor
from companion.positions import Pose
from companion.session.records import ActorRecord, Tick

_PACKAGES = ("mavlink-companion", "numpy", "onnxruntime", "pymavlink", "shapely")


def tick_record(
    *,
    start_s: float,
    situation: Situation,
    directive: Directive,
    pose: Pose | None,
    target: TargetEstimate,
    proposal: Proposal | None,
    decision: ShieldDecision | None,
    sent_enu_mps: FloatArray | None,
    latency_ms: float | None,
    lateness_ms: float,
    rates_hz: Mapping[str, float] | None,
    speed_cap_mps: float | None,
    drift: Drift,
) -> Tick:
    """Return the record of one turn; times are relative to ``start_s``."""
    state, now_s = situation.vehicle, situation.now_s
    return Tick(
        time_s=now_s - start_s,
        position_enu_m=_list(None if pose is None else pose.position_enu_m),
        velocity_enu_mps=_list(None if pose is None else pose.velocity_enu_mps),
        attitude_rad=_list(None if state is None else state.attitude_rad),
        target_enu_m=_list(target.position_enu_m),
        target_velocity_enu_mps=_list(target.velocity_enu_mps),
        target_tier=target.tier,
        observation=_list(None if proposal is None else proposal.observation),
        action=_list(None if proposal is None else proposal.action),
        spherical=None if proposal is None else list(proposal.spherical),
        proposed_enu_mps=_list(None if proposal is None else proposal.velocity_enu_mps),
        safe_enu_mps=_list(sent_enu_mps),
        clearance_m=None if decision is None else decision.clearance_m,
        distance_m=situation.distance_m,
        shield_reason="" if decision is None else decision.reason,
        intervened=decision is not None and decision.intervened,
        supervisor=directive.phase,
        mode="" if state is None else state.mode_name,
        armed=state is not None and state.armed,
        battery_fraction=None if state is None else state.battery_fraction,
        link_age_s=None if state is None else now_s - state.heartbeat_time_s,
        position_age_s=None if state is None else now_s - state.time_s,
        target_age_s=None if target.position_enu_m is None else target.age_s,
        latency_ms=latency_ms,
        lateness_ms=lateness_ms,
        rates_hz=rates_hz,
        speed_cap_mps=speed_cap_mps,
        drift_enu_mps=_list(drift.velocity_enu_mps) if drift.velocity_enu_mps.any() else None,
        gust_mps=drift.gust_mps,
    )


def actor_record(actor: Actor) -> ActorRecord:
    """Return what a session says of its actor."""
    contract = actor.contract
    return ActorRecord(
        name=actor.name,
        sha256=actor.sha256,
        layout=contract.layout.name,
        columns=list(contract.layout.columns),
        detail={"preset": contract.preset, "stage": contract.stage, "seed": contract.seed},
    )


def made_by() -> str:
    """Return the versions that the arithmetic of a flight depends on."""
    packages = ", ".join(f"{name} {_version(name)}" for name in _PACKAGES)
    return f"{packages}, Python {platform.python_version()}, {platform.machine()}"


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:  # run from a checkout that is not installed
        return "(unknown)"


def _list(values: FloatArray | Float32Array | None) -> list[float] | None:
    return None if values is None else values.tolist()
