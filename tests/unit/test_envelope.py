"""The envelope of training: what is outside of it, how the cap falls, what is said, and when."""

import msgspec
import numpy as np
import pytest

from companion.guidance.envelope import LONGEST_LAG_S, SLOWEST_MPS, Envelope, Pace
from companion.guidance.lag_meter import Lag, LagMeter
from companion.policy.action import TARGET_SCALING
from companion.policy.contract import (
    Contract,
    DynamicsContract,
    ObservationContract,
    SeenContract,
)
from companion.policy.observation import PAPER, WAYS
from sim.dynamics import Disturbance, VelocityLag, follow_velocity

V_MAX_MPS = 5.0
PERIOD_S = 0.05
NEVER = np.zeros(3)
SEEN = SeenContract(
    observations=1000,
    tail=0.001,
    columns=((-1.5, 1.5),) * len(WAYS.fields),
    measures={"speed": (0.0, 6.0), "gap": (6.0, 100.0), "sight": (9.0, 50.0)},
)
CONTRACT = Contract(
    observation=ObservationContract.of(WAYS),
    action=TARGET_SCALING,
    dynamics=DynamicsContract(
        edge_m=100.0, edge_low_m=50.0, edge_high_m=1000.0, velocity_lag_s=(0.3, 1.0)
    ),
    map=None,
    avoids_obstacles=True,
    preset="flight",
    stage="obstacles",
    seed=0,
    git_revision="",
    command="",
    seen=SEEN,
)


def see(*, gap_m=100.0, sight_m=50.0, speed_mps=3.0):
    """Return an observation between two walls, with all other rays as long as ``sight_m``."""
    wall_m = np.full(24, sight_m)
    wall_m[[6, 18]] = 0.5 * gap_m
    observation = np.zeros(len(WAYS.fields), dtype=np.float32)
    observation[WAYS.columns.index("velocity_ahead")] = speed_mps / 10.0
    first = WAYS.columns.index("wall_00")
    observation[first : first + 24] = wall_m / (wall_m + 5.0)
    return observation


class Loop:
    """Ticks of a vehicle that follows at once."""

    def __init__(self, contract=CONTRACT, **options):
        self.envelope = Envelope(contract, V_MAX_MPS, **options)
        self.now_s = 100.0
        self.said = []

    def fly(self, seconds, **seen):
        for _ in range(round(seconds / PERIOD_S)):
            self.now_s += PERIOD_S
            if said := self.envelope.watch(self.now_s, NEVER, NEVER, see(**seen)):
                self.said.append(said)
        return self.envelope.cap_mps


def test_nothing_changes_where_all_is_as_in_training():
    loop = Loop()
    assert loop.fly(60.0, gap_m=6.5, sight_m=10.0, speed_mps=5.9) is None
    assert loop.said == []
    velocity = np.array([9.0, 0.0, 0.0])
    assert loop.envelope.limited(velocity) is velocity


@pytest.mark.parametrize(
    ("seen", "share", "words"),
    [
        ({"gap_m": 3.0}, 0.5, "gap 3 m (no less than 6 m in training)"),
        ({"sight_m": 6.0, "gap_m": 12.0}, 0.67, "sight 6 m (no less than 9 m in training)"),
    ],
)
def test_the_cap_falls_with_the_room_there_is_and_recovers(seen, share, words):
    loop = Loop()
    loop.fly(5.0)
    falling = [loop.fly(0.5, **seen) or V_MAX_MPS for _ in range(8)]
    assert falling == sorted(falling, reverse=True)
    assert falling[0] > falling[2] > falling[5] > 0.95 * share * V_MAX_MPS
    assert falling[-1] == pytest.approx(share * V_MAX_MPS, rel=0.05)
    assert loop.said == [f"not as in training: {words}; the speed cap falls"]

    assert loop.fly(1.5) == pytest.approx(falling[-1], rel=0.02), "not at the first look"
    recovering = [loop.fly(1.0) for _ in range(4)]
    assert recovering == sorted(recovering)
    assert loop.fly(30.0) is None
    assert loop.said[1:] == ["as in training again: the speed cap is lifted"]


def test_a_moment_is_no_matter():
    loop = Loop()
    for _ in range(20):
        assert loop.fly(0.3, gap_m=3.0) is None
        loop.fly(0.7)
    assert loop.said == []


def test_at_the_bound_it_does_not_flutter():
    loop = Loop()
    for _ in range(30):
        loop.fly(1.0, gap_m=5.2)
        loop.fly(1.0, gap_m=5.9)  # beyond the bound, but within what is tolerated
    assert len(loop.said) == 1


def test_the_vehicle_keeps_moving():
    loop = Loop()
    assert loop.fly(60.0, gap_m=0.1) == SLOWEST_MPS
    slow = Envelope(CONTRACT, 0.5)
    for tick in range(400):
        slow.watch(PERIOD_S * tick, NEVER, NEVER, see(gap_m=0.1))
    assert slow.cap_mps in (None, 0.5), "a flight slower than that is not hurried"


