"""Where ``N`` vehicles are and how they get on: the state behind ``CityWorld``."""

from dataclasses import dataclass, fields

import numpy as np

from companion.arrays import FloatArray, IntArray
from companion.world.geometry import Obstacles
from sim.dynamics import (
    Disturbance,
    VelocityLag,
    VerticalLimits,
    clip_to_box,
    follow_velocity,
    stop_at_walls,
)


@dataclass(frozen=True, slots=True)
class Dynamics:
    """How vehicles move; by default as the paper's kinematic point.

    Everything but a ``lag`` needs one: the kinematic point knows nothing of it.
    """

    lag: VelocityLag | None = None
    """How the vehicle follows; ``None`` for the paper's kinematic point."""
    time_constant_s: tuple[float, float] | None = None
    """Least and largest time constant: drawn anew for every episode, in place of the lag's."""
    vertical: VerticalLimits | None = None
    """How fast the autopilot climbs and descends; ``None`` for as fast as it flies."""
    wind: Disturbance | None = None
    """Gusts left over after the autopilot's own control, in m/s."""
    position_noise: Disturbance | None = None
    """Error of the position that the observation is made from, in metres."""
    start_speed_mps: float = 0.0
    """Largest speed at the start of an episode: exploring starts."""
    substeps: int = 1
    """Into how many chords a step's curved way is cut."""

    def __post_init__(self) -> None:
        if self.substeps < 1:
            raise ValueError(f"substeps must be at least 1, got {self.substeps}")
        if not self.start_speed_mps >= 0.0:
            raise ValueError(f"start_speed_mps must not be negative, got {self.start_speed_mps}")
        slow_s = self.time_constant_s
        if slow_s is not None and not 0.0 < slow_s[0] <= slow_s[1]:
            raise ValueError(f"time_constant_s must be positive and ascend, got {slow_s}")
        of_lag = (slow_s, self.vertical, self.wind, self.position_noise)
        if self.lag is None and (
            of_lag != (None,) * 4 or self.start_speed_mps > 0.0 or self.substeps > 1
        ):
            raise ValueError(
                "wind, noise, substeps, vertical limits and speeds at the start need a lag: "
                "the kinematic point knows none of them"
            )


@dataclass(slots=True)
class Motion:
    """The moving state of ``N`` vehicles; arrays are replaced, never written into, by a step."""

    position_enu_m: FloatArray  # (N, 3)
    velocity_enu_mps: FloatArray  # (N, 3)
    """Over ground, gusts included."""
    gust_enu_mps: FloatArray  # (N, 3)
    position_error_enu_m: FloatArray  # (N, 3)
    time_constant_s: FloatArray  # (N,)

    @classmethod
    def at_rest(cls, num_vehicles: int) -> "Motion":
        """Return vehicles in the map's corner; ``start`` puts them somewhere."""
        a, b, c, d = np.zeros((4, num_vehicles, 3))
        return cls(a, b, c, d, np.ones(num_vehicles))

    def take(self, rows: IntArray) -> "Motion":
        """Return some of the vehicles."""
        return Motion(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    @property
    def estimate_enu_m(self) -> FloatArray:
        """Return where the vehicles believe they are, ``(N, 3)``."""
        return self.position_enu_m + self.position_error_enu_m

    def start(
        self,
        rows: IntArray,
        position_enu_m: FloatArray,
        dynamics: Dynamics,
        rng: np.random.Generator,
    ) -> None:
        """Begin anew in ``rows``, at the given positions; writes into the arrays."""
        shape = position_enu_m.shape
        self.position_enu_m[rows] = position_enu_m
        self.velocity_enu_mps[rows] = 0.0
        if dynamics.start_speed_mps > 0.0:
            direction = rng.standard_normal(shape)
            direction /= np.linalg.norm(direction, axis=1, keepdims=True)
            speed_mps = rng.uniform(0.0, dynamics.start_speed_mps, (shape[0], 1))
            velocity_mps = speed_mps * direction
            if dynamics.vertical is not None:
                velocity_mps = dynamics.vertical.within(velocity_mps)
            self.velocity_enu_mps[rows] = velocity_mps
        if dynamics.wind is not None:
            self.gust_enu_mps[rows] = dynamics.wind.sample(rng, shape)
        if dynamics.position_noise is not None:
            self.position_error_enu_m[rows] = dynamics.position_noise.sample(rng, shape)
        if dynamics.time_constant_s is not None:
            self.time_constant_s[rows] = rng.uniform(*dynamics.time_constant_s, shape[0])
        elif dynamics.lag is not None:
            self.time_constant_s[rows] = dynamics.lag.time_constant_s

    def jump(self, displacement_enu_m: FloatArray, size_m: FloatArray, *, dt_s: float) -> None:
        """Move as the paper's kinematic point does: straight, but not out of the box."""
        start_enu_m = self.position_enu_m
        self.position_enu_m = clip_to_box(start_enu_m + displacement_enu_m, size_m)
        self.velocity_enu_mps = (self.position_enu_m - start_enu_m) / dt_s

    def follow(
        self,
        setpoint_enu_mps: FloatArray,
        lag: VelocityLag,
        dynamics: Dynamics,
        size_m: FloatArray,
        *,
        dt_s: float,
        rng: np.random.Generator,
        acceleration_max_mps2: FloatArray | None = None,
    ) -> None:
        """Let every vehicle follow its setpoint along one chord of ``dt_s``.

        ``acceleration_max_mps2``, ``(N,)``, stands in for the lag's own limit.
        """
        gust_enu_mps = self.gust_enu_mps
        if dynamics.vertical is not None:
            setpoint_enu_mps = dynamics.vertical.within(setpoint_enu_mps)
        velocity_enu_mps, chord_enu_m = follow_velocity(
            self.velocity_enu_mps - gust_enu_mps,
            setpoint_enu_mps,
            lag,
            dt_s=dt_s,
            time_constant_s=self.time_constant_s,
            acceleration_max_mps2=acceleration_max_mps2,
        )
        self.position_enu_m = clip_to_box(
            self.position_enu_m + chord_enu_m + gust_enu_mps * dt_s, size_m
        )
        if dynamics.wind is not None:
            self.gust_enu_mps = dynamics.wind.advance(gust_enu_mps, dt_s=dt_s, rng=rng)
            velocity_enu_mps = velocity_enu_mps + self.gust_enu_mps
        self.velocity_enu_mps = stop_at_walls(velocity_enu_mps, self.position_enu_m, size_m)
        if dynamics.position_noise is not None:
            self.position_error_enu_m = dynamics.position_noise.advance(
                self.position_error_enu_m, dt_s=dt_s, rng=rng
            )


def crossed_m(
    obstacles: Obstacles, start_enu_m: FloatArray, end_enu_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the crash depths of straight ways and their lengths, ``(N,)`` in metres."""
    way_enu_m = end_enu_m - start_enu_m
    length_m: FloatArray = np.sqrt(np.einsum("ni,ni->n", way_enu_m, way_enu_m))
    return obstacles.crash_depth_m(start_enu_m, end_enu_m), length_m
