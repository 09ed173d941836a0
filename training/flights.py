"""Test cases flown step by step with their paths kept: what figures draw and tables count."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from companion.arrays import BoolArray, FloatArray, IntArray
from sim.episodes import EpisodeEnd
from sim.world import CityWorld
from training.evaluate import Policy

Outcome = Literal["reached", "collided", "timed out"]


@dataclass(frozen=True, slots=True)
class Flight:
    """One case from its start to its arrival, its first contact or the end of its time."""

    position_enu_m: FloatArray  # (T + 1, 3)
    target_enu_m: FloatArray  # (T + 1, 3)
    outcome: Outcome

    @property
    def distance_m(self) -> FloatArray:
        """Return the distance to the target at every point, ``(T + 1,)``."""
        distance_m: FloatArray = np.linalg.norm(self.target_enu_m - self.position_enu_m, axis=1)
        return distance_m


@dataclass(frozen=True, slots=True)
class Flights:
    """``N`` cases, flown on to step ``T`` whatever becomes of them."""

    position_enu_m: FloatArray  # (T + 1, N, 3)
    target_enu_m: FloatArray  # (T + 1, N, 3)
    last: IntArray  # (N,)
    """Step of the arrival or of the first contact, whichever came first, or of the end of the
    episode; T without any."""
    reached: BoolArray  # (N,)
    contact: BoolArray  # (N,)
    """Touched an obstacle before it arrived."""

    def __iter__(self) -> Iterator[Flight]:
        """Iterate over the cases in their order."""
        return (self.case(number) for number in range(len(self.last)))

    def case(self, number: int) -> Flight:
        """Return one case, cut where it was decided."""
        end = int(self.last[number]) + 1
        outcome: Outcome = "timed out"
        if self.reached[number]:
            outcome = "reached"
        elif self.contact[number]:
            outcome = "collided"
        return Flight(self.position_enu_m[:end, number], self.target_enu_m[:end, number], outcome)


def fly(world: CityWorld, policy: Policy) -> tuple[Flights, EpisodeEnd]:
    """Fly one episode in every world, from the next ``reset`` to its horizon.

    Args:
        world: Where; an episode may end early, what follows it is not counted.
        policy: What flies.

    Returns:
        The flights, and the books of the episodes that ended with the last step: of all of
        them, where none ends early.
    """
    observation = world.reset()
    count = world.num_worlds
    position_m, target_m = [world.position_enu_m], [world.target_enu_m]
    last = np.full(count, world.horizon)
    open_: BoolArray = np.ones(count, dtype=np.bool_)
    reached, contact = np.zeros_like(open_), np.zeros_like(open_)
    for step in range(1, world.horizon + 1):
        result = world.step(policy(world, observation))
        observation = result.observation
        position_m.append(result.position_enu_m)
        target_m.append(result.target_enu_m)
        reached |= open_ & result.reached
        contact |= open_ & result.contact & ~result.reached
        over = open_ & (result.reached | result.contact | result.terminated | result.truncated)
        last[over] = step
        open_ &= ~over
    flights = Flights(np.stack(position_m), np.stack(target_m), last, reached, contact)
    return flights, result.episode_end