def test_a_tailwind_is_answered_until_the_speed_is_as_in_training():
    loop, caps = Loop(), []
    cap_mps = None
    for _ in range(300):
        cap_mps = loop.fly(0.2, speed_mps=4.0 + (cap_mps or V_MAX_MPS))
        caps.append(4.0 + (cap_mps or V_MAX_MPS))
    assert max(caps[50:]) < 7.1
    assert np.mean(caps[50:]) == pytest.approx(6.2, abs=0.4)
    assert len(loop.said) == 1, "said once, however long it goes to and fro"


def test_a_velocity_is_shortened_not_turned():
    loop = Loop()
    cap_mps = loop.fly(10.0, gap_m=3.0)
    fast, slow = np.array([3.0, -4.0, 1.0]), np.array([0.3, 0.0, 0.2])
    limited = loop.envelope.limited(fast)
    assert np.linalg.norm(limited) == pytest.approx(cap_mps)
    np.testing.assert_allclose(np.cross(limited, fast), 0.0, atol=1e-12)
    assert loop.envelope.limited(slow) is slow
    assert np.isnan(loop.envelope.limited(np.full(3, np.nan))).all(), "that is for the shield"


@pytest.mark.parametrize("lag_s", [0.5, 1.5])
def test_a_vehicle_slower_than_those_of_training_is_flown_slower(lag_s):
    envelope, said = Envelope(CONTRACT, V_MAX_MPS), []
    rng, gusts = np.random.default_rng(4), Disturbance(0.2, 2.0)
    velocity, sent, gust = np.zeros(3), np.zeros(3), np.zeros(3)
    for tick in range(600):
        if tick % 60 == 0:
            sent = rng.uniform(-4.0, 4.0, 3) * (1.0, 1.0, 0.3)
        measured = velocity + gust + 0.05 * rng.standard_normal(3)
        said.append(envelope.watch(tick * PERIOD_S, measured, sent, see()))
        velocity, _ = follow_velocity(velocity, sent, VelocityLag(lag_s), dt_s=PERIOD_S)
        gust = gusts.advance(gust, dt_s=PERIOD_S, rng=rng)
    said = [text for text in said if text]
    assert envelope.known_lag_s == pytest.approx(lag_s, rel=0.35)
    if lag_s == 0.5:
        assert (said, envelope.cap_mps) == ([], None)
        assert envelope.longer_lag_s(0.8) is None
        return
    assert len(said) == 1
    assert said[0].startswith("not as in training: velocity lag 1.")
    assert envelope.cap_mps == pytest.approx(V_MAX_MPS / envelope.known_lag_s, rel=0.05)
    told_s = envelope.longer_lag_s(0.8)
    assert envelope.known_lag_s <= told_s <= envelope.known_lag_s + 0.1
    assert envelope.longer_lag_s(told_s) is None, "told once"
    assert envelope.longer_lag_s(LONGEST_LAG_S) is None


@pytest.mark.parametrize(
    "changes",
    [
        {"seen": None, "dynamics": DynamicsContract(100.0, 50.0, 1000.0)},
        {"observation": ObservationContract.of(PAPER), "seen": None},
    ],
    ids=["an old contract", "an actor that sees nothing"],
)
def test_who_knows_nothing_of_training_caps_nothing(changes):
    contract = msgspec.structs.replace(CONTRACT, **changes)
    envelope = Envelope(contract, V_MAX_MPS)
    observation = see(gap_m=1.0)[: len(contract.layout.fields)]
    for tick in range(200):
        assert envelope.watch(tick * PERIOD_S, NEVER, NEVER, observation) == ""
    assert envelope.cap_mps is None


def test_numbers_that_are_none_change_nothing():
    loop, nan = Loop(), np.full(3, np.nan)
    broken = np.full(len(WAYS.fields), np.nan, dtype=np.float32)
    for tick in range(100):
        assert loop.envelope.watch(PERIOD_S * tick, nan, NEVER, broken) == ""
        assert loop.envelope.watch(PERIOD_S * tick, NEVER, None, None) == ""
    assert loop.fly(5.0) is None


def test_how_quickly_is_given():
    eager = Loop(pace=Pace(enter_s=0.0, fall_s=0.05))
    assert eager.fly(1.0, gap_m=3.0) == pytest.approx(2.5, rel=0.02)
    patient = Loop(pace=Pace(enter_s=5.0))
    assert patient.fly(4.0, gap_m=3.0) is None


@pytest.mark.parametrize(("seconds", "slowed"), [(1.5, False), (3.0, True)])
def test_a_lag_that_is_beyond_its_bound_for_a_moment_slows_nobody(monkeypatch, seconds, slowed):
    """As it is measured after a gust."""
    loop = Loop()
    loop.fly(10.0)
    monkeypatch.setattr(LagMeter, "lag", lambda _: Lag(likely_s=1.6, least_s=1.3))
    loop.fly(seconds)
    monkeypatch.undo()
    assert (loop.envelope.cap_mps is not None) == slowed
