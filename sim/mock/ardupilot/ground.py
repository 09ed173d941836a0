"""What ArduCopter notices by itself about the ground: take-off, landing, motors to be stopped."""

import math
from dataclasses import dataclass

AIRBORNE_S = 2.7
LIFT_S = 2.8
"""From NAV_TAKEOFF until it no longer calls itself landed, and until the skids lift (measured)."""
LANDED_S = 1.55
DISARM_S = 2.08
"""From touching the ground until landed, and until LAND and RTL stop the motors (measured)."""


@dataclass(slots=True)
class Ground:
    """The land detector and the take-off timer."""

    landed: bool = True
    _takeoff_s: float = math.inf
    _touch_s: float | None = None
    _standing_since_s: float = 0.0

    def arm(self, now_s: float) -> None:
        """Start afresh."""
        self._takeoff_s = math.inf
        self._touch_s = None
        self._standing_since_s = now_s

    def take_off(self, now_s: float) -> None:
        """Begin to spool up."""
        self._takeoff_s = now_s

    def cancel_take_off(self) -> None:
        """Forget a take-off that has not left the ground."""
        if self.landed:
            self._takeoff_s = math.inf

    def airborne(self, now_s: float) -> bool:
        """Return whether the motors carry the vehicle."""
        return not self.landed and now_s >= self._takeoff_s + LIFT_S

    def standing_s(self, now_s: float) -> float:
        """Return for how long it has stood since it was armed or has landed."""
        return now_s - self._standing_since_s if self.landed else 0.0

    def touched_s(self, now_s: float) -> float:
        """Return for how long the skids have been on the ground after a flight."""
        return 0.0 if self._touch_s is None else now_s - self._touch_s

    def update(self, now_s: float, *, touching: bool, wants_down: bool) -> None:
        """Look at one step of an armed vehicle.

        Args:
            now_s: Time.
            touching: Whether the skids are on the ground.
            wants_down: Whether the mode wants to sink.
        """
        if self.landed:
            self.landed = now_s < self._takeoff_s + AIRBORNE_S
            return
        if not touching or not self.airborne(now_s):
            self._touch_s = None
            return
        if self._touch_s is None and wants_down:
            self._touch_s = now_s
        if self._touch_s is not None and now_s - self._touch_s >= LANDED_S:
            self.landed = True
            self._takeoff_s = math.inf
            self._standing_since_s = now_s
