"""The table of ``training evaluate``."""

import numpy as np

from sim.episodes import EpisodeEnd
from training.evaluate import summarise
from training.evaluation_table import Flown, evaluation_table


def evaluation(reached):
    reached = np.array(reached)
    length_m = np.full(len(reached), 50.0)
    ended = EpisodeEnd(
        world=np.arange(len(reached)),
        steps=np.full(len(reached), 9),
        reached=reached,
        contact=~reached,
        contact_first=~reached,
        distance_m=length_m,
        min_distance_m=np.where(reached, 1.5, 20.0),
        straight_m=length_m,
        path_length_m=length_m,
        reward_sum=length_m,
    )
    return summarise(ended, np.where(reached, 2.5, -0.5), seconds=1.0)


def test_what_came_with_the_shield_stands_below_what_came_alone():
    all_of_them, half = evaluation([True] * 1000), evaluation([True, False] * 500)
    table = evaluation_table(
        "title", {"an actor of a very long name": Flown(half, all_of_them), "b": Flown(half, None)}
    )
    lines = table.splitlines()
    assert max(map(len, lines)) <= 80
    assert [line[:20].rstrip() for line in lines] == [
        "title",
        "",
        "an actor of a ve...",
        "  with shield",
        "b",
    ]
    done, interval, collided, late, two_m, one_m, spl, clear = lines[2][20:].split()
    assert (done, interval, collided, late) == ("50.0", "46.9-53.1", "50.0", "0.0")
    assert (two_m, one_m, spl, clear) == ("50.0", "0.0", "0.50", "-0.5")
    assert lines[3].split()[2:5] == ["100.0", "99.6-100.0", "0.0"]
