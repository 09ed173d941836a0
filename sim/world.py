"""The paper's city, ``N`` times over, stepped at once.

Every world holds one vehicle and one target. The paper's world is the default: a kinematic
point in a cube, positions held inside the box (erratum E14), crashes that cost reward and end
nothing (E13), episodes of a fixed number of steps. Options turn it into the world of the
``flight`` preset: contact ends the episode, the vehicle needs time to follow, the wind blows.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import fields
from typing import Any

import numpy as np
import numpy.typing as npt

from companion.arrays import BoolArray, Float32Array, FloatArray, IntArray
from companion.policy.action import (
    ActionScaling,
    action_to_displacement_m,
    action_to_velocity_mps,
    bearing_to_target_rad,
    polar_to_target_rad,
)
from companion.policy.observation import Layout, build_observation
from companion.world.maps import Map
from companion.world.way_ahead import WayAhead
from sim.episodes import EpisodeEnd, Episodes
from sim.guides import Guides, Surveyor
from sim.imperfections import Flown, Imperfections
from sim.motion import Dynamics, Motion, crossed_m
from sim.reward import Reward
from sim.sampling import sample_free_under
from sim.step import StepResult
from sim.targets import TargetMotion, TargetPaths, random_paths_under
from sim.terrain import Terrain


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
        reward: What a step is worth; by default the paper's reward. Where the layout shows the
            way, its distance to the target is what is left of the way.
        end_on_contact: Terminate an episode when the vehicle touches an obstacle.
        end_on_arrival: Truncate it when the vehicle arrives. Truncated, because the paper's
            reward pays for every step at the target: ending there without bootstrapping
            would teach the vehicle to stay outside.
        restart_probability: Chance per step that an episode is truncated for a new one.
        arrived_restart_probability: Added to it once the vehicle has arrived.
        start_margin_m: Episodes begin farther than this from every obstacle.
        target_motion: ``static`` or ``moving``.
        target_speed: Least and largest speed of moving targets, as fractions of ``v_max_mps``.
        v_max_mps: Speed of an action of length rho_max. It fixes the step time (E8):
            ``dt_s = rho_max * edge_m / v_max_mps``.
        step_s: Another step time, for a vehicle with a lag that is asked more often.
        dynamics: How the vehicles move; by default as the paper's kinematic point.
        imperfections: Of vehicles with a lag and of their links; by default none.
        targets_per_map: Draw static targets from a pool of so many for each map, with the ways
            to them found beforehand; for layouts that show the way.
        surveyor: Remembers ways for other worlds with the same cases.

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
        reward: Reward | None = None,
        end_on_contact: bool = False,
        end_on_arrival: bool = False,
        restart_probability: float = 0.0,
        arrived_restart_probability: float = 0.0,
        start_margin_m: float = 0.0,
        target_motion: TargetMotion | str = TargetMotion.STATIC,
        target_speed: tuple[float, float] = (0.1, 0.4),
        v_max_mps: float = 5.0,
        step_s: float | None = None,
        dynamics: Dynamics | None = None,
        imperfections: Imperfections | None = None,
        targets_per_map: int | None = None,
        surveyor: Surveyor | None = None,
    ) -> None:
        if num_worlds < 1 or horizon < 1:
            raise ValueError(
                f"num_worlds and horizon must be at least 1, got {num_worlds} and {horizon}"
            )
        for chance in (restart_probability, arrived_restart_probability):
            if not 0.0 <= chance < 1.0:
                raise ValueError(f"restart_probability must be in [0, 1), got {chance}")
        if not (arrival_radius_m > 0.0 and v_max_mps > 0.0):
            raise ValueError(
                f"arrival_radius_m and v_max_mps must be positive, "
                f"got {arrival_radius_m} and {v_max_mps}"
            )
        if not 0.0 <= target_speed[0] <= target_speed[1]:
            raise ValueError(f"target_speed must ascend from 0, got {target_speed}")
        self.dynamics = Dynamics() if dynamics is None else dynamics
        if step_s is not None and not (self.dynamics.lag is not None and step_s > 0.0):
            raise ValueError(f"step_s must be positive and needs a lag, got {step_s}")
        if imperfections is not None and self.dynamics.lag is None:
            raise ValueError("imperfections need a lag: the kinematic point knows none of them")
        self.reward = Reward() if reward is None else reward
        if targets_per_map is not None and TargetMotion(target_motion) is TargetMotion.MOVING:
            raise ValueError("targets_per_map is for static targets")
        self.layout = layout
        self.scaling = scaling
        self.num_worlds = num_worlds
        self.horizon = horizon
        self.arrival_radius_m = arrival_radius_m
        self.end_on_contact = end_on_contact
        self.end_on_arrival = end_on_arrival
        self.restart_probability = restart_probability
        self.arrived_restart_probability = arrived_restart_probability
        self.start_margin_m = start_margin_m
        self.target_motion = TargetMotion(target_motion)
        self.v_max_mps = v_max_mps
        self._terrain = Terrain((city,) if isinstance(city, Map) else city, num_worlds)
        self.edge_m = self._terrain.edge_m
        self.size_m = self._terrain.size_m
        self._around = self._terrain.grown(self.reward.keep_m) if self.reward.keeps_off else None
        self.dt_s = scaling.rho_max * self.edge_m / v_max_mps if step_s is None else step_s
        self._target_speed_mps = (target_speed[0] * v_max_mps, target_speed[1] * v_max_mps)
        self._rng = rng
        self._episodes = Episodes.unstarted(num_worlds)
        self._motion = Motion.at_rest(num_worlds)
        self._flown: Flown | None = None
        if imperfections is not None:
            self._flown = Flown(imperfections, num_worlds, rng.spawn(1)[0], dt_s=self.dt_s)
        self._guides: Guides | None = None
        self._ahead: WayAhead | None = None
        if layout.shows_way:
            self._guides = Guides(
                self._terrain.maps,
                self._terrain.map_of_world,
                rng,
                targets_per_map=targets_per_map,
                surveyor=surveyor,
            )
        self._target_enu_m = np.zeros((num_worlds, 3))
        self._paths = (
            TargetPaths.unset(num_worlds)
            if self.target_motion is TargetMotion.MOVING
            else TargetPaths.resting(self._target_enu_m)
        )
        self._begin(self._terrain.all_worlds)

    @property
    def position_enu_m(self) -> FloatArray:
        """Where the vehicles are now, after any reset; a copy, ``(N, 3)``."""
        return self._motion.position_enu_m.copy()

    @property
    def estimate_enu_m(self) -> FloatArray:
        """Where the vehicles believe they are, noise and all; a copy, ``(N, 3)``."""
        return self._motion.estimate_enu_m if self._flown is None else self._flown.position_enu_m

    @property
    def velocity_enu_mps(self) -> FloatArray:
        """How fast the vehicles are now, as far as is known; a copy, ``(N, 3)``."""
        return self._measured_enu_mps.copy()

    @property
    def _measured_enu_mps(self) -> FloatArray:
        return (
            self._motion.velocity_enu_mps if self._flown is None else self._flown.velocity_enu_mps
        )

    @property
    def known_target_enu_m(self) -> FloatArray:
        """Where the vehicles believe their targets are; not to be written into, ``(N, 3)``."""
        return self._target_enu_m if self._flown is None else self._flown.target_enu_m

    @property
    def target_enu_m(self) -> FloatArray:
        """Where the targets are now, after any reset; a copy, ``(N, 3)``."""
        return self._target_enu_m.copy()

    @property
    def aim_enu_m(self) -> FloatArray:
        """What angles are measured from and the view is turned to: the way's aim, or the target."""
        ahead = self._way_ahead()
        return self.known_target_enu_m if ahead is None else ahead.aim_enu_m

    def map_of(self, world: int) -> Map:
        """Return the map that one of the worlds lies on."""
        return self._terrain.map_of(world)

    def reset(self) -> Float32Array:
        """Start a new episode in every world and return its observation, ``(N, n)``."""
        return self._restart(self._terrain.all_worlds)

    def place(self, start_enu_m: FloatArray, paths: TargetPaths) -> Float32Array:
        """Start a given episode in every world and return its observation, ``(N, n)``.

        For worlds without a pool of targets; what restarts later does so at random.

        Args:
            start_enu_m: Where the vehicles start, shape ``(N, 3)``.
            paths: Where the targets go, one path for each world.
        """
        self._own()
        worlds = self._terrain.all_worlds
        self._motion.start(worlds, start_enu_m, self.dynamics, self._rng)
        self._paths = paths
        self._open(worlds, start_enu_m, paths)
        return self._first_look(worlds)

    def step(self, action: npt.NDArray[np.floating]) -> StepResult:
        """Advance every world by one step of ``dt_s``.

        Args:
            action: Shape ``(N, 3)``, in [-1, 1]; ``scaling`` gives it its meaning.

        Raises:
            ValueError: If ``action`` has another shape or is not finite.
        """
        shape = (self.num_worlds, 3)
        if action.shape != shape:
            raise ValueError(f"action must be {shape}, got {action.shape}")
        if not np.isfinite(action).all():
            raise ValueError("action must be finite: a vehicle at nan would never come back")
        estimate_enu_m, aim_enu_m = self.estimate_enu_m, self.aim_enu_m
        bearing_rad = bearing_to_target_rad(estimate_enu_m, aim_enu_m)
        polar_rad = polar_to_target_rad(estimate_enu_m, aim_enu_m)
        if self.dynamics.lag is None:
            start_enu_m = self._motion.position_enu_m
            self._motion.jump(
                action_to_displacement_m(action, self.scaling, self.edge_m, bearing_rad, polar_rad),
                self.size_m,
                dt_s=self.dt_s,
            )
            return self._finish(*self._judged(start_enu_m))
        return self.follow(
            action_to_velocity_mps(action, self.scaling, self.v_max_mps, bearing_rad, polar_rad)
        )

    def follow(self, setpoint_enu_mps: FloatArray) -> StepResult:
        """Advance every world by one step under velocity setpoints instead of actions.

        Args:
            setpoint_enu_mps: Map ENU, shape ``(N, 3)``, finite.

        Raises:
            ValueError: If the vehicles have no lag: the kinematic point knows no velocity.
        """
        dynamics, lag = self.dynamics, self.dynamics.lag
        if lag is None:
            raise ValueError("only a vehicle with a lag follows velocities")
        flown = self._flown
        if flown is not None:
            setpoint_enu_mps = flown.receive(setpoint_enu_mps)
        totals = np.zeros((3, self.num_worlds))
        for _ in range(dynamics.substeps):
            start_enu_m = self._motion.position_enu_m
            self._motion.follow(
                setpoint_enu_mps,
                lag,
                dynamics,
                self.size_m,
                dt_s=self.dt_s / dynamics.substeps,
                rng=self._rng,
                acceleration_max_mps2=None if flown is None else flown.acceleration_max_mps2,
            )
            totals += self._judged(start_enu_m)
        return self._finish(*totals)

    def _judged(self, start_enu_m: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return crash depth, length and depth within ``keep_m`` of a straight way, ``(N,)``."""
        end_enu_m = self._motion.position_enu_m
        depth_m, length_m = crossed_m(self._terrain.whole.obstacles, start_enu_m, end_enu_m)
        if self._around is None:
            return depth_m, length_m, np.zeros(self.num_worlds)
        return (
            depth_m,
            length_m,
            self._around.whole.obstacles.crash_depth_m(start_enu_m, end_enu_m),
        )

    def _finish(
        self, crash_depth_m: FloatArray, flown_m: FloatArray, near_m: FloatArray
    ) -> StepResult:
        """Move the targets, reward, and restart what has ended."""
        time_s = np.multiply(self._episodes.steps + 1, self.dt_s, dtype=np.float64)
        self._target_enu_m, _ = self._paths.at(time_s)
        motion = self._motion
        distance_m = _length(self._target_enu_m - motion.position_enu_m)
        contact = crash_depth_m > 0.0
        if self._flown is not None:
            self._flown.look(motion.estimate_enu_m, motion.velocity_enu_mps, self._target_enu_m)
        if self._guides is not None:
            self._guides.follow(self.known_target_enu_m)
            self._ahead = self._guides.ahead(self.estimate_enu_m, self.known_target_enu_m)
        # Who is shown the way round is paid along it: hovering before a wall pays nothing then.
        left_m = distance_m if self._ahead is None else np.maximum(distance_m, self._ahead.left_m)
        reward = self.reward.of(
            left_m / self.edge_m,
            crash_depth_m / self.edge_m,
            None if self._around is None else near_m / self.edge_m,
        )
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
        before = (motion.position_enu_m, motion.velocity_enu_mps, self._target_enu_m)
        reached = self._episodes.reached.copy()
        episode_end = self._episodes.end(ended, distance_m)
        if len(ended) > 0:
            self._own()
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

    def clearance_m(self) -> FloatArray:
        """Return how far every vehicle is from the nearest obstacle, ``(N,)``."""
        return self._terrain.whole.obstacles.signed_distance_m(self._motion.position_enu_m)

    def nearest_surface(self, position_enu_m: FloatArray) -> FloatArray:
        """Return the surface point nearest to each vehicle at ``(N, 3)``, of its own map.

        Infinite without obstacles.
        """
        return self._terrain.whole.obstacles.nearest_surface(position_enu_m)

    def books(self) -> EpisodeEnd:
        """Return how the running episodes stand, as if they all ended now; ``K`` is ``N``."""
        distance_m = _length(self._target_enu_m - self._motion.position_enu_m)
        return self._episodes.end(self._terrain.all_worlds, distance_m)

    def take(self, worlds: IntArray) -> "CityWorld":
        """Return some of these worlds to be stepped on without the others; one generator serves."""
        taken = copy(self)
        taken.num_worlds = len(worlds)
        taken._terrain = self._terrain.take(worlds)
        taken._around = None if self._around is None else self._around.take(worlds)
        taken._motion = self._motion.take(worlds)
        taken._flown = None if self._flown is None else self._flown.take(worlds)
        taken._paths = self._paths.take(worlds)
        taken._episodes = self._episodes.take(worlds)
        taken._target_enu_m = self._target_enu_m[worlds]
        ahead = self._way_ahead()
        if self._guides is not None and ahead is not None:
            taken._guides = self._guides.take(worlds)
            taken._ahead = ahead.take(worlds)
        return taken

    def state_dict(self) -> dict[str, Any]:
        """Return everything that changes, as copies; picklable, for checkpoints."""
        return {
            "arrays": {name: array.copy() for name, array in self._arrays().items()},
            "rng": self._rng.bit_generator.state,
            **({} if self._flown is None else {"own_rng": self._flown.rng.bit_generator.state}),
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
        self._own()
        for name, array in self._arrays().items():
            array[...] = state["arrays"][name]
        self._rng.bit_generator.state = state["rng"]
        if self._flown is not None:
            self._flown.rng.bit_generator.state = state["own_rng"]
        if self._guides is not None:
            self._guides.restore()
            self._ahead = self._guides.ahead(self.estimate_enu_m, self.known_target_enu_m)
        return self._observe()

    def _arrays(self) -> dict[str, npt.NDArray[Any]]:
        self._way_ahead()
        return {
            **{f.name: getattr(self._motion, f.name) for f in fields(Motion)},
            "target_enu_m": self._target_enu_m,
            **{f"path_{f.name}": getattr(self._paths, f.name) for f in fields(self._paths)},
            **{f"episode_{f.name}": getattr(self._episodes, f.name) for f in fields(Episodes)},
            **({} if self._guides is None else self._guides.arrays()),
            **({} if self._flown is None else self._flown.arrays()),
        }

    def _own(self) -> None:
        """Replace all arrays that are also in earlier results by copies, to write into."""
        motion = self._motion
        motion.position_enu_m = motion.position_enu_m.copy()
        motion.velocity_enu_mps = motion.velocity_enu_mps.copy()
        self._target_enu_m = self._target_enu_m.copy()

    def _truncated(self) -> BoolArray:
        truncated: BoolArray = self._episodes.steps >= self.horizon
        if self.end_on_arrival:
            truncated |= self._episodes.reached
        if self.restart_probability + self.arrived_restart_probability > 0.0:
            at_target = self.arrived_restart_probability * self._episodes.reached
            truncated |= self._rng.random(self.num_worlds) < self.restart_probability + at_target
        return truncated

    def _restart(self, worlds: IntArray) -> Float32Array:
        """Open new episodes in ``worlds`` and return their observations."""
        self._begin(worlds)
        return self._first_look(worlds)

    def _begin(self, worlds: IntArray) -> None:
        """Draw new episodes for ``worlds``; the ways to their targets are not found yet."""
        under = self._terrain.under
        start_enu_m = sample_free_under(under, self._rng, worlds, margin_m=self.start_margin_m)
        self._motion.start(worlds, start_enu_m, self.dynamics, self._rng)
        if self.target_motion is TargetMotion.MOVING:
            speed_mps = self._target_speed_mps
            paths = random_paths_under(under, self._rng, worlds, speed_mps=speed_mps)
        elif self._guides is not None and self._guides.pool_enu_m is not None:
            paths = TargetPaths.resting(self._guides.draw(worlds, self._rng))
        else:
            paths = TargetPaths.resting(sample_free_under(under, self._rng, worlds))
        self._paths.put(worlds, paths)
        self._open(worlds, start_enu_m, paths)

    def _open(self, worlds: IntArray, start_enu_m: FloatArray, paths: TargetPaths) -> None:
        """Open the books of episodes that have been put in place."""
        self._target_enu_m[worlds] = paths.vertex_enu_m[:, 0]
        self._episodes.start(worlds, _length(self._target_enu_m[worlds] - start_enu_m))
        if self._flown is not None:
            self._flown.start(
                worlds,
                self._motion.estimate_enu_m[worlds],
                self._motion.velocity_enu_mps[worlds],
                self._target_enu_m[worlds],
            )

    def _first_look(self, worlds: IntArray) -> Float32Array:
        """Return the observations of episodes that have just been opened."""
        return build_observation(
            self.layout,
            position_enu_m=self.estimate_enu_m[worlds],
            velocity_enu_mps=self._measured_enu_mps[worlds],
            target_enu_m=self.known_target_enu_m[worlds],
            map=self._terrain.under(worlds),
            ahead=self._look_ahead_from(worlds),
        )

    def _way_ahead(self) -> WayAhead | None:
        """Return the way ahead as last seen; found here for episodes that nobody has looked at."""
        if self._ahead is None:
            self._look_ahead_from(self._terrain.all_worlds)
        return self._ahead

    def _look_ahead_from(self, worlds: IntArray) -> WayAhead | None:
        """Return the way ahead of worlds that have just been restarted, and note it."""
        if self._guides is None:
            return None
        target_enu_m = self.known_target_enu_m[worlds]
        if self._guides.pool_enu_m is None:
            self._guides.lead(worlds, target_enu_m)
        ahead = self._guides.ahead(self.estimate_enu_m[worlds], target_enu_m, worlds)
        if len(worlds) == self.num_worlds:
            self._ahead = ahead
        elif self._ahead is not None:
            self._ahead = self._ahead.with_rows(worlds, ahead)
        return ahead

    def _observe(self) -> Float32Array:
        return build_observation(
            self.layout,
            position_enu_m=self.estimate_enu_m,
            velocity_enu_mps=self._measured_enu_mps,
            target_enu_m=self.known_target_enu_m,
            map=self._terrain.whole,
            ahead=self._ahead,
        )


def _length(vector: FloatArray) -> FloatArray:
    """Return lengths, shape ``(N,)``; several times faster than ``np.linalg.norm``."""
    length: FloatArray = np.sqrt(np.einsum("ni,ni->n", vector, vector))
    return length
