"""The lag meter: simulated vehicles in gusts on a lossy link, and real autopilots' recordings."""

import lzma

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.guidance.lag_meter import LAGS_S, LagMeter
from companion.guidance.shield_limits import ShieldLimits
from companion.link.boot_clock import BootClock
from sim.dynamics import Disturbance, VelocityLag, follow_velocity
from tests.conftest import DATA, read_tlog

PERIOD_S = 0.05
STEP_S = 0.01


def fly(lag, seed, *, seconds=20.0, shortfall=0.0, wind=0.5, noise=0.1, loss=0.2, turn_s=2.5):
    """Return the meter of a vehicle that is sent another velocity every ``turn_s``."""
    rng, meter = np.random.default_rng(seed), LagMeter()
    gusts = Disturbance(wind, 2.0)
    gust, velocity, obeyed, sent = gusts.sample(rng, (3,)), np.zeros(3), np.zeros(3), np.zeros(3)
    measured = velocity
    for tick in range(round(seconds / PERIOD_S)):
        if tick % round(turn_s / PERIOD_S) == 0:
            sent = rng.uniform(2.0, 4.0) * direction(rng)
        if rng.random() >= loss:
            measured = velocity + gust + noise * rng.standard_normal(3)
        meter.sent(tick * PERIOD_S, sent)
        meter.measured(tick * PERIOD_S, measured)
        if rng.random() >= loss:
            obeyed = sent
        velocity, _ = follow_velocity(velocity, (1.0 - shortfall) * obeyed, lag, dt_s=PERIOD_S)
        gust = gusts.advance(gust, dt_s=PERIOD_S, rng=rng)
    return meter


def direction(rng):
    vector = rng.standard_normal(3) * (1.0, 1.0, 0.3)
    return vector / np.linalg.norm(vector)


@pytest.mark.parametrize("lag_s", [0.2, 0.3, 0.5, 0.8, 1.0, 1.5])
@pytest.mark.parametrize("acceleration_mps2", [1.6, 4.0])
def test_the_lag_is_found_in_gusts_noise_and_loss(lag_s, acceleration_mps2):
    lags = [fly(VelocityLag(lag_s, acceleration_mps2), seed).lag() for seed in range(8)]
    likely_s = np.median([lag.likely_s for lag in lags])
    assert 0.6 * lag_s < likely_s < 1.4 * lag_s + 0.1, "lost packets are lag, too"
    assert max(lag.least_s for lag in lags) < 1.4 * lag_s


def test_a_slow_vehicle_is_told_from_those_of_training_for_sure():
    slow = [fly(VelocityLag(1.5), seed, seconds=30.0).lag().least_s for seed in range(8)]
    assert np.mean(np.array(slow) > 1.1) > 0.5
    usual = [fly(VelocityLag(0.8), seed, seconds=30.0).lag().least_s for seed in range(8)]
    assert max(usual) < 1.0


def test_without_noise_it_takes_seconds():
    lag = fly(VelocityLag(1.5), 0, seconds=4.0, wind=0.0, noise=0.0, loss=0.0).lag()
    assert lag.least_s > 1.1
    assert lag.likely_s == pytest.approx(1.5, rel=0.3)


def test_a_steady_wind_and_falling_short_are_no_lag():
    lags = [fly(VelocityLag(0.5), seed, shortfall=0.16).lag().likely_s for seed in range(8)]
    assert np.median(lags) == pytest.approx(0.5, abs=0.2)


def test_who_does_not_move_has_told_nothing():
    meter = LagMeter()
    rng = np.random.default_rng(0)
    for tick in range(400):
        meter.sent(tick * PERIOD_S, np.zeros(3))
        meter.measured(tick * PERIOD_S, 0.1 * rng.standard_normal(3))
    assert meter.lag().least_s == LAGS_S[0]


def test_what_somebody_else_flies_counts_for_nothing():
    watched, left_alone = (fly(VelocityLag(0.8), 1) for _ in range(2))
    rng = np.random.default_rng(0)
    for tick in range(400, 500):  # thrown about by a pilot
        watched.sent(tick * PERIOD_S, None)
        watched.measured(tick * PERIOD_S, 5.0 * rng.standard_normal(3))
    assert watched.lag() == left_alone.lag()


