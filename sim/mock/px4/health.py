"""What PX4 keeps an eye on besides itself: the companion computer."""

from dataclasses import dataclass

COMPANION_TIMEOUT_S = 5.0
"""Fixed since PX4 1.18."""


@dataclass(slots=True)
class Companion:
    """The onboard controller with our own system id (P14): missed, but never acted upon."""

    _heard_s: float | None = None

    def hear(self, now_s: float) -> None:
        """Note one of its heartbeats."""
        self._heard_s = now_s

    def lost(self, now_s: float) -> bool:
        """Return whether it has just been silent for too long."""
        if self._heard_s is None or now_s - self._heard_s <= COMPANION_TIMEOUT_S:
            return False
        self._heard_s = None
        return True
