"""The transmitter as ArduCopter hears it through RC_CHANNELS_OVERRIDE from its ground station.

Only SYSID_MYGCS may override. What it does not say again within RC_OVERRIDE_TIME is forgotten:
the sticks are centred then, and the mode switch stays where it was.
"""

import math
from dataclasses import dataclass, field

from sim.mock.parameters import Parameters
from sim.mock.pilot import Sticks

CENTRE, REACH = 1500, 500
DEAD_ZONE = 20
IGNORED, RELEASED = 65535, 0
"""Values that leave a channel as it is, or give it back to the transmitter."""
FAILSAFE_PULSE = 975
"""FS_THR_VALUE: a throttle below it means that the transmitter is lost."""
SWITCH_ENDS = (1230, 1360, 1490, 1620, 1749)
"""The last pulse of each position of the mode switch but the sixth."""
FIRST_POSITION = 6


@dataclass(slots=True)
class Radio:
    """The newest pulse of every channel, and where the mode switch is."""

    parameters: Parameters
    position: int = FIRST_POSITION
    _pulses: dict[int, int] = field(default_factory=dict)
    _heard_s: float = -math.inf

    def override(self, now_s: float, pulses: dict[int, int]) -> None:
        """Take in one message, its pulses by channel, counted from 1."""
        self._heard_s = now_s
        for channel, pulse in pulses.items():
            if pulse == RELEASED:
                self._pulses.pop(channel, None)
            elif pulse != IGNORED:
                self._pulses[channel] = pulse

    def expire(self, now_s: float) -> bool:
        """Forget old pulses; return whether there were any."""
        timeout_s = self.parameters.number("RC_OVERRIDE_TIME")
        # A negative time never ends; zero switches overrides off.
        if not self._pulses or timeout_s < 0.0 or now_s - self._heard_s <= timeout_s:
            return False
        self._pulses.clear()
        return True

    @property
    def sticks(self) -> Sticks:
        """Where the sticks are; pitch counts backward in pulses."""
        roll, pitch, throttle, yaw = (self._axis(channel) for channel in range(1, 5))
        return Sticks(forward=-pitch, right=roll, up=throttle, turn=yaw)

    @property
    def throttle_lost(self) -> bool:
        """Whether the throttle says that the transmitter is lost."""
        return self._pulses.get(3, CENTRE) < FAILSAFE_PULSE

    def moved_switch(self) -> int | None:
        """Return the mode that a movement of the switch chooses, ``None`` if it did not move."""
        pulse = self._pulses.get(int(self.parameters.number("FLTMODE_CH")))
        if pulse is None:
            return None
        position = 1 + sum(pulse > end for end in SWITCH_ENDS)
        moved, self.position = position != self.position, position
        return int(self.parameters.number(f"FLTMODE{position}")) if moved else None

    def _axis(self, channel: int) -> float:
        off = self._pulses.get(channel, CENTRE) - CENTRE
        return 0.0 if abs(off) <= DEAD_ZONE else max(-1.0, min(1.0, off / REACH))
