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


def generator(seed: int, purpose: Purpose) -> np.random.Generator:
    """Return the stream of ``purpose`` under ``seed``.

    The purpose is part of the SeedSequence's spawn key: two purposes never share a stream,
    whatever the seeds.
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(int(purpose),)))
