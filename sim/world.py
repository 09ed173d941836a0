"""The paper's city, ``N`` times over, stepped at once.

Every world holds one vehicle and one target. The paper's world is the default: a kinematic
point in a cube, positions held inside the box (erratum E14), crashes that cost reward and end
nothing (E13), episodes of a fixed number of steps. Options turn it into the world of the
``flight`` preset: contact ends the episode, the vehicle needs time to follow, the wind blows.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from companion.arrays import BoolArray, Float32Array, FloatArray, IntArray
from companion.policy.action import (
    ActionScaling,
    action_to_displacement_m,
    action_to_velocity_mps,
    bearing_to_target_rad,
)
from companion.policy.observation import Layout, build_observation
from companion.world.maps import Map
from sim.dynamics import Disturbance, VelocityLag, clip_to_box, follow_velocity, stop_at_walls
from sim.episodes import EpisodeEnd, Episodes
from sim.reward import BETA, check_beta, step_reward
from sim.sampling import sample_free_under
from sim.targets import TargetMotion, TargetPaths, random_paths_under
from sim.terrain import Terrain


@dataclass(frozen=True, slots=True)
class StepResult:
    """One step of every world; ``N`` is the number of worlds."""

    next_observation: Float32Array  # (N, n)
    """Of the step itself, before any reset: the successor to store in a replay buffer."""
    reward: FloatArray  # (N,)
    terminated: BoolArray  # (N,)
    """Ended by contact: do not bootstrap."""
    truncated: BoolArray  # (N,)
    """Ended by the horizon, by arrival or by a random restart: do bootstrap."""
    observation: Float32Array  # (N, n)
    """What to act on next: the same, but of the new episode where one ended."""
    contact: BoolArray  # (N,)
    """The step's segment crossed an obstacle."""
    reached: BoolArray  # (N,)
    """Arrived in this episode, in this step or before, with no contact until then."""
    crash_depth_m: FloatArray  # (N,)
    position_enu_m: FloatArray  # (N, 3)
    """After the step and before any reset, like the velocity and the target."""
    velocity_enu_mps: FloatArray  # (N, 3)
    target_enu_m: FloatArray  # (N, 3)
    episode_end: EpisodeEnd
    """How the episodes went that ended in this step; empty when none did."""


