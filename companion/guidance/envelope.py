"""Where flight leaves what the actor has seen in training, it goes slower, and says why.

The contract of an actor holds how fast its vehicles were, between how narrow walls, how far they
saw, and how much their velocity lagged. Beyond one of these nobody has proven anything, and the
speed cap falls in proportion: through a gap of half the least width at half the speed, with twice
the lag at half the speed. It makes an actor no better. It leaves the shield, the pilot and whoever
reads the log more time.
"""

import math
from dataclasses import dataclass

import numpy as np

from companion.arrays import Float32Array, FloatArray
from companion.guidance.lag_meter import LAGS_S, LagMeter
from companion.policy.contract import Contract
from companion.policy.measures import MEASURES, measures

TOLERANCE = 1.1
"""So much beyond a bound is outside."""
SLOWEST_MPS = 1.0
"""The cap falls no lower: who stands still never leaves what he does not know."""
LONGEST_LAG_S = 3.0
"""The longest that is told to the shield."""
LOOK_S = 0.2
"""Between two looks at the observation."""


@dataclass(frozen=True, slots=True)
class Pace:
    """When and how quickly the cap follows what is seen."""

    enter_s: float = 0.5
    """So long something must have been beyond its bound by ``TOLERANCE``,"""
    lag_enter_s: float = 2.0
    """a velocity lag for so long: what is measured of one goes beyond for a moment after a gust,"""
    leave_s: float = 2.0
    """and then so long within."""
    fall_s: float = 0.5
    """Time constant of the cap on its way down,"""
    recover_s: float = 4.0
    """and on its way up."""


class _Bound:
    """One quantity, the bound that training has put on it, and on which side of it flight is."""

    def __init__(
        self, name: str, unit: str, bound: float, *, below: bool, enter_s: float, leave_s: float
    ) -> None:
        self.name = name
        self._unit, self._bound, self._below = unit, bound, below
        self._enter_s, self._leave_s = enter_s, leave_s
        self._since_s: float | None = None
        self.outside = False
        self.share = 1.0
        """Of the speed that goes with what is seen; less than 1 beyond the bound."""
        self.value = 0.0

    def look(self, now_s: float, likely: float, surely: float) -> None:
        """Compare with what is seen.

        Args:
            now_s: When.
            likely: The quantity.
            surely: The same, as near to the bound as it may be.
        """
        self.value, self.share = likely, min(1.0, self._share(likely))
        beyond = self.share < 1.0 if self.outside else TOLERANCE * self._share(surely) < 1.0
        if beyond == self.outside:
            self._since_s = None
        elif self._since_s is None:
            self._since_s = now_s
        if self._since_s is None:
            return
        if now_s - self._since_s >= (self._leave_s if self.outside else self._enter_s):
            self.outside, self._since_s = beyond, None

    def words(self) -> str:
        """Return what is outside of what."""
        side = "no less than" if self._below else "no more than"
        value, bound = f"{self.value:.2g} {self._unit}", f"{self._bound:.2g} {self._unit}"
        return f"{self.name} {value} ({side} {bound} in training)"

    def _share(self, value: float) -> float:
        least, most = (value, self._bound) if self._below else (self._bound, value)
        return least / max(most, 1e-9)


