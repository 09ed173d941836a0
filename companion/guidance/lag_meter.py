"""How quickly the vehicle really follows: its velocity lag, from what was sent and what it did.

A row of models is sent the same velocities as the vehicle: first-order lags with a limit on the
acceleration. The one whose motion explains most of the measured velocity, but for a gain (PX4 falls
short of what it is told for seconds), tells the lag. Whatever else delays the answer counts in: the
link, and lost packets. Gusts wander for seconds and would drown all that; so it is not velocities
that are compared, but what is new in them, and only after a marked change of what was sent: in
between the policy answers gusts, and its answers would pass for their cause.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from companion.arrays import FloatArray

LAGS_S: FloatArray = np.geomspace(0.1, 4.0, 16)
"""Of the models; neighbours are 28 % apart."""
ACCELERATIONS_MPS2 = (1.6, 2.5, 4.0)
"""Of the models, each with every lag: ArduCopter's and PX4's as recorded, training's briskest."""
_SLOW_S = np.repeat(LAGS_S, len(ACCELERATIONS_MPS2))[:, None]
_MOST_MPS2 = np.tile(ACCELERATIONS_MPS2, len(LAGS_S))[:, None]
_SLUGGISH = int(np.searchsorted(LAGS_S, 1.1)) * len(ACCELERATIONS_MPS2)
"""A model that few vehicles are slower than: of 1.2 s and 1.6 m/s2."""
_MARKED_MPS = 1.0
"""While it has not come nearer to what is sent, the vehicle tells something."""
_GAIN = (0.6, 1.05)
_NEW_S = 0.5
"""What is left of a velocity after so long, but for 1/e, is new."""
_MEMORY_S = 20.0
"""What was seen so long ago, of what tells something, counts 1/e."""
_SURE = 10.0
"""A lag is possible if its model leaves no more unexplained than the best, and this many times the
variance of one sample. Were the rest independent noise, 4 would be two standard deviations; gusts
are not. Chosen on flights over validation cities: see the benchmark results."""
_NOISE_MPS = 0.02
"""No measurement is better, and no vehicle is a model."""
_MOST_SENT = 64
"""Velocities between two measurements; where more were sent, the oldest are of no use."""
_LONGEST_STEP_S = 0.3
"""After a longer silence the vehicle has done what no model knows: they begin where it is."""


@dataclass(frozen=True, slots=True)
class Lag:
    """A velocity lag, as far as it is known."""

    likely_s: float
    least_s: float
    """It is hardly less; 0.1 s, the least there is, until the vehicle has changed its velocity."""


class LagMeter:
    """Watches one vehicle; told every velocity that is sent, and every one that is measured.

    Both by the time at which they were: a tick that comes late sends late, and a position that
    was long on its way is of long ago. Neither is a lag of the vehicle.
    """

    def __init__(self) -> None:
        count = len(_SLOW_S)
        self._model_mps: FloatArray = np.zeros((count, 3))
        self._velocity_mps: FloatArray = np.zeros(3)
        self._obeyed_mps: FloatArray | None = None
        self._sent: deque[tuple[float, FloatArray | None]] = deque(maxlen=_MOST_SENT)
        self._last_s = -math.inf
        self._samples = 0.0
        self._model2: FloatArray = np.zeros(count)
        self._both: FloatArray = np.zeros(count)
        self._velocity2 = 0.0

    def sent(self, now_s: float, velocity_mps: FloatArray | None) -> None:
        """Take down what is sent.

        Args:
            now_s: When.
            velocity_mps: Shape ``(3,)``; ``None`` while the vehicle follows somebody else.
        """
        self._sent.append((now_s, velocity_mps))

    def measured(self, time_s: float, velocity_mps: FloatArray) -> None:
        """Compare the vehicle with the models.

        Args:
            time_s: Of the measurement; one that is no newer than the last says nothing.
            velocity_mps: Shape ``(3,)``, finite.
        """
        dt_s, before_mps, was_mps = time_s - self._last_s, self._model_mps, self._velocity_mps
        if dt_s <= 0.0:
            return
        model_mps, far_mps = self._follow(time_s) if dt_s <= _LONGEST_STEP_S else (None, 0.0)
        self._last_s, self._velocity_mps = time_s, velocity_mps
        if model_mps is None:
            self._forget_until(time_s)
            self._model_mps = np.repeat(velocity_mps[None], len(_SLOW_S), axis=0)
            return
        self._model_mps = model_mps
        if far_mps < _MARKED_MPS:
            return

        old = math.exp(-dt_s / _NEW_S)
        new_model_mps = model_mps - old * before_mps
        new_mps = velocity_mps - old * was_mps
        kept = math.exp(-dt_s / _MEMORY_S)
        self._samples = kept * self._samples + 3.0
        self._model2 = kept * self._model2 + (new_model_mps * new_model_mps).sum(axis=1)
        self._both = kept * self._both + new_model_mps @ new_mps
        self._velocity2 = kept * self._velocity2 + float(new_mps @ new_mps)

    def _follow(self, until_s: float) -> tuple[FloatArray | None, float]:
        """Let the models follow what was sent before ``until_s``, from the last measurement on.

        Returns:
            Their velocities, ``None`` if the vehicle followed somebody else at any time, and how
            far the sluggish one was from what was sent.
        """
        model_mps, from_s, far_mps = self._model_mps, self._last_s, 0.0
        if self._sent and self._sent[-1][1] is None:
            return None, 0.0
        while from_s < until_s:
            to_s = until_s
            if self._sent and self._sent[0][0] < until_s:
                to_s = max(from_s, self._sent[0][0])
            if self._obeyed_mps is None and to_s > from_s:
                return None, 0.0
            if self._obeyed_mps is not None and to_s > from_s:
                error_mps = self._obeyed_mps - model_mps
                length_mps = np.sqrt((error_mps * error_mps).sum(axis=1, keepdims=True))
                share = np.minimum(
                    -np.expm1((from_s - to_s) / _SLOW_S),
                    _MOST_MPS2 * (to_s - from_s) / np.maximum(length_mps, 1e-9),
                )
                model_mps = model_mps + share * error_mps
                far_mps = max(far_mps, float(length_mps[_SLUGGISH, 0]))
            if to_s < until_s:
                self._obeyed_mps = self._sent.popleft()[1]
            from_s = to_s
        return model_mps, far_mps

    def _forget_until(self, time_s: float) -> None:
        while self._sent and self._sent[0][0] < time_s:
            self._obeyed_mps = self._sent.popleft()[1]

    def lag(self) -> Lag:
        """Return what can be said so far."""
        gain = np.clip(self._both / np.maximum(self._model2, 1e-9), *_GAIN)
        left = self._velocity2 - gain * (2.0 * self._both - gain * self._model2)
        best = int(left.argmin())
        variance = max(float(left[best]) / max(self._samples, 1.0), _NOISE_MPS**2)
        possible = left <= left[best] + _SURE * variance
        return Lag(float(_SLOW_S[best, 0]), float(_SLOW_S[possible.argmax(), 0]))