class CityWorld:
    """``N`` worlds stepped at once; no Python loop runs over them.

    Args:
        city: One map, or several over which the worlds are spread evenly. Several must agree
            in size and edge.
        layout: What the observation holds.
        scaling: What an action means.
        num_worlds: ``N``.
        rng: The only source of randomness.
        horizon: Steps after which an episode is truncated; the paper's T.
        arrival_radius_m: A vehicle closer to its target has arrived (E9).
        beta: Weight of the obstacle penalty (E4).
        end_on_contact: Terminate an episode when the vehicle touches an obstacle.
        end_on_arrival: Truncate it when the vehicle arrives. Truncated, because the paper's
            reward pays for every step at the target: ending there without bootstrapping
            would teach the vehicle to stay outside.
        restart_probability: Chance per step that an episode is truncated for a new one.
        target_motion: ``static`` or ``moving``.
        target_speed: Least and largest speed of moving targets, as fractions of ``v_max_mps``.
        v_max_mps: Speed of an action of length rho_max. It fixes the step time (E8):
            ``dt_s = rho_max * edge_m / v_max_mps``.
        lag: How the vehicle follows; ``None`` for the paper's kinematic point.
        wind: Gusts left over after the autopilot's own control; needs a ``lag``.
        substeps: With a ``lag``, into how many chords a step's curved way is cut.

    Raises:
        ValueError: If options contradict each other; the message names them.
    """

    def __init__(
        self,
        city: Map | Sequence[Map],
        layout: Layout,
        scaling: ActionScaling,
        num_worlds: int,
        rng: np.random.Generator,
        *,
        horizon: int = 100,
        arrival_radius_m: float = 5.0,
        beta: float = BETA,
        end_on_contact: bool = False,
        end_on_arrival: bool = False,
        restart_probability: float = 0.0,
        target_motion: TargetMotion | str = TargetMotion.STATIC,
        target_speed: tuple[float, float] = (0.1, 0.4),
        v_max_mps: float = 5.0,
        lag: VelocityLag | None = None,
        wind: Disturbance | None = None,
        substeps: int = 1,
    ) -> None:
        if num_worlds < 1 or horizon < 1 or substeps < 1:
            raise ValueError(
                f"num_worlds, horizon and substeps must be at least 1, "
                f"got {num_worlds}, {horizon} and {substeps}"
            )
        if not 0.0 <= restart_probability < 1.0:
            raise ValueError(f"restart_probability must be in [0, 1), got {restart_probability}")
        if not (arrival_radius_m > 0.0 and v_max_mps > 0.0):
            raise ValueError(
                f"arrival_radius_m and v_max_mps must be positive, "
                f"got {arrival_radius_m} and {v_max_mps}"
            )
        if not 0.0 <= target_speed[0] <= target_speed[1]:
            raise ValueError(f"target_speed must ascend from 0, got {target_speed}")
        if lag is None and (wind is not None or substeps > 1):
            raise ValueError("wind and substeps need a lag: the kinematic point knows neither")
        self.layout = layout
        self.scaling = scaling
        self.num_worlds = num_worlds
        self.horizon = horizon
        self.arrival_radius_m = arrival_radius_m
        self.beta = check_beta(beta)
        self.end_on_contact = end_on_contact
        self.end_on_arrival = end_on_arrival
        self.restart_probability = restart_probability
        self.target_motion = TargetMotion(target_motion)
        self.v_max_mps = v_max_mps
        self.lag = lag
        self.wind = wind
        self.substeps = substeps
        self._terrain = Terrain((city,) if isinstance(city, Map) else city, num_worlds)
        self.edge_m = self._terrain.edge_m
        self.size_m = self._terrain.size_m
        self.dt_s = scaling.rho_max * self.edge_m / v_max_mps
        self._target_speed_mps = (target_speed[0] * v_max_mps, target_speed[1] * v_max_mps)
        self._rng = rng
        self._episodes = Episodes.unstarted(num_worlds)
        self._position_enu_m = np.zeros((num_worlds, 3))
        self._velocity_enu_mps = np.zeros((num_worlds, 3))
        self._gust_enu_mps = np.zeros((num_worlds, 3))
        self._target_enu_m = np.zeros((num_worlds, 3))
        self._paths = (
            TargetPaths.unset(num_worlds)
            if self.target_motion is TargetMotion.MOVING
            else TargetPaths.resting(self._target_enu_m)
        )
        self.reset()

    @property
    def position_enu_m(self) -> FloatArray:
        """Where the vehicles are now, after any reset; a copy, ``(N, 3)``."""
        return self._position_enu_m.copy()

    @property
    def target_enu_m(self) -> FloatArray:
        """Where the targets are now, after any reset; a copy, ``(N, 3)``."""
        return self._target_enu_m.copy()

    def map_of(self, world: int) -> Map:
        """Return the map that one of the worlds lies on."""
        return self._terrain.map_of(world)

    def reset(self) -> Float32Array:
        """Start a new episode in every world and return its observation, ``(N, n)``."""
        return self._restart(self._terrain.all_worlds)

    def step(self, action: npt.NDArray[np.floating]) -> StepResult:
        """Advance every world by one step of ``dt_s``.

        Args:
            action: Shape ``(N, 3)``, in [-1, 1]; ``scaling`` gives it its meaning.

        Raises:
            ValueError: If ``action`` has another shape or is not finite.
        """
        if action.shape != self._position_enu_m.shape:
            raise ValueError(f"action must be {self._position_enu_m.shape}, got {action.shape}")
        if not np.isfinite(action).all():
            raise ValueError("action must be finite: a vehicle at nan would never come back")
        crash_depth_m, flown_m = self._move(action)
        time_s = np.multiply(self._episodes.steps + 1, self.dt_s, dtype=np.float64)
        self._target_enu_m, _ = self._paths.at(time_s)
        distance_m = _length(self._target_enu_m - self._position_enu_m)
        contact = crash_depth_m > 0.0
        reward = step_reward(distance_m / self.edge_m, crash_depth_m / self.edge_m, beta=self.beta)
        self._episodes.record(
            reward=reward,
            contact=contact,
            distance_m=distance_m,
            flown_m=flown_m,
            arrival_radius_m=self.arrival_radius_m,
        )
        terminated = contact if self.end_on_contact else np.zeros_like(contact)
        truncated = self._truncated() & ~terminated
        ended = np.flatnonzero(terminated | truncated)

        # Nothing below writes into arrays handed out here: a restart works on copies.
        next_observation = self._observe()
        observation = next_observation
        before = (self._position_enu_m, self._velocity_enu_mps, self._target_enu_m)
        reached = self._episodes.reached.copy()
        episode_end = self._episodes.end(ended, distance_m)
        if len(ended) > 0:
            self._position_enu_m, self._velocity_enu_mps, self._target_enu_m = (
                array.copy() for array in before
            )
            observation = next_observation.copy()
            observation[ended] = self._restart(ended)
        return StepResult(
            next_observation=next_observation,
            reward=reward,
            terminated=terminated,
            truncated=truncated,
            observation=observation,
            contact=contact,
            reached=reached,
            crash_depth_m=crash_depth_m,
            position_enu_m=before[0],
            velocity_enu_mps=before[1],
            target_enu_m=before[2],
            episode_end=episode_end,
        )

    def state_dict(self) -> dict[str, Any]:
        """Return everything that changes, as copies; picklable, for checkpoints."""
        return {
            "arrays": {name: array.copy() for name, array in self._arrays().items()},
            "rng": self._rng.bit_generator.state,
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> Float32Array:
        """Go on from a ``state_dict`` of a world with the same options, to the same result.

        Returns:
            The observation to act on next, ``(N, n)``.

        Raises:
            ValueError: If the state is of another number of worlds or other targets.
        """
        arrays = self._arrays()
        for name, array in arrays.items():
            saved = state["arrays"][name]
            if saved.shape != array.shape:
                raise ValueError(f"{name} must be {array.shape}, the saved one is {saved.shape}")
        # Fresh arrays: those of earlier results may still be in somebody's hands.
        self._position_enu_m = self._position_enu_m.copy()
        self._velocity_enu_mps = self._velocity_enu_mps.copy()
        self._target_enu_m = self._target_enu_m.copy()
        for name, array in self._arrays().items():
            array[...] = state["arrays"][name]
        self._rng.bit_generator.state = state["rng"]
        return self._observe()

    def _arrays(self) -> dict[str, npt.NDArray[Any]]:
        return {
            "position_enu_m": self._position_enu_m,
            "velocity_enu_mps": self._velocity_enu_mps,
            "gust_enu_mps": self._gust_enu_mps,
            "target_enu_m": self._target_enu_m,
            **{f"path_{f.name}": getattr(self._paths, f.name) for f in fields(self._paths)},
            **{f"episode_{f.name}": getattr(self._episodes, f.name) for f in fields(Episodes)},
        }

    def _move(self, action: npt.NDArray[np.floating]) -> tuple[FloatArray, FloatArray]:
        """Move every vehicle; return crash depths and ways flown, ``(N,)`` in metres."""
        bearing_rad = bearing_to_target_rad(self._position_enu_m, self._target_enu_m)
        if self.lag is None:
            start_enu_m = self._position_enu_m
            moved = self._fly_by(
                action_to_displacement_m(action, self.scaling, self.edge_m, bearing_rad)
            )
            self._velocity_enu_mps = (self._position_enu_m - start_enu_m) / self.dt_s
            return moved
        setpoint_enu_mps = action_to_velocity_mps(action, self.scaling, self.v_max_mps, bearing_rad)
        crash_depth_m, flown_m = np.zeros(self.num_worlds), np.zeros(self.num_worlds)
        chord_s = self.dt_s / self.substeps
        for _ in range(self.substeps):
            depth_m, length_m = self._follow(setpoint_enu_mps, self.lag, chord_s)
            crash_depth_m += depth_m
            flown_m += length_m
        return crash_depth_m, flown_m

    def _follow(
        self, setpoint_enu_mps: FloatArray, lag: VelocityLag, dt_s: float
    ) -> tuple[FloatArray, FloatArray]:
        """Let every vehicle follow its setpoint along one chord, as ``_move`` returns it."""
        gust_enu_mps = self._gust_enu_mps
        velocity_enu_mps, chord_enu_m = follow_velocity(
            self._velocity_enu_mps - gust_enu_mps, setpoint_enu_mps, lag, dt_s=dt_s
        )
        moved = self._fly_by(chord_enu_m + gust_enu_mps * dt_s)
        if self.wind is not None:
            self._gust_enu_mps = self.wind.advance(gust_enu_mps, dt_s=dt_s, rng=self._rng)
            velocity_enu_mps = velocity_enu_mps + self._gust_enu_mps
        self._velocity_enu_mps = stop_at_walls(velocity_enu_mps, self._position_enu_m, self.size_m)
        return moved

    def _fly_by(self, displacement_enu_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Move straight, but not out of the box, as ``_move`` returns it."""
        start_enu_m = self._position_enu_m
        self._position_enu_m = clip_to_box(start_enu_m + displacement_enu_m, self.size_m)
        return (
            self._terrain.whole.obstacles.crash_depth_m(start_enu_m, self._position_enu_m),
            _length(self._position_enu_m - start_enu_m),
        )

    def _truncated(self) -> BoolArray:
        truncated: BoolArray = self._episodes.steps >= self.horizon
        if self.end_on_arrival:
            truncated |= self._episodes.reached
        if self.restart_probability > 0.0:
            truncated |= self._rng.random(self.num_worlds) < self.restart_probability
        return truncated

    def _restart(self, worlds: IntArray) -> Float32Array:
        """Open new episodes in ``worlds`` and return their observations."""
        under = self._terrain.under
        self._position_enu_m[worlds] = sample_free_under(under, self._rng, worlds)
        self._velocity_enu_mps[worlds] = 0.0
        if self.wind is not None:
            self._gust_enu_mps[worlds] = self.wind.sample(self._rng, (len(worlds), 3))
        if self.target_motion is TargetMotion.MOVING:
            speed_mps = self._target_speed_mps
            paths = random_paths_under(under, self._rng, worlds, speed_mps=speed_mps)
        else:
            paths = TargetPaths.resting(sample_free_under(under, self._rng, worlds))
        self._paths.put(worlds, paths)
        self._target_enu_m[worlds] = paths.vertex_enu_m[:, 0]
        self._episodes.start(
            worlds, _length(self._target_enu_m[worlds] - self._position_enu_m[worlds])
        )
        return build_observation(
            self.layout,
            position_enu_m=self._position_enu_m[worlds],
            velocity_enu_mps=self._velocity_enu_mps[worlds],
            target_enu_m=self._target_enu_m[worlds],
            map=under(worlds),
        )

    def _observe(self) -> Float32Array:
        return build_observation(
            self.layout,
            position_enu_m=self._position_enu_m,
            velocity_enu_mps=self._velocity_enu_mps,
            target_enu_m=self._target_enu_m,
            map=self._terrain.whole,
        )


def _length(vector: FloatArray) -> FloatArray:
    """Return lengths, shape ``(N,)``; several times faster than ``np.linalg.norm``."""
    length: FloatArray = np.sqrt(np.einsum("ni,ni->n", vector, vector))
    return length
