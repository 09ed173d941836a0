"""The autopilot's clock on ours: when a message was made, not when it was read."""

_WINDOW_S = 1.5
"""Two of these are looked back: time for a quick packet, and too little for clocks to part. (A
simulator on a busy computer loses 3 % on the wall clock; two crystals part by 0.01 %.)"""


class BootClock:
    """Learns from every time stamp. The packet that came quickest tells how the clocks stand.

    All others were longer on their way, or lay about until they were read. What even the quickest
    takes cannot be told from here and stays in.
    """

    def __init__(self) -> None:
        self._least_s: list[float] = []
        """How far the autopilot's clock is behind, at least: in this window, and in the last."""
        self._window_ends_s = 0.0

    def forget(self) -> None:
        """Begin anew: the autopilot has rebooted."""
        self._least_s = []

    def hear(self, boot_ms: int, arrival_s: float) -> None:
        """Take in a time stamp.

        Args:
            boot_ms: Since boot, by the autopilot's clock.
            arrival_s: When it came, on our clock; not earlier than it did.
        """
        behind_s = arrival_s - 1e-3 * boot_ms
        if not self._least_s or arrival_s >= self._window_ends_s:
            self._least_s = [behind_s, *self._least_s[:1]]
            self._window_ends_s = arrival_s + _WINDOW_S
        self._least_s[0] = min(self._least_s[0], behind_s)

    def time_s(self, boot_ms: int) -> float | None:
        """Return a time of the autopilot's clock on ours; ``None`` before anything was heard."""
        return min(self._least_s) + 1e-3 * boot_ms if self._least_s else None
