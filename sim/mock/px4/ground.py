"""What PX4 notices by itself about the ground: take-off and landing."""

from dataclasses import dataclass

RAMP_S = 1.0
"""Between the end of the spool-up and "Takeoff detected", and again until the skids lift."""
LAND_DETECTION_S = 3.1
"""On the ground this long with a demand to sink: landed (recorded: 2.5 to 4.5 s)."""


@dataclass(slots=True)
class Ground:
    """The land detector."""

    landed: bool = True
    flown: bool = False
    """Whether the vehicle has left the ground since it was armed."""
    _ready_s: float = 0.0
    _lift_s: float | None = None
    _touch_s: float | None = None
    _standing_since_s: float = 0.0

    def arm(self, now_s: float, spool_up_s: float) -> None:
        """Start afresh; the motors need ``spool_up_s`` (COM_SPOOLUP_TIME)."""
        self.flown = False
        self._lift_s = self._touch_s = None
        self._ready_s = now_s + spool_up_s + RAMP_S
        self._standing_since_s = now_s + spool_up_s

    def airborne(self, now_s: float) -> bool:
        """Return whether the motors carry the vehicle."""
        return self._lift_s is not None and now_s >= self._lift_s

    def standing_s(self, now_s: float) -> float:
        """Return for how long it has stood since it was armed or has landed."""
        return now_s - self._standing_since_s

    def update(
        self, now_s: float, *, touching: bool, wants_up: bool, wants_down: bool
    ) -> str | None:
        """Look at one step of an armed vehicle.

        Args:
            now_s: Time.
            touching: Whether the skids are on the ground.
            wants_up: Whether the mode wants to leave the ground.
            wants_down: Whether the mode wants to sink.

        Returns:
            What PX4 says about it, if anything.
        """
        if self.landed:
            if not wants_up or now_s < self._ready_s:
                return None
            self.landed = False
            self.flown = True
            self._lift_s = now_s + RAMP_S
            return "Takeoff detected"
        if not (touching and wants_down and self.airborne(now_s)):
            self._touch_s = None
            return None
        self._touch_s = now_s if self._touch_s is None else self._touch_s
        if now_s - self._touch_s < LAND_DETECTION_S:
            return None
        self.landed = True
        self._lift_s = self._touch_s = None
        self._standing_since_s = now_s
        return "Landing detected"
