"""A training run as a recording: curves on the updates, episodes on the map, the run untouched."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from rerun.chunk import RrdReader

from training import cli, presets, train
from training.places import Place
from training.presets import PRESETS
from training.rerun_curves import fly_now
from training.trainer import Trainer


@pytest.fixture(autouse=True)
def tiny_presets(monkeypatch):
    torch.set_num_threads(1)
    monkeypatch.setattr(train, "LOG_EVERY", 4)
    monkeypatch.setattr(train, "TEST_EPISODES", 8)
    preset = PRESETS["paper", "obstacles"]
    tiny = replace(
        preset,
        ddpg=replace(preset.ddpg, hidden=(8, 8)),
        batch_size=16,
        num_worlds=8,
        replay_capacity=200,
        warmup_steps=2,
        validate_every=8,
        validation_episodes=8,
        updates=16,
    )
    monkeypatch.setitem(presets.PRESETS, ("paper", "obstacles"), tiny)


def columns(path):
    """Rows of every entity that changes, by its path."""
    found = {}
    for chunk in RrdReader(str(path)).stream():
        if not chunk.is_static:
            rows = found.setdefault(str(chunk.entity_path).lstrip("/"), 0)
            found[str(chunk.entity_path).lstrip("/")] = rows + chunk.to_record_batch().num_rows
    return found


def test_a_run_is_recorded_and_is_the_same_run(tmp_path):
    arguments = ["train", "--preset", "paper", "--stage", "obstacles", "--seed", "4"]
    rrd = tmp_path / "run.rrd"
    assert cli.main([*arguments, "--out", str(tmp_path / "plain")]) == 0
    assert cli.main([*arguments, "--out", str(tmp_path / "seen"), "--rerun", str(rrd)]) == 0
    states = [
        train.RunFolder(tmp_path / name).load_checkpoint()["trainer"]["learner"]["actor"]
        for name in ("plain", "seen")
    ]
    assert all(torch.equal(states[0][name], states[1][name]) for name in states[0])

    rows = columns(rrd)
    assert rows["train/saturated"] == rows["train/losses"] == 4
    assert rows["validation/completion"] == rows["validation/ends"] == 2
    assert rows["world/episodes/timed_out/ways"] == 2


def test_where_the_recording_cannot_be_written(tmp_path, capsys):
    arguments = ["train", "--preset", "paper", "--stage", "obstacles", "--out", str(tmp_path / "r")]
    assert cli.main([*arguments, "--rerun", str(tmp_path)]) == 2
    assert "cannot write" in capsys.readouterr().err


def test_drawn_episodes_are_cut_where_they_are_decided():
    preset = PRESETS["paper", "obstacles"]
    preset = replace(preset, world=replace(preset.world, end_on_contact=True))
    trainer = Trainer(preset, Place(map="env1"), 0)
    before = trainer.world.position_enu_m
    flights = fly_now(trainer)
    assert np.array_equal(before, trainer.world.position_enu_m)
    for flight in flights:
        steps_m = np.linalg.norm(np.diff(flight.position_enu_m, axis=0), axis=1)
        assert (steps_m <= 20.0 + 1e-9).all()  # no jump to the next start
