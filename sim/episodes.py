"""The books of running episodes, one row per world, and how they closed."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from companion.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class EpisodeEnd:
    """How the episodes that ended in one step went; ``K`` of the worlds, maybe none."""

    world: IntArray  # (K,)
    """Which worlds, ascending."""
    steps: IntArray  # (K,)
    reached: BoolArray  # (K,)
    """Came within the arrival radius with no contact before."""
    contact: BoolArray  # (K,)
    """Touched an obstacle at any time."""
    contact_first: BoolArray  # (K,)
    """Touched an obstacle before it arrived: a failure (E10)."""
    distance_m: FloatArray  # (K,)
    """From the target, at the end."""
    min_distance_m: FloatArray  # (K,)
    """Smallest after any step before the first contact; infinite if there was none. With
    5, 2 and 1 m it gives the completion rates of E9."""
    straight_m: FloatArray  # (K,)
    """From the start to where the target was then."""
    path_length_m: FloatArray  # (K,)
    """Way flown until the arrival, or in all."""
    reward_sum: FloatArray  # (K,)
    """Undiscounted."""

    @classmethod
    def joined(cls, several: Sequence["EpisodeEnd"]) -> "EpisodeEnd":
        """Return the episodes of several, in their order."""
        return cls(
            **{
                f.name: np.concatenate([getattr(one, f.name) for one in several])
                for f in fields(cls)
            }
        )

    def take(self, rows: IntArray) -> "EpisodeEnd":
        """Return some of the episodes."""
        return EpisodeEnd(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})


@dataclass(slots=True)
class Episodes:
    """What is counted while episodes run, one entry per world, shape ``(N,)``."""

    steps: IntArray
    contact: BoolArray
    contact_first: BoolArray
    reached: BoolArray
    min_distance_m: FloatArray
    straight_m: FloatArray
    path_length_m: FloatArray
    reward_sum: FloatArray

    @classmethod
    def unstarted(cls, num_worlds: int) -> "Episodes":
        """Return books for ``num_worlds``; ``start`` opens them."""
        return cls(
            steps=np.zeros(num_worlds, dtype=np.int64),
            contact=np.zeros(num_worlds, dtype=np.bool_),
            contact_first=np.zeros(num_worlds, dtype=np.bool_),
            reached=np.zeros(num_worlds, dtype=np.bool_),
            min_distance_m=np.zeros(num_worlds),
            straight_m=np.zeros(num_worlds),
            path_length_m=np.zeros(num_worlds),
            reward_sum=np.zeros(num_worlds),
        )

    def start(self, worlds: IntArray, straight_m: FloatArray) -> None:
        """Open new episodes in ``worlds``, ``straight_m`` away from their targets."""
        for column in fields(self):
            getattr(self, column.name)[worlds] = 0
        self.min_distance_m[worlds] = np.inf
        self.straight_m[worlds] = straight_m

    def record(
        self,
        *,
        reward: FloatArray,
        contact: BoolArray,
        distance_m: FloatArray,
        flown_m: FloatArray,
        arrival_radius_m: float,
    ) -> None:
        """Book one step of every world; all arrays are ``(N,)``."""
        self.steps += 1
        self.reward_sum += reward
        self.path_length_m += np.where(self.reached, 0.0, flown_m)
        self.contact |= contact
        self.contact_first |= contact & ~self.reached
        np.minimum(self.min_distance_m, distance_m, out=self.min_distance_m, where=~self.contact)
        self.reached |= ~self.contact & (distance_m < arrival_radius_m)

    def take(self, worlds: IntArray) -> "Episodes":
        """Return the books of some worlds."""
        return Episodes(**{f.name: getattr(self, f.name)[worlds] for f in fields(self)})

    def end(self, worlds: IntArray, distance_m: FloatArray) -> EpisodeEnd:
        """Return the closed books of ``worlds``; ``distance_m`` is ``(N,)``."""
        return EpisodeEnd(
            world=worlds,
            distance_m=distance_m[worlds],
            **{column.name: getattr(self, column.name)[worlds] for column in fields(self)},
        )
