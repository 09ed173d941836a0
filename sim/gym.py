"""The city as a Gymnasium environment; importing this module registers it.

import gymnasium
import sim.gym

env = gymnasium.make("mavlink-companion/City-v0", map="env1")
"""

from typing import Any

import numpy as np

from companion.arrays import Float32Array
from companion.errors import UsageError
from companion.policy.action import PAPER_SCALING, ActionScaling
from companion.policy.observation import LAYOUTS, Layout
from companion.world.maps import Map, load_map
from sim.world import CityWorld

try:
    import gymnasium
except ImportError as error:
    raise UsageError(
        'the environment needs Gymnasium: pip install "mavlink-companion[training]"'
    ) from error

ENVIRONMENT_ID = "mavlink-companion/City-v0"


class CityEnv(gymnasium.Env[Float32Array, Float32Array]):
    """One vehicle in a city flies to one target; the paper's task, or a harder one.

    ## Description

    The world of Bouhamed et al., *Autonomous UAV Navigation: A DDPG-based Deep Reinforcement
    Learning Approach* (ISCAS 2020): a cube of 100 m, obstacles that are vertical prisms, a
    vehicle that is a kinematic point, a target at a known position. It is ``sim.world.CityWorld``
    with one world, which steps thousands at once where you need speed.

    ## Action space

    ``Box(-1, 1, (3,), float32)``, the spherical action of eq. (1):

    | Num | Quantity             | -1            | +1              |
    |-----|----------------------|---------------|-----------------|
    | 0   | step length rho      | 0 m           | 20 m            |
    | 1   | polar angle phi      | 0, up         | pi, down        |
    | 2   | azimuth psi from +x  | 0             | 2 pi            |

    ``scaling=`` changes the ranges and what psi is measured from.

    ## Observation space

    ``Box(float32)``. With ``layout="paper"``, all lengths divided by the edge:

    | Num | Observation             | Min | Max |
    |-----|-------------------------|-----|-----|
    | 0   | x of the vehicle, east  | 0   | 1   |
    | 1   | y of the vehicle, north | 0   | 1   |
    | 2   | z of the vehicle, up    | 0   | 1   |
    | 3   | x of the target         | 0   | 1   |
    | 4   | y of the target         | 0   | 1   |
    | 5   | z of the target         | 0   | 1   |

    Other layouts: ``companion.policy.observation.LAYOUTS``.

    ## Reward

    Eq. (2): ``(1 - beta) exp(-5 D^2) + beta (exp(-100 sigma) - 1)``, beta 0.8; ``D`` is the
    distance to the target after the step and ``sigma`` the length of the step inside obstacles,
    both divided by the edge.

    ## Starting state

    Vehicle and target uniformly random outside the obstacles.

    ## Episode end

    - Termination: never; with ``end_on_contact=True``, when the step crosses an obstacle.
    - Truncation: after ``horizon`` (100) steps; with ``end_on_arrival=True``, also when the
      vehicle comes within ``arrival_radius_m`` (5 m) without a contact before. Arrival
      truncates, because the reward pays for every step at the target.

    ## Info

    ``reached`` (arrived in this episode, no contact before), ``contact`` (in this step),
    ``crash_depth_m``, ``position_enu_m`` and ``target_enu_m``.

    ## Arguments

    Args:
        map: A bundled map's name, a file, or a ``Map``.
        layout: The name of an observation layout.
        scaling: What an action means.
        **options: Passed on to ``CityWorld``: ``horizon``, ``end_on_contact``,
            ``target_motion``, ``reward``, ``dynamics``, ...
    """

    metadata = {"render_modes": []}  # noqa: RUF012  (Gymnasium's own declaration)

    def __init__(
        self,
        map: Map | str = "env1",
        layout: str = "paper",
        scaling: ActionScaling = PAPER_SCALING,
        **options: Any,
    ) -> None:
        if layout not in LAYOUTS:
            raise UsageError(f"layout {layout!r} is unknown, there are {', '.join(LAYOUTS)}")
        self._map = load_map(map) if isinstance(map, str) else map
        self._layout: Layout = LAYOUTS[layout]
        self._scaling = scaling
        self._options = options
        self._world = self._build()
        low, high = self._layout.bounds()
        self.observation_space = gymnasium.spaces.Box(low, high, dtype=np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (3,), dtype=np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float32Array, dict[str, Any]]:
        """Start an episode; the same seed gives the same episodes."""
        super().reset(seed=seed, options=options)
        if seed is not None:
            self._world = self._build()
        observation = self._world.reset()[0]
        return observation, {
            "reached": False,
            "contact": False,
            "crash_depth_m": 0.0,
            "position_enu_m": self._world.position_enu_m[0],
            "target_enu_m": self._world.target_enu_m[0],
        }

    def step(self, action: Float32Array) -> tuple[Float32Array, float, bool, bool, dict[str, Any]]:
        """Fly one step; the class docstring is the specification."""
        result = self._world.step(np.asarray(action)[None, :])
        return (
            result.next_observation[0],
            float(result.reward[0]),
            bool(result.terminated[0]),
            bool(result.truncated[0]),
            {
                "reached": bool(result.reached[0]),
                "contact": bool(result.contact[0]),
                "crash_depth_m": float(result.crash_depth_m[0]),
                "position_enu_m": result.position_enu_m[0],
                "target_enu_m": result.target_enu_m[0],
            },
        )

    def _build(self) -> CityWorld:
        return CityWorld(self._map, self._layout, self._scaling, 1, self.np_random, **self._options)


gymnasium.register(id=ENVIRONMENT_ID, entry_point=CityEnv)
