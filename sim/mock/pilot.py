"""The person with the transmitter, as PX4 sees them: MANUAL_CONTROL or an RC receiver."""

from collections import deque
from dataclasses import dataclass, field
from itertools import pairwise

TAKEOVER_SAMPLES = 4
TAKEOVER_SHARE = 0.8
"""Measured: 0 to 0.9 within 1 s takes over at MAN_OVERRIDE_SPD 1.0, within 2 s it does not."""


@dataclass(frozen=True, slots=True)
class Sticks:
    """Stick positions in [-1, 1]: pitch forward, roll right, throttle up, yaw clockwise."""

    forward: float = 0.0
    right: float = 0.0
    up: float = 0.0
    turn: float = 0.0

    @property
    def centred(self) -> bool:
        """Whether the vehicle is to stay where it is."""
        return self.forward == self.right == self.up == 0.0


@dataclass(slots=True)
class Pilot:
    """Whether manual control is there, and what it says."""

    radio: bool = False
    """An RC receiver that never sleeps: present without any MANUAL_CONTROL message."""
    sticks: Sticks = field(default_factory=Sticks)
    _seen_s: float | None = None
    _recent: deque[tuple[float, Sticks]] = field(
        default_factory=lambda: deque(maxlen=TAKEOVER_SAMPLES)
    )

    @property
    def moves(self) -> bool:
        """Whether enough is known of the sticks to see a movement."""
        return len(self._recent) == TAKEOVER_SAMPLES

    def move(self, now_s: float, sticks: Sticks) -> None:
        """Take in one sample of a joystick."""
        self._seen_s = now_s
        self.sticks = sticks
        self._recent.append((now_s, sticks))

    def present(self, now_s: float, timeout_s: float) -> bool:
        """Return whether manual control is there; ``timeout_s`` is COM_RC_LOSS_T."""
        return self.radio or (self._seen_s is not None and now_s - self._seen_s <= timeout_s)

    def grabs_sticks(self, threshold_per_s: float) -> bool:
        """Return whether a stick moves fast and steadily enough to take over.

        Args:
            threshold_per_s: MAN_OVERRIDE_SPD; negative switches it off.
        """
        if threshold_per_s < 0.0 or not self.moves:
            return False
        elapsed_s = self._recent[-1][0] - self._recent[0][0]
        if elapsed_s <= 0.0:
            return False
        for axis in ("forward", "right", "up", "turn"):
            values = [float(getattr(sticks, axis)) for _, sticks in self._recent]
            steps = [b - a for a, b in pairwise(values)]
            steady = all(step > 0.0 for step in steps) or all(step < 0.0 for step in steps)
            if steady and abs(sum(steps)) / elapsed_s > TAKEOVER_SHARE * threshold_per_s:
                self._recent.clear()  # one movement takes over once
                return True
        return False
