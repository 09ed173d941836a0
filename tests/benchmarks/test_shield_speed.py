"""What one check of the shield costs on 25 obstacles: run with ``--benchmark-only``."""

import numpy as np
import pytest

from companion.guidance.shield import Shield, ShieldLimits, ShieldReason
from companion.world.maps import build_map

CORNERS = np.stack(np.meshgrid(np.arange(5) * 20.0 + 5, np.arange(5) * 20.0 + 5), -1).reshape(-1, 2)
BLOCK = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
CITY = build_map(
    "blocks",
    (100, 100, 100),
    [corner + BLOCK for corner in CORNERS],
    [20.0 + 1.5 * k for k in range(25)],
)
CASES = {
    "far": ([50.0, 50.0, 90.0], [2.0, 0.0, 0.0], ShieldReason.CLEAR),
    "street": ([20.0, 40.0, 12.0], [0.0, 4.0, 0.0], ShieldReason.CLEAR),
    "slide": ([22.8, 30.0, 12.0], [3.0, 3.0, 0.0], ShieldReason.OBSTACLE),
    "corner": ([22.8, 22.0, 12.0], [3.0, 3.0, -1.0], ShieldReason.OBSTACLE),
    "head-on": ([22.9, 30.0, 12.0], [4.0, 0.0, 0.0], ShieldReason.BLOCKED),
    "margin": ([23.2, 30.0, 12.0], [4.0, 0.0, 0.0], ShieldReason.LEADING_OUT),
    "emergency": ([21.0, 30.0, 12.0], [5.0, 0.0, 0.0], ShieldReason.EMERGENCY),
}


@pytest.mark.parametrize("case", CASES)
def test_one_check(benchmark, case):
    position, proposal, reason = CASES[case]
    shield = Shield(CITY, ShieldLimits())
    now = np.array(proposal) * (0.9 if case == "emergency" else 0.05)
    decision = benchmark(
        shield.check,
        np.array(proposal),
        position_enu_m=np.array(position),
        velocity_now_enu_mps=now,
    )
    assert decision.reason is reason
