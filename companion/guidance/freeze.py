"""A position that stands still to the last bit while the vehicle moves: nobody measures it.

A bridge that repeats its last message with new times, or an estimator that hangs, looks fresh by
every age. No estimator in flight gives the same numbers twice.
"""

import math

from companion.arrays import FloatArray

MOVING_MPS = 0.3
FROZEN_S = 0.5
"""The same position for so long, at a reported speed, is none; as old as ``POSITION_STALE_HARD_S``
allows. Twice as long if only we ask for a speed: the vehicle may take its time."""


class FreezeDetector:
    """Looks at every tick's position; once frozen, it stays so until the position changes."""

    def __init__(self) -> None:
        self._position: list[float] = []
        self._changed_s = 0.0
        self._asked_since_s: float | None = None
        self._frozen = False

    def look(
        self,
        position_ned_m: FloatArray,
        velocity_ned_mps: FloatArray,
        *,
        time_s: float,
        commanded_mps: float,
    ) -> bool:
        """Return whether the position is frozen.

        Args:
            position_ned_m: As it came, shape ``(3,)``.
            velocity_ned_mps: The same, shape ``(3,)``.
            time_s: Arrival of the position.
            commanded_mps: Speed of the newest setpoint, 0 where there is none.
        """
        position = position_ned_m.tolist()
        if position != self._position:
            self._position, self._changed_s = position, time_s
            self._asked_since_s, self._frozen = None, False
            return False
        if commanded_mps <= MOVING_MPS:
            self._asked_since_s = None
        elif self._asked_since_s is None:
            self._asked_since_s = time_s
        if math.hypot(*velocity_ned_mps.tolist()) > MOVING_MPS:
            self._frozen |= time_s - self._changed_s >= FROZEN_S
        if self._asked_since_s is not None:
            self._frozen |= time_s - self._asked_since_s >= 2.0 * FROZEN_S
        return self._frozen
