"""What the shield makes of a wish, asked once for each wish, pose and drift."""

from dataclasses import dataclass

from companion.arrays import FloatArray
from companion.guidance.drift import Drift
from companion.guidance.shield import Shield, ShieldDecision
from companion.guidance.shield_limits import ShieldLimits
from companion.positions import Pose


@dataclass(frozen=True, slots=True)
class _Guarded:
    """A decision and what it was made from."""

    decision: ShieldDecision
    wanted: bytes
    pose: Pose
    drift: Drift
    limits: ShieldLimits


class Guard:
    """Asks one shield, and not twice about the same.

    Args:
        shield: Remembers nothing but its map and what it believes of the vehicle.
    """

    def __init__(self, shield: Shield) -> None:
        self._shield = shield
        self._guarded: _Guarded | None = None

    def check(self, wanted_enu_mps: FloatArray, pose: Pose, drift: Drift) -> ShieldDecision:
        """Return what is to be flown instead of ``wanted_enu_mps``, shape ``(3,)``."""
        known, wanted = self._guarded, wanted_enu_mps.tobytes()
        if (
            known is None
            or pose is not known.pose
            or wanted != known.wanted
            or self._shield.limits is not known.limits
            or not drift.same_as(known.drift)
        ):
            decision = self._shield.check(
                wanted_enu_mps,
                position_enu_m=pose.position_enu_m,
                velocity_now_enu_mps=pose.velocity_enu_mps,
                drift=drift,
            )
            known = _Guarded(decision, wanted, pose, drift, self._shield.limits)
            self._guarded = known
        return known.decision
