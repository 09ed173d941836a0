"""What one step of all worlds brings."""

from dataclasses import dataclass

from companion.arrays import BoolArray, Float32Array, FloatArray
from sim.episodes import EpisodeEnd


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
