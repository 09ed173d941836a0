"""How quickly the vehicle really follows: its velocity lag, from what was sent and what it did.

A row of models is sent the same velocities as the vehicle: first-order lags with a limit on the
acceleration. The one whose motion explains most of the measured velocity, but for a gain (PX4 falls
short of what it is told for seconds), tells the lag. Whatever else delays the answer counts in: the
link, lost packets, the age of the measurement. Gusts wander for seconds and would drown all that;
so it is not velocities that are compared, but what is new in them, and only after a marked change
of what was sent: in between the policy answers gusts, and its answers would pass for their cause.
"""

import math
from dataclasses import dataclass

import numpy as np

from companion.arrays import FloatArray

LAGS_S: FloatArray = np.geomspace(0.1, 4.0, 16)
"""Of the models; neighbours are 28 % apart."""
ACCELERATIONS_MPS2 = (1.6, 2.5, 4.0)
"""Of the models, each with every lag: ArduCopter's and PX4's as recorded, and that of training."""
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
_LONGEST_STEP_S = 0.3
"""After a longer silence the vehicle has done what no model knows: they begin where it is."""


@dataclass(frozen=True, slots=True)
class Lag:
    """A velocity lag, as far as it is known."""

    likely_s: float
    least_s: float
    """It is hardly less; 0.1 s, the least there is, until the vehicle has changed its velocity."""


class LagMeter:
    """Watches one vehicle; told every velocity that is sent, and what is measured at that time."""

    def __init__(self) -> None:
        count = len(_SLOW_S)
        self._model_mps: FloatArray = np.zeros((count, 3))
        self._velocity_mps: FloatArray = np.zeros(3)
        self._sent_mps: FloatArray | None = None
        self._last_s = 0.0
        self._samples = 0.0
        self._model2: FloatArray = np.zeros(count)
        self._both: FloatArray = np.zeros(count)
        self._velocity2 = 0.0

    def watch(self, now_s: float, velocity_mps: FloatArray, sent_mps: FloatArray | None) -> None:
        """Take in one tick.

        Args:
            now_s: When.
            velocity_mps: Measured, shape ``(3,)``, finite.
            sent_mps: What is sent in this tick, shape ``(3,)``; ``None`` while the vehicle follows
                somebody else.
        """
        dt_s, obeyed_mps = now_s - self._last_s, self._sent_mps
        before_mps, was_mps = self._model_mps, self._velocity_mps
        self._last_s, self._sent_mps, self._velocity_mps = now_s, sent_mps, velocity_mps
        if obeyed_mps is None or sent_mps is None or not 0.0 < dt_s <= _LONGEST_STEP_S:
            self._model_mps = np.repeat(velocity_mps[None], len(_SLOW_S), axis=0)
            return
        error_mps = obeyed_mps - before_mps
        length_mps = np.sqrt((error_mps * error_mps).sum(axis=1, keepdims=True))
        share = np.minimum(
            -np.expm1(-dt_s / _SLOW_S),
            _MOST_MPS2 * dt_s / np.maximum(length_mps, 1e-9),
        )
        self._model_mps = before_mps + share * error_mps
        if length_mps[_SLUGGISH, 0] < _MARKED_MPS:
            return

        old = math.exp(-dt_s / _NEW_S)
        new_model_mps = self._model_mps - old * before_mps
        new_mps = velocity_mps - old * was_mps
        kept = math.exp(-dt_s / _MEMORY_S)
        self._samples = kept * self._samples + 3.0
        self._model2 = kept * self._model2 + (new_model_mps * new_model_mps).sum(axis=1)
        self._both = kept * self._both + new_model_mps @ new_mps
        self._velocity2 = kept * self._velocity2 + float(new_mps @ new_mps)

    def lag(self) -> Lag:
        """Return what can be said so far."""
        gain = np.clip(self._both / np.maximum(self._model2, 1e-9), *_GAIN)
        left = self._velocity2 - gain * (2.0 * self._both - gain * self._model2)
        best = int(left.argmin())
        variance = max(float(left[best]) / max(self._samples, 1.0), _NOISE_MPS**2)
        possible = left <= left[best] + _SURE * variance
        return Lag(float(_SLOW_S[best, 0]), float(_SLOW_S[possible.argmax(), 0]))