class Envelope:
    """The speed cap of one flight, as far as it comes from what training has shown the actor.

    Args:
        contract: Of the actor.
        v_max_mps: The cap of the flight.
        pace: How quickly it falls and recovers.
    """

    def __init__(self, contract: Contract, v_max_mps: float, pace: Pace | None = None) -> None:
        self._pace = Pace() if pace is None else pace
        self._v_max_mps, self._layout = v_max_mps, contract.layout
        self._bounds: dict[str, _Bound] = {}
        enter_s, leave_s = self._pace.enter_s, self._pace.leave_s
        seen = {} if contract.seen is None else contract.seen.measures
        for name, unit in MEASURES.items():
            if name in seen:
                low, high = seen[name]
                below = name != "speed"
                bound = low if below else high
                self._bounds[name] = _Bound(
                    name, unit, bound, below=below, enter_s=enter_s, leave_s=leave_s
                )
        self._lag_bound: _Bound | None = None
        if contract.dynamics.velocity_lag_s is not None:
            longest_s = contract.dynamics.velocity_lag_s[1]
            enter_s = self._pace.lag_enter_s
            self._lag_bound = _Bound(
                "velocity lag", "s", longest_s, below=False, enter_s=enter_s, leave_s=leave_s
            )
        self._meter = LagMeter()
        self.lag = self._meter.lag()
        """Of the velocity, as measured so far."""
        self._share = 1.0
        self._looked_s: float | None = None
        self._said: frozenset[str] = frozenset()

    def longer_lag_s(self, believed_s: float) -> float | None:
        """Return the velocity lag, if it is surely longer than is believed; else ``None``.

        Rounded up, and no longer than ``LONGEST_LAG_S``: of one that lags more nothing is safe.
        """
        if self.lag.least_s <= TOLERANCE * believed_s:
            return None
        longer_s = min(math.ceil(10.0 * self.lag.likely_s) / 10.0, LONGEST_LAG_S)
        return longer_s if longer_s > believed_s else None

    @property
    def cap_mps(self) -> float | None:
        """The speed cap; ``None`` while all is as in training."""
        if self._share == 1.0:
            return None
        return max(self._share * self._v_max_mps, min(SLOWEST_MPS, self._v_max_mps))

    @property
    def known_lag_s(self) -> float | None:
        """The velocity lag as it was measured; ``None`` before the vehicle has told."""
        return self.lag.likely_s if self.lag.least_s > LAGS_S[0] else None

    def limited(self, velocity_mps: FloatArray) -> FloatArray:
        """Return a velocity within the cap, ``(3,)``: shortened, not turned."""
        cap_mps = self.cap_mps
        if cap_mps is None:
            return velocity_mps
        speed_mps = math.sqrt(float(velocity_mps @ velocity_mps))
        # NaN is for the shield.
        return velocity_mps * (cap_mps / speed_mps) if speed_mps > cap_mps else velocity_mps

    def watch(
        self,
        now_s: float,
        velocity_mps: FloatArray,
        sent_mps: FloatArray | None,
        observation: Float32Array | None,
        *,
        measured_s: float | None = None,
    ) -> str:
        """Take in one tick, after its setpoint has left.

        Args:
            now_s: When.
            velocity_mps: Measured, map ENU, shape ``(3,)``.
            sent_mps: What was sent, map ENU, shape ``(3,)``; ``None`` while the vehicle follows
                somebody else.
            observation: What the actor saw, while it flies.
            measured_s: When the velocity was measured; now, if not given.

        Returns:
            What is to be said, if it is new: what is outside, or that nothing is any more.
        """
        self._meter.sent(now_s, sent_mps)
        if not np.isfinite(velocity_mps).all():
            return ""
        self._meter.measured(now_s if measured_s is None else measured_s, velocity_mps)
        if observation is None or not np.isfinite(observation).all():
            self._looked_s = None
            return ""
        if self._looked_s is None or now_s < self._looked_s:
            self._looked_s = now_s
        if now_s - self._looked_s < LOOK_S:
            return ""
        dt_s, self._looked_s = now_s - self._looked_s, now_s
        self._look(now_s, observation)
        self._follow(dt_s)
        return self._news()

    def _look(self, now_s: float, observation: Float32Array) -> None:
        for name, value in measures(self._layout, observation).items():
            if name in self._bounds:
                self._bounds[name].look(now_s, float(value), float(value))
        self.lag = self._meter.lag()
        if self._lag_bound is not None:
            self._lag_bound.look(now_s, self.lag.likely_s, self.lag.least_s)

    def _follow(self, dt_s: float) -> None:
        """Let the cap go where it should be."""
        wanted = 1.0
        for bound in self._outside():
            # The cap itself changes the speed: it falls until that is as in training.
            share = self._share * bound.share if bound.name == "speed" else bound.share
            # What has just come within its bound is not trusted yet: the cap waits.
            wanted = min(wanted, share if bound.share < 1.0 else self._share)
        slow_s = self._pace.fall_s if wanted < self._share else self._pace.recover_s
        self._share += (wanted - self._share) * -math.expm1(-dt_s / slow_s)
        self._share = max(self._share, min(1.0, SLOWEST_MPS / self._v_max_mps))
        if wanted == 1.0 and self._share > 0.99:
            self._share = 1.0

    def _outside(self) -> list[_Bound]:
        bounds = [*self._bounds.values(), *([] if self._lag_bound is None else [self._lag_bound])]
        return [bound for bound in bounds if bound.outside]

    def _news(self) -> str:
        outside = self._outside()
        names = frozenset(bound.name for bound in outside)
        if self._share == 1.0 and self._said:
            self._said = frozenset()
            return "as in training again: the speed cap is lifted"
        if names <= self._said:  # nothing new; what comes and goes is not said in turns
            return ""
        self._said |= names
        words = ", ".join(bound.words() for bound in outside)
        return f"not as in training: {words}; the speed cap falls"
