"""What one check of the shield costs, on 25 obstacles and more: run with ``--benchmark-only``."""

import numpy as np
import pytest

from companion.guidance.braking import Braking
from companion.guidance.drift import CALM, Drift, DriftObserver
from companion.guidance.shield import Shield, ShieldReason
from companion.guidance.shield_limits import ShieldLimits
from companion.world.maps import build_map

BLOCK = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])


def blocks(side):
    """Return a map of ``side`` by ``side`` blocks, 10 m apart."""
    along = np.arange(side) * 20.0 + 5.0
    corners = np.stack(np.meshgrid(along, along), -1).reshape(-1, 2)
    return build_map(
        "blocks",
        (20.0 * side, 20.0 * side, 100.0),
        [corner + BLOCK for corner in corners],
        [20.0 + 1.5 * (k % 25) for k in range(side * side)],
    )


CITY = blocks(5)
CASES = {
    "far": ([50.0, 50.0, 90.0], [2.0, 0.0, 0.0], ShieldReason.CLEAR),
    "street": ([20.0, 40.0, 12.0], [0.0, 4.0, 0.0], ShieldReason.CLEAR),
    "slide": ([22.8, 30.0, 12.0], [3.0, 3.0, 0.0], ShieldReason.OBSTACLE),
    "corner": ([22.8, 22.0, 12.0], [3.0, 3.0, -1.0], ShieldReason.OBSTACLE),
    "head-on": ([22.9, 30.0, 12.0], [4.0, 0.0, 0.0], ShieldReason.BLOCKED),
    "margin": ([23.2, 30.0, 12.0], [4.0, 0.0, 0.0], ShieldReason.LEADING_OUT),
    "emergency": ([21.0, 30.0, 12.0], [5.0, 0.0, 0.0], ShieldReason.EMERGENCY),
}


@pytest.mark.parametrize("drift", [CALM, Drift(np.array([0.3, -0.2, 0.1]), 0.8)], ids=["", "gust"])
@pytest.mark.parametrize("case", CASES)
def test_one_check(benchmark, case, drift):
    position, proposal, reason = CASES[case]
    shield = Shield(CITY, ShieldLimits())
    now = np.array(proposal) * (0.9 if case == "emergency" else 0.05)
    decision = benchmark(
        shield.check,
        np.array(proposal),
        position_enu_m=np.array(position),
        velocity_now_enu_mps=now,
        drift=drift,
    )
    assert decision.reason is reason


def test_one_look_for_drift(benchmark):
    observer, braking = DriftObserver(), Braking(0.8, 1.6)
    sent = np.array([3.0, 0.0, 0.0])
    benchmark(observer.update, np.array([2.0, 0.5, 0.0]), sent, braking, dt_s=0.05)


@pytest.mark.parametrize("side", [5, 17, 45])
def test_one_check_in_a_town(benchmark, side):
    position, proposal, reason = CASES["slide"]
    shield = Shield(blocks(side), ShieldLimits())
    decision = benchmark(
        shield.check,
        np.array(proposal),
        position_enu_m=np.array(position),
        velocity_now_enu_mps=0.05 * np.array(proposal),
    )
    assert decision.reason is reason
