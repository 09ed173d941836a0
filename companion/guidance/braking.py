"""How a vehicle follows a velocity command and how it stops: the model behind the shield.

The velocity error keeps its direction and shrinks at ``min(error / lag, brake)``: a first-order
lag with a limit on the acceleration. Under a constant command the velocity therefore stays on the
straight line between where it was and the command, and under a zero command the vehicle stops on
a straight line. Everything here has a closed form.
"""

from dataclasses import dataclass

import numpy as np

from companion.arrays import FloatArray

PACES = (0.0, 0.5, 1.0)
"""How quickly the vehicle may take up a command, from as slowly as the model says to at once."""
_BEHIND = (1.0 - np.array(PACES))[:, None]
_TINY_MPS = 1e-12


@dataclass(frozen=True, slots=True)
class Braking:
    """The slowest response the shield must reckon with."""

    lag_s: float
    """Time constant of the first-order response."""
    brake_mps2: float
    """Largest change of velocity."""

    def stopping_distance_m(self, speed_mps: FloatArray, gust_mps: float = 0.0) -> FloatArray:
        """Return the way from ``speed_mps`` to rest under a zero command, shape as given.

        Args:
            speed_mps: Any shape.
            gust_mps: Carries the vehicle on for as long as it brakes with all it has. The margin
                pays for gusts over the ``lag_s`` of the shortest stop.
        """
        knee_mps = np.minimum(speed_mps, self.brake_mps2 * self.lag_s)
        hard_s = (speed_mps - knee_mps) / self.brake_mps2
        return np.asarray(
            (0.5 * (speed_mps + knee_mps) + gust_mps) * hard_s + knee_mps * self.lag_s
        )

    def approach_speed_mps(
        self, distance_m: FloatArray, reaction_s: float, gust_mps: float = 0.0
    ) -> FloatArray:
        """Return the largest speed that stops within ``distance_m``, shape as given.

        The inverse of ``speed * reaction_s + stopping_distance_m(speed, gust_mps)``; 0 where no way
        is left.
        """
        lag_s, brake_mps2 = self.lag_s, self.brake_mps2
        way_m = np.maximum(distance_m, 0.0)
        slow_mps = way_m / (reaction_s + lag_s)
        beyond_m = np.maximum(way_m - 0.5 * brake_mps2 * lag_s**2 + gust_mps * lag_s, 0.0)
        late_mps = brake_mps2 * reaction_s + gust_mps
        fast_mps = np.sqrt(late_mps**2 + 2.0 * brake_mps2 * beyond_m) - late_mps
        return np.where(slow_mps <= brake_mps2 * lag_s, slow_mps, fast_mps)

    def stopping_paths_m(
        self,
        velocity_enu_mps: FloatArray,
        command_enu_mps: FloatArray,
        *,
        follow_s: float,
        drift_enu_mps: FloatArray | None = None,
        gust_mps: float = 0.0,
    ) -> tuple[FloatArray, FloatArray]:
        """Return where the vehicle may be if it follows each command a while, then stops.

        While it follows, a vehicle quicker than the model lies between the model's velocity and
        the command itself: one path for each of ``PACES``. One more if there is a drift: it may end
        at once. Then it stops on a straight line.

        Args:
            velocity_enu_mps: Now, shape ``(3,)``.
            command_enu_mps: Velocities over ground, drift included, shape ``(K, 3)``.
            follow_s: How long it follows the command before it stops.
            drift_enu_mps: Shape ``(3,)``; ``None`` for none.
            gust_mps: As for ``stopping_distance_m``.

        Returns:
            Relative to the present position: where the stop begins and where the vehicle comes
            to rest, each ``(K, P, 3)``.
        """
        error_mps = command_enu_mps - velocity_enu_mps
        length_mps = np.sqrt(np.einsum("ki,ki->k", error_mps, error_mps))
        limited_s = length_mps / self.brake_mps2 - self.lag_s
        limited_s = np.minimum(np.maximum(limited_s, 0.0), follow_s)
        knee_mps = length_mps - self.brake_mps2 * limited_s
        left_mps = knee_mps * np.exp((limited_s - follow_s) / self.lag_s)
        # Integral of the error's length: a trapezium, then an exponential tail.
        area_m = 0.5 * (length_mps + knee_mps) * limited_s + (knee_mps - left_mps) * self.lag_s
        length_mps = np.maximum(length_mps, _TINY_MPS)
        late, late_s = _BEHIND * (left_mps / length_mps), _BEHIND * (area_m / length_mps)

        error_mps, command_enu_mps = error_mps[:, None], command_enu_mps[:, None]
        velocity_mps = command_enu_mps - late.T[..., None] * error_mps
        begin_m = follow_s * command_enu_mps - late_s.T[..., None] * error_mps
        if drift_enu_mps is not None:
            undrifted_mps = command_enu_mps - drift_enu_mps
            velocity_mps = np.concatenate((velocity_mps, undrifted_mps), axis=1)
            begin_m = np.concatenate((begin_m, follow_s * undrifted_mps), axis=1)
        speed_mps = np.sqrt(np.einsum("kpi,kpi->kp", velocity_mps, velocity_mps))
        fast_mps = np.maximum(speed_mps - self.brake_mps2 * self.lag_s, 0.0)
        speed_mps = np.maximum(speed_mps, _TINY_MPS)
        hard_m = (0.5 * fast_mps + gust_mps) * (fast_mps / self.brake_mps2)
        stop_s = self.lag_s + hard_m / speed_mps
        return begin_m, begin_m + velocity_mps * stop_s[..., None]
