"""Random streams that cannot overlap: one per seed and purpose."""

from enum import IntEnum

import numpy as np


class Purpose(IntEnum):
    """What a stream of random numbers is for; the key that keeps cases held out."""

    WORLD = 1
    """Starts, targets and restarts of training."""
    EXPLORATION = 2
    REPLAY = 3
    NETWORKS = 4
    VALIDATION = 5
    """Cases that choose the checkpoint."""
    TEST = 6
    """Cases of ``training evaluate``, never seen by training nor by its choice."""


def generator(seed: int, purpose: Purpose, part: int | None = None) -> np.random.Generator:
    """Return the stream of ``purpose`` under ``seed``, or of a part of what it is for.

    Purpose and part are in the SeedSequence's spawn key: two of them never share a stream,
    whatever the seeds.
    """
    key = (int(purpose),) if part is None else (int(purpose), part)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
