"""What keeps the policy from flying for a while: stale, doubtful or contradictory knowledge."""

from companion.guidance.limits import HEARTBEAT_LATE_S, OFF_MAP_M, POSITION_STALE_SOFT_S
from companion.guidance.reasons import Reason
from companion.guidance.situation import Situation
from companion.guidance.target import TargetTier
from companion.vehicle import VehicleState


def position_doubt(s: Situation, frame_settled_s: float) -> tuple[Reason, str] | None:
    """Return why nobody can say where on the map the vehicle is; ``None`` if it is known.

    Args:
        s: What is known.
        frame_settled_s: Until when a local frame that has moved is still looked at.
    """
    v = s.vehicle
    if v is None or s.now_s - v.time_s > POSITION_STALE_SOFT_S:
        return Reason.POSITION_LATE, "position is late"
    if not v.position_valid:
        return Reason.POSITION_INVALID, "the estimator does not vouch for the position"
    if s.position_frozen:
        return Reason.POSITION_FROZEN, "the position does not change while the vehicle moves"
    if s.now_s < frame_settled_s:
        return Reason.FRAME_MOVED, "the local frame has moved"
    if s.frame_untied:
        return Reason.FRAME_UNTIED, s.frame_untied
    if s.off_map_m > OFF_MAP_M:
        return Reason.OUTSIDE_MAP, f"the vehicle is {s.off_map_m:.0f} m outside the map"
    return None


def why_hold(s: Situation, doubt: tuple[Reason, str] | None) -> tuple[Reason, str] | None:
    """Return why the policy may not fly in this tick, the gravest reason first.

    Args:
        s: What is known.
        doubt: Of ``position_doubt``.
    """
    v = s.vehicle
    if doubt is not None:
        return doubt
    if v is None or s.now_s - v.heartbeat_time_s > HEARTBEAT_LATE_S:
        return Reason.HEARTBEAT_LATE, "no heartbeat: it is not known who has the vehicle"
    if s.target_off_map_m > OFF_MAP_M:
        words = f"the target is {s.target_off_map_m:.0f} m outside the map"
        return Reason.TARGET_OUTSIDE, words
    if s.waiting_for:
        return Reason.FRAME_UNTIED, s.waiting_for
    if s.target in (TargetTier.NONE, TargetTier.HOLD, TargetTier.LOST):
        return Reason.TARGET_SILENT, "the target is silent"
    if s.policy_failures:
        return Reason.POLICY_UNUSABLE, "the policy's output is not usable"
    return None


def battery_below(v: VehicleState, share: float) -> bool:
    """Return whether the battery is known to hold less than ``share`` of 1."""
    return v.battery_fraction is not None and v.battery_fraction < share


def battery_words(v: VehicleState) -> str:
    """Return the battery's state for people."""
    return f"battery at {100 * (v.battery_fraction or 0.0):.0f} %"