def fly_starved(lag, seed, *, by_stamp, seconds=60.0):
    """Return the meter of a vehicle whose computers all get the processor late, again and again.

    Ticks come late, and so do positions, 30 a second, each with a time stamp: told by that or, as
    if there were none, by the time of the tick that sees it.
    """
    rng, meter, clock = np.random.default_rng(seed), LagMeter(), BootClock()
    gusts, velocity, sent = Disturbance(0.3, 2.0), np.zeros(3), np.zeros(3)
    gust, tick_s, awake_s, reads_s = gusts.sample(rng, (3,)), 0.0, 0.0, 0.0
    on_the_way, seen = [], None
    for step in range(round(seconds / STEP_S)):
        now_s = step * STEP_S
        velocity, _ = follow_velocity(velocity, sent, lag, dt_s=STEP_S)
        gust = gusts.advance(gust, dt_s=STEP_S, rng=rng)
        if step % 3 == 0:
            on_the_way.append((now_s, velocity + gust + 0.05 * rng.standard_normal(3)))
        if now_s >= reads_s:  # the far end has the processor, and what it made goes out
            if rng.random() < 0.03:
                reads_s = now_s + rng.exponential(0.15)
            for measured_s, measured in on_the_way:
                clock.hear(round(1e3 * measured_s), now_s)
                seen = (clock.time_s(round(1e3 * measured_s)) if by_stamp else None, measured)
            on_the_way.clear()
        if now_s >= max(tick_s, awake_s) and seen is not None:
            if rng.random() < 0.1:
                awake_s = now_s + rng.exponential(0.15)
            if rng.random() < PERIOD_S / 2.5:
                sent = rng.uniform(2.0, 4.0) * direction(rng)
            meter.sent(now_s, sent)
            meter.measured(now_s if seen[0] is None else seen[0], seen[1])
            tick_s = PERIOD_S * (now_s // PERIOD_S + 1.0)
    return meter


def test_positions_and_ticks_that_come_late_are_no_lag():
    stamped = [fly_starved(VelocityLag(0.7), seed, by_stamp=True).lag() for seed in range(8)]
    assert np.median([lag.likely_s for lag in stamped]) == pytest.approx(0.7, abs=0.1)
    assert max(lag.least_s for lag in stamped) < 1.1 * ShieldLimits().lag_s
    plain = [fly_starved(VelocityLag(0.7), seed, by_stamp=False).lag() for seed in range(8)]
    sure = [np.mean([lag.least_s for lag in lags]) for lags in (stamped, plain)]
    assert sure[0] > sure[1], "time stamps leave less to chance"


def test_a_slow_vehicle_is_told_by_a_starved_computer_too():
    slow = [fly_starved(VelocityLag(1.5), seed, by_stamp=True).lag() for seed in range(8)]
    assert np.median([lag.likely_s for lag in slow]) == pytest.approx(1.5, rel=0.25)
    assert np.median([lag.least_s for lag in slow]) > 1.1


@pytest.mark.parametrize(
    "name", ["ap_short_flight_companion.tlog.xz", "px4_short_flight_companion_30s.tlog.xz"]
)
def test_real_autopilots_lag_no_more_than_the_shield_reckons_with(name):
    reader, meter, clock = dialect.MAVLink(None), LagMeter(), BootClock()
    reader.robust_parsing = True
    for time_s, frame in read_tlog(lzma.decompress((DATA / name).read_bytes())):
        message = reader.decode(bytearray(frame))
        if message.get_type() == "SET_POSITION_TARGET_LOCAL_NED":
            velocity = (message.vx, message.vy, message.vz)
            meter.sent(time_s, np.array(velocity) if message.type_mask & 0x7 == 0x7 else None)
        elif message.get_type() == "LOCAL_POSITION_NED":
            clock.hear(message.time_boot_ms, time_s)
            measured_s = clock.time_s(message.time_boot_ms)
            meter.measured(measured_s, np.array((message.vx, message.vy, message.vz)))
    assert meter.lag().likely_s < ShieldLimits().lag_s
