"""The battery."""

from dataclasses import dataclass

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
