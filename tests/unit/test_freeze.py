"""A position that comes and comes and never changes."""

import numpy as np
import pytest

from companion.guidance.freeze import FROZEN_S, FreezeDetector

HERE = np.array([3.0, 4.0, -5.0])
STILL, FAST = np.zeros(3), np.array([0.0, 2.0, 0.0])


def frozen_after_s(velocity_mps, *, commanded_mps=0.0, moves=False, until_s=5.0):
    """Return when it is found frozen, ``None`` for never."""
    detector, rng = FreezeDetector(), np.random.default_rng(0)
    for time_s in np.arange(0.0, until_s, 0.05):
        position = HERE + 1e-6 * rng.normal(size=3) if moves else HERE.copy()
        if detector.look(position, velocity_mps, time_s=time_s, commanded_mps=commanded_mps):
            return time_s
    return None


def test_who_stands_and_is_to_stand_is_not_frozen():
    assert frozen_after_s(STILL) is None


def test_who_says_it_moves_is():
    assert frozen_after_s(FAST) == pytest.approx(FROZEN_S)


def test_who_was_told_to_move_is_after_a_while():
    assert frozen_after_s(STILL, commanded_mps=2.0) == pytest.approx(2.0 * FROZEN_S, abs=0.06)


def test_a_micrometre_is_life():
    assert frozen_after_s(FAST, commanded_mps=2.0, moves=True) is None


def test_frozen_stays_frozen_until_the_position_changes_whatever_is_commanded():
    detector = FreezeDetector()
    for time_s in (0.0, 0.1, 1.2):
        detector.look(HERE, STILL, time_s=time_s, commanded_mps=2.0)
    assert detector.look(HERE, STILL, time_s=2.0, commanded_mps=0.0)
    assert not detector.look(HERE + 1e-3, STILL, time_s=2.1, commanded_mps=0.0)
