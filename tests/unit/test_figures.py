"""Curves out of logs, and figures out of curves."""

import numpy as np
import pytest

from companion.world.maps import load_map
from training.curves import (
    Curve,
    band,
    read_log,
    saturation_curves,
    smoothed,
    training_curve,
    validation_curve,
)
from training.figure_curves import Bar, Level, draw_ablations, draw_completion, draw_rewards
from training.figure_paths import draw_chase, draw_paths
from training.flights import Flight
from training.report_data import FlightRecord, Scene
from training.report_words import another_seed, listed_by_seed

LOG = """\
{"kind":"training","updates":10,"return":null,"saturated":[0.1,0.2,0.3]}
{"kind":"training","updates":20,"return":2.0,"saturated":[0.0,0.0,0.5]}
{"kind":"validation","updates":20,"actor":{"completion_rate":0.4},"actor_average":{"completion_rate":0.5}}
{"kind":"training","updates":30,"ret"""


def test_a_log_cut_short_is_read_as_far_as_it_goes(tmp_path):
    path = tmp_path / "log.jsonl"
    path.write_text(LOG)
    log = read_log(path)
    assert len(log) == 3
    curve = training_curve(log, "return")
    assert (curve.updates.tolist(), curve.value.tolist()) == ([20.0], [2.0])
    assert validation_curve(log).value.tolist() == [0.5]
    assert saturation_curves(log)[2].value.tolist() == [0.3, 0.5]


def test_a_band_spans_what_all_seeds_have():
    short = Curve(np.array([0.0, 10.0]), np.array([0.0, 1.0]))
    long = Curve(np.array([5.0, 20.0]), np.array([1.0, 1.0]))
    span = band([short, long])
    assert (span.updates[0], span.updates[-1], span.seeds) == (5.0, 10.0, 2)
    assert np.allclose(span.low, np.linspace(0.5, 1.0, len(span.updates)))
    assert np.allclose(span.high, 1.0)
    with pytest.raises(ValueError, match="none of them empty"):
        band([])


def test_smoothing_keeps_a_constant_and_the_ends():
    curve = Curve(np.arange(9.0), np.full(9, 3.0))
    assert np.allclose(smoothed(curve, 4).value, 3.0)
    assert smoothed(curve, 1) is curve


def picture(path):
    assert path.read_bytes().startswith(b"\x89PNG")
    return path.stat().st_size


def test_every_figure_is_drawn_and_small(tmp_path):
    ways = np.linspace([10.0, 50.0, 60.0], [90.0, 55.0, 30.0], 6)
    target = np.tile([90.0, 55.0, 30.0], (6, 1))
    shown = FlightRecord.of(Flight(ways, target, "reached"))
    scene = Scene(title="round", map="env1", choice="the first", flight=shown)
    empty = Scene(title="none", map="env2", choice="the first", flight=None)
    curve = Curve(np.arange(30.0), np.arange(30.0) / 30.0)
    level = [Level(0.8, "the paper's")]
    sizes = [
        picture(draw_paths([scene, empty], tmp_path / "paths.png", "Paths")),
        picture(draw_chase(empty, tmp_path / "chase.png", "Chase")),
        picture(
            draw_rewards({"a": {"seed 1": curve}}, {"a": level}, tmp_path / "rewards.png", "R")
        ),
        picture(draw_completion({"a": [curve, curve]}, level, tmp_path / "transfer.png", "T")),
        picture(
            draw_ablations(
                [Bar("a", (0.5, 0.6), (0.5, 0.6)), Bar("b", (0.4,), (0.3, 0.5))],
                level,
                tmp_path / "ablations.png",
                "A",
            )
        ),
    ]
    assert all(10_000 < size < 300_000 for size in sizes)
    again = draw_completion({"a": [curve, curve]}, level, tmp_path / "again.png", "T")
    assert again.read_bytes() == (tmp_path / "transfer.png").read_bytes()
    assert load_map("env1").obstacle_names  # the figures read the map by its name


def test_where_one_more_seed_is_expected():
    # mean 0.97, s = 0.01, t = 4.30, sqrt(4 / 3): 5.0 points to either side.
    assert another_seed([0.96, 0.97, 0.98]) == "92.0 - 100.0"
    assert another_seed([0.5, 0.5]) == "50.0 - 50.0"
    assert another_seed([0.97]) == "-"


def test_unfinished_runs_are_listed_by_seed():
    names = ["env1-seed2", "env1-short-rays-seed1", "env1-seed3"]
    assert listed_by_seed(names) == "env1 (seed 2, 3), env1-short-rays (seed 1)"
