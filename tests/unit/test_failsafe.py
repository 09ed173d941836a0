"""What the vehicle does without us: words and figures from its parameters alone."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.guidance.failsafe import (
    ARDUPILOT_DEFAULTS,
    PX4_DEFAULTS,
    failsafe_of,
    parameters_wanted,
)

NO_TRANSMITTER = {"COM_RC_IN_MODE": 4}


def test_px4_as_its_simulator_is_set_up():
    failsafe = failsafe_of("px4", {**PX4_DEFAULTS, **NO_TRANSMITTER, "RTL_RETURN_ALT": 30.0})
    assert failsafe.sentence == (
        "if this program dies, PX4 flies on for 1.0 s, then climbs to 30 m above home, flies "
        "back and lands"
    )
    assert failsafe.assumed == ()


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({}, "with a pilot's transmitter: Position mode"),
        ({"COM_OBL_RC_ACT": 1}, "Altitude mode"),
        ({"COM_OBL_RC_ACT": 3, "RTL_RETURN_ALT": 45.0}, "then climbs to 45 m"),
        ({"COM_OBL_RC_ACT": 4}, "then lands"),
        ({"COM_OBL_RC_ACT": 5}, "then holds"),
        ({"COM_OBL_RC_ACT": 6}, "TERMINATES"),
        ({"COM_OBL_RC_ACT": 7}, "DISARMS"),
        ({"COM_OBL_RC_ACT": 99}, "does what COM_OBL_RC_ACT 99 means"),
        ({**NO_TRANSMITTER, "NAV_RCL_ACT": 1}, "then holds"),
        ({**NO_TRANSMITTER, "NAV_RCL_ACT": 3}, "then lands"),
    ],
)
def test_each_action_of_px4_in_words(parameters, words):
    assert words in failsafe_of("px4", parameters).sentence


@pytest.mark.parametrize(
    ("version", "parameters", "words"),
    [
        ("1.16.0", {}, "then comes down where it is and lands (with a pilot's transmitter: Pos"),
        ("1.16.0", NO_TRANSMITTER, "then comes down where it is and lands"),
        ("1.17.1", {"COM_OBL_RC_ACT": 2}, "with nobody at the sticks"),
        ("1.17.1", {"COM_OBL_RC_ACT": 3}, "then climbs to 60 m"),
        ("1.18.0 beta", {}, "then climbs to 60 m"),
        ("", {}, "then climbs to 60 m"),
    ],
)
def test_px4_before_1_18_does_not_look_for_a_transmitter(version, parameters, words):
    assert words in failsafe_of("px4", parameters, version).sentence


def test_a_lost_transmitter_may_be_excepted_in_offboard():
    assert "climbs" in failsafe_of("px4", {"COM_RCL_EXCEPT": 3}).notes[0]
    assert "flies on in OFFBOARD" in failsafe_of("px4", {"COM_RCL_EXCEPT": 4}).notes[0]


def test_ardupilot_hovers_and_tells_nobody():
    failsafe = failsafe_of("ardupilot", ARDUPILOT_DEFAULTS)
    assert "flies on for 3.0 s, then hovers in GUIDED" in failsafe.sentence
    assert "FS_GCS_ENABLE 0" in failsafe.notes[0]
    assert "FENCE_ENABLE 0" in failsafe.notes[1]
    strict = failsafe_of("ardupilot", {"FS_GCS_ENABLE": 5, "FENCE_ENABLE": 1, "RTL_ALT": 2500})
    assert strict.notes == (
        "if the ground station is lost, it lands after 5 s",
        "at ArduPilot's own fence it returns, or lands",
        "a return climbs to 25 m above home",
    )


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_what_is_not_known_is_assumed_and_named(autopilot):
    silent = failsafe_of(autopilot, {})
    assert silent.assumed == parameters_wanted(autopilot)
    known = failsafe_of(autopilot, {silent.assumed[0]: 0.5})
    assert known.assumed == silent.assumed[1:]
    assert known.loss_s == 0.5


@pytest.mark.parametrize("nonsense", [math.nan, math.inf, -1.0])
def test_nonsense_is_not_believed(nonsense):
    failsafe = failsafe_of("px4", {"COM_OF_LOSS_T": nonsense, "MPC_ACC_HOR": nonsense})
    assert failsafe.loss_s == 1.0
    assert "COM_OF_LOSS_T" in failsafe.assumed


@pytest.mark.parametrize(
    ("autopilot", "speed_mps", "measured_m"), [("ardupilot", 3.07, 12.1), ("px4", 2.54, 4.8)]
)
def test_blind_travel_agrees_with_what_was_measured(autopilot, speed_mps, measured_m):
    travel_m = failsafe_of(autopilot, {}).blind_travel_m(speed_mps)
    assert travel_m == pytest.approx(measured_m, rel=0.04)


@pytest.mark.parametrize(
    ("autopilot", "parameters", "safe_mps"),
    [("px4", {}, 2.6), ("ardupilot", {}, 1.4), ("ardupilot", {"GUID_TIMEOUT": 0.5}, 3.2)],
)
def test_safe_speed_within_five_metres(autopilot, parameters, safe_mps):
    assert failsafe_of(autopilot, parameters).v_max_safe_mps(5.0) == pytest.approx(
        safe_mps, abs=0.05
    )


@given(
    st.floats(0.0, 60.0),
    st.just(0.0) | st.floats(0.1, 500.0),
    st.floats(0.5, 20.0),
    st.sampled_from(["px4", "ardupilot"]),
)
def test_the_safe_speed_uses_up_the_margin(loss_s, brake, margin_m, autopilot):
    names = {"px4": ("COM_OF_LOSS_T", "MPC_ACC_HOR"), "ardupilot": ("GUID_TIMEOUT", "WPNAV_ACCEL")}
    loss, accel = names[autopilot]
    failsafe = failsafe_of(autopilot, {loss: loss_s, accel: brake})
    v_mps = failsafe.v_max_safe_mps(margin_m)
    assert v_mps > 0.0
    assert failsafe.blind_travel_m(v_mps) == pytest.approx(
        min(margin_m, failsafe.blind_travel_m(failsafe.speed_limit_mps)), rel=1e-6
    )


def test_the_vehicle_flies_no_faster_than_its_own_limit():
    failsafe = failsafe_of("px4", {"MPC_XY_VEL_MAX": 2.0})
    assert failsafe.blind_travel_m(12.0) == failsafe.blind_travel_m(2.0)


def test_a_speed_that_keeps_the_margin_is_left_alone():
    failsafe = failsafe_of("px4", {})
    for obey in (False, True):
        cap = failsafe.cap(1.0, 5.0, obey=obey)
        assert (cap.v_max_mps, cap.exceeds) == (1.0, False)


def test_a_speed_beyond_the_margin_is_told_and_lowered_only_when_asked():
    failsafe = failsafe_of("px4", {})
    told, lowered = (failsafe.cap(5.0, 2.0, obey=obey) for obey in (False, True))
    assert (told.v_max_mps, told.exceeds) == (5.0, True)
    assert "13.3 m" in told.words
    assert "1.3 m/s" in told.words
    assert lowered.v_max_mps == pytest.approx(1.32, abs=0.01)
    assert failsafe.blind_travel_m(lowered.v_max_mps) <= 2.0 + 1e-9
    assert "lowered from 5 to 1.3 m/s" in lowered.words
