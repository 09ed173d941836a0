"""Cases in parts: every case once, evenly over the maps, whatever is flown beside it."""

import numpy as np
import pytest

from companion.policy.action import TARGET_SCALING
from companion.policy.observation import RELATIVE
from companion.world.maps import build_map
from training.evaluate import fly_straight
from training.loop import LoopFlights, evaluate_loop, fly_part
from training.parts import PART_CASES, parts_of
from training.seeds import Purpose, generator


def maps(count):
    return [build_map(f"map {number}", (100, 100, 100), [], []) for number in range(count)]


@pytest.mark.parametrize(
    ("num_maps", "episodes", "sizes"),
    [
        (1, 1, [1]),
        (1, 125, [125]),
        (1, 300, [100, 100, 100]),
        (2, 126, [63, 63]),
        (3, 400, [67, 67, 66, 67, 66, 67]),
        (200, 10_000, [100] * 100),
        (100, 1_000, [120] * 8 + [40]),
        (50, 400, [120, 120, 120, 40]),
    ],
)
def test_every_case_once_on_the_maps_in_turn(num_maps, episodes, sizes):
    cities = maps(num_maps)
    parts = parts_of(cities, episodes)
    assert [part.number for part in parts] == list(range(len(parts)))
    assert [part.episodes for part in parts] == sizes
    assert max(sizes) <= PART_CASES
    flown = np.zeros(num_maps)
    for part in parts:
        for city in part.maps:
            flown[cities.index(city)] += part.episodes / len(part.maps)
    np.testing.assert_allclose(flown, episodes / num_maps, atol=1.0)


def test_fewer_cases_than_maps_are_refused():
    with pytest.raises(ValueError, match="a case for each of 3 maps, got 2"):
        parts_of(maps(3), 2)


def test_a_part_does_not_depend_on_the_others():
    options = {"v_max_mps": 5.0, "seed": 3, "purpose": Purpose.VALIDATION, "now_s": lambda: 0.0}
    place = (RELATIVE, TARGET_SCALING)
    cities = maps(2)
    last, first = (
        fly_part(fly_straight, part, *place, **options) for part in parts_of(cities, 140)[::-1]
    )
    whole = evaluate_loop(fly_straight, cities, *place, episodes=140, **options)
    assert LoopFlights.joined([first, last]).evaluation() == whole
    assert whole.episodes == 140
    assert (first.ended.straight_m != last.ended.straight_m).all()


def test_no_two_parts_share_a_stream():
    draws = [generator(1, Purpose.TEST, part).random() for part in (None, 0, 1)]
    assert len(set(draws)) == 3
