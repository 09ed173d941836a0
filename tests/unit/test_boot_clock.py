"""The autopilot's clock on ours."""

import numpy as np
import pytest

from companion.link.boot_clock import BootClock


def told_s(made_s, arrival_s, *, pace=1.0, behind_s=900.0):
    """Return what the clock says of every message, as it comes."""
    clock, said = BootClock(), []
    for made, arrival in zip(made_s, arrival_s, strict=True):
        boot_ms = round(1e3 * (pace * made - behind_s))
        clock.hear(boot_ms, arrival)
        said.append(clock.time_s(boot_ms))
    return np.array(said)


def test_before_anything_was_heard_nothing_is_known():
    assert BootClock().time_s(1000) is None


def test_a_message_is_as_old_as_its_stamp_says_however_late_it_came():
    made_s = 1000.0 + np.arange(300) / 30.0
    late_s = np.random.default_rng(0).exponential(0.03, 300)
    arrival_s = np.maximum.accumulate(made_s + late_s)
    assert (arrival_s - made_s).max() > 0.2
    np.testing.assert_allclose(told_s(made_s, arrival_s), made_s, atol=0.025)


@pytest.mark.parametrize("pace", [0.97, 0.9999, 1.0001, 4.0])
def test_a_clock_of_another_pace_is_followed(pace):
    arrival_s = 1000.0 + np.arange(900) / 30.0
    said_s = told_s(arrival_s, arrival_s, pace=pace)
    assert np.all(said_s <= arrival_s + 1e-3)
    np.testing.assert_allclose(said_s, arrival_s, atol=3.0 * max(0.0, 1.0 - pace) + 2e-3)


def test_after_a_reboot_it_begins_anew():
    clock = BootClock()
    clock.hear(60_000, 1000.0)
    clock.forget()
    assert clock.time_s(60_000) is None
    clock.hear(500, 1010.0)
    assert clock.time_s(700) == pytest.approx(1010.2)
