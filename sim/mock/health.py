"""Things PX4 keeps an eye on: the battery and the companion computer."""

from dataclasses import dataclass

COMPANION_TIMEOUT_S = 5.0
"""Fixed since PX4 1.18."""
CELLS = 4


@dataclass(slots=True)
class Battery:
    """A four-cell pack that drains linearly while armed."""

    fraction: float = 1.0
    drain_per_s: float = 1.0 / 1200.0
    _low: bool = False

    @property
    def voltage_v(self) -> float:
        """Return the pack voltage."""
        return CELLS * (3.5 + 0.55 * self.fraction)

    def use(self, duration_s: float, low_fraction: float) -> bool:
        """Drain the pack for ``duration_s`` and return whether it has just become low."""
        self.fraction = max(0.0, self.fraction - self.drain_per_s * duration_s)
        was_low, self._low = self._low, self.fraction < low_fraction
        return self._low and not was_low


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
