"""Runs: resumed to the same bits, transferred, cut short, exported; all on tiny presets."""

import dataclasses
import json

import msgspec
import numpy as np
import pytest
import torch

from companion.errors import ActorError, UsageError
from companion.policy.actor import Actor
from companion.policy.contract import SeenContract
from companion.world.maps import load_map
from training import train
from training.export import export_actor, largest_difference
from training.networks import ActorNetwork
from training.places import Place
from training.presets import PRESETS, load_preset
from training.run_folder import RunFolder, RunRecord
from training.train import contract_of, export_run, resume_run, start_run
from training.trainer import Trainer, act


def tiny(name, stage, updates=24):
    """A preset of the real kind that runs in a fraction of a second."""
    preset = PRESETS[name, stage]
    return dataclasses.replace(
        preset,
        ddpg=dataclasses.replace(preset.ddpg, hidden=(16, 16)),
        batch_size=32,
        replay_capacity=300,
        num_steps=min(preset.num_steps, 3),
        num_worlds=16,
        warmup_steps=3,
        validate_every=8,
        validation_episodes=16,
        updates=updates,
    )


@pytest.fixture(autouse=True)
def tiny_presets(monkeypatch):
    torch.set_num_threads(1)
    for key in PRESETS:
        monkeypatch.setitem(PRESETS, key, tiny(*key))
    monkeypatch.setattr(train, "LOG_EVERY", 4)
    monkeypatch.setattr(train, "TEST_EPISODES", 20)


def make_record(**changes):
    record = RunRecord(
        preset="flight",
        stage="free",
        layout="relative",
        map="free",
        cities=None,
        map_hash=load_map("free").content_hash,
        seed=3,
        updates=24,
        beta=0.8,
        init=None,
        git_revision="unknown",
        command="training train",
    )
    record = msgspec.structs.replace(record, **changes)
    if "preset_digest" in changes:
        return record
    preset = load_preset(
        record.preset,
        record.stage,
        layout=record.layout,
        updates=record.updates,
        beta=record.beta,
    )
    return msgspec.structs.replace(record, preset_digest=preset.digest)


def run_to_the_end(trainer, folder, stop_after=None):
    """Run with a clock that stands still; stop after so many questions."""
    asked = 0

    def stop():
        nonlocal asked
        asked += 1
        return stop_after is not None and asked > stop_after

    return train.run(trainer, folder, lambda *_: None, now_s=lambda: 0.0, stop=stop)


def networks_of(trainer):
    state = trainer.learner.state_dict()
    return {
        f"{network}.{name}": value
        for network in ("actor", "critic", "actor_target", "critic_target", "actor_average")
        for name, value in state[network].items()
    }


def assert_same(first, second):
    ours, theirs = networks_of(first), networks_of(second)
    assert ours.keys() == theirs.keys()
    assert all(torch.equal(ours[name], theirs[name]) for name in ours)
    assert first.updates == second.updates
    assert first.best.score == second.best.score
    assert first.best.source == second.best.source


def logged(folder):
    """The log without the rates, which count from the start of each process."""
    entries = [json.loads(line) for line in folder.log_path.read_text().splitlines()]
    return [{k: v for k, v in entry.items() if not k.endswith("_per_s")} for entry in entries]


@pytest.mark.parametrize(
    ("preset", "stage", "map_name", "layout"),
    [
        ("paper", "free", "free", "paper"),
        ("paper", "obstacles", "env1", "rays"),
        ("flight", "free", "free", "relative"),
        ("flight", "obstacles", "env1", "rays"),
    ],
)
def test_a_resumed_run_ends_bit_for_bit_where_an_unbroken_one_does(
    tmp_path, preset, stage, map_name, layout
):
    record = make_record(
        preset=preset,
        stage=stage,
        map=map_name,
        map_hash=load_map(map_name).content_hash,
        layout=layout,
    )
    whole_folder, cut_folder = RunFolder(tmp_path / "whole"), RunFolder(tmp_path / "cut")
    whole = start_run(record, whole_folder)
    assert run_to_the_end(whole, whole_folder)

    assert not run_to_the_end(start_run(record, cut_folder), cut_folder, stop_after=6)
    resumed = resume_run(cut_folder)
    assert 0 < resumed.updates < 24
    assert run_to_the_end(resumed, cut_folder)
    assert_same(whole, resumed)
    assert logged(whole_folder) == logged(cut_folder)


def test_a_run_that_died_between_checkpoints_repeats_what_was_lost(tmp_path):
    folder = RunFolder(tmp_path / "run")
    trainer = start_run(make_record(), folder)
    run_to_the_end(trainer, folder, stop_after=6)
    logged = folder.log_path.read_bytes()
    folder.append_log({"kind": "training", "updates": 999})
    resume_run(folder)
    assert folder.log_path.read_bytes() == logged


def test_the_log_has_what_it_promises(tmp_path):
    folder = RunFolder(tmp_path / "run")
    run_to_the_end(start_run(make_record(), folder), folder)
    entries = [json.loads(line) for line in folder.log_path.read_text().splitlines()]
    kinds = {entry["kind"] for entry in entries}
    assert kinds == {"training", "validation"}
    training = [entry for entry in entries if entry["kind"] == "training"][-1]
    assert training["updates"] == 24
    assert len(training["saturated"]) == 3
    assert all(0.0 <= share <= 1.0 for share in training["saturated"])
    measured = ("return", "reached", "critic_loss", "actor_loss", "q", "epsilon")
    rates = ("updates_per_s", "steps_per_s")
    for key in (*measured, *rates):
        assert key in training
    assert training["critic_gradient"] > 0.0
    assert training["actor_gradient"] > 0.0
    validation = [entry for entry in entries if entry["kind"] == "validation"]
    assert [entry["updates"] for entry in validation] == [8, 16, 24]
    assert {"actor", "actor_average"} <= validation[0].keys()


def test_the_same_seed_is_the_same_run(tmp_path):
    record = make_record(
        preset="paper",
        stage="obstacles",
        layout="rays",
        map="env1",
        map_hash=load_map("env1").content_hash,
    )
    runs = [start_run(record, RunFolder(tmp_path / name)) for name in ("first", "second")]
    for name, trainer in zip(("first", "second"), runs, strict=True):
        run_to_the_end(trainer, RunFolder(tmp_path / name))
    assert_same(*runs)


def test_another_seed_is_another_run(tmp_path):
    trainers = [Trainer(tiny("flight", "free"), Place(map="free"), seed) for seed in (1, 2)]
    for trainer in trainers:
        for _ in range(5):
            trainer.advance()
    first, second = (networks_of(trainer) for trainer in trainers)
    assert not all(torch.equal(first[name], second[name]) for name in first)


def test_transfer_starts_from_the_critics_and_the_best_actor_of_the_free_run(tmp_path):
    source = RunFolder(tmp_path / "free")
    free = start_run(make_record(), source)
    run_to_the_end(free, source)
    env1 = make_record(
        stage="obstacles",
        map="env1",
        map_hash=load_map("env1").content_hash,
        init=str(source.folder),
    )
    carried = start_run(env1, RunFolder(tmp_path / "env1"))
    ours, theirs = networks_of(carried), networks_of(free)
    critics = [name for name in ours if name.startswith("critic")]
    assert all(torch.equal(ours[name], theirs[name]) for name in critics)
    for network in ("actor", "actor_target", "actor_average"):
        for name, value in free.best.network.items():
            assert torch.equal(ours[f"{network}.{name}"], value)
    assert (carried.updates, carried.buffer.size) == (0, 0)
    assert carried.epsilon == carried.preset.epsilon_start
    assert not carried.learner.actor_optimizer.state_dict()["state"]


def test_transfer_between_layouts_is_refused(tmp_path):
    source = RunFolder(tmp_path / "free")
    run_to_the_end(start_run(make_record(), source), source)
    other = make_record(layout="paper", init=str(source.folder))
    with pytest.raises(UsageError, match="was trained on layout relative, this run uses paper"):
        start_run(other, RunFolder(tmp_path / "other"))


def test_a_folder_in_use_is_refused(tmp_path):
    folder = RunFolder(tmp_path / "run")
    run_to_the_end(start_run(make_record(), folder), folder, stop_after=1)
    with pytest.raises(UsageError, match="holds a run already"):
        start_run(make_record(), folder)


def test_resuming_nothing_is_refused(tmp_path):
    with pytest.raises(UsageError, match="no training run"):
        resume_run(RunFolder(tmp_path / "nothing"))


def test_resuming_on_a_map_that_changed_is_refused(tmp_path):
    folder = RunFolder(tmp_path / "run")
    run_to_the_end(start_run(make_record(), folder), folder, stop_after=1)
    folder.write_record(make_record(map_hash="0" * 64))
    with pytest.raises(UsageError, match="has changed"):
        resume_run(folder)


@pytest.mark.parametrize("digest", ["", "0" * 12])
def test_a_run_of_another_preset_is_neither_resumed_nor_exported(tmp_path, digest):
    """Its contract would tell of a step and of a vehicle that its training never knew."""
    folder = RunFolder(tmp_path / "run")
    run_to_the_end(start_run(make_record(), folder), folder, stop_after=6)
    folder.write_record(make_record(preset_digest=digest))
    with pytest.raises(UsageError, match="preset flight has changed"):
        resume_run(folder)
    with pytest.raises(UsageError, match="preset flight has changed"):
        export_run(folder, tmp_path / "a.onnx", now_s=lambda: 0.0)


@pytest.mark.parametrize("content", [b"", b"not a checkpoint", b"\x80\x02}q\x00."])
def test_a_broken_checkpoint_is_refused(tmp_path, content):
    folder = RunFolder(tmp_path / "run")
    run_to_the_end(start_run(make_record(), folder), folder, stop_after=1)
    folder.checkpoint_path.write_bytes(content)
    with pytest.raises(UsageError, match="cannot read"):
        resume_run(folder)


def test_the_export_flies_what_did_best_on_validation(tmp_path):
    folder = RunFolder(tmp_path / "run")
    trainer = start_run(make_record(), folder)
    run_to_the_end(trainer, folder)
    actor = export_run(folder, tmp_path / "out" / "best.onnx", now_s=lambda: 0.0)
    trainer.learner.actor.load_state_dict(trainer.best.network)
    observation = np.zeros((4, 11), dtype=np.float32)
    np.testing.assert_allclose(
        actor.act(observation), act(trainer.learner.actor, observation), atol=1e-6
    )
    record = actor.contract.evaluation[0]
    assert (record.map_name, record.episodes) == ("free", 20)
    observations = trainer.buffer.observations
    assert len(observations) == trainer.buffer.size > 0
    assert actor.contract.seen == SeenContract.of(trainer.preset.layout, observations)
    assert list((tmp_path / "out").iterdir()) == [tmp_path / "out" / "best.onnx"]


def test_a_run_without_validation_has_nothing_to_export(tmp_path):
    folder = RunFolder(tmp_path / "run")
    run_to_the_end(start_run(make_record(), folder), folder, stop_after=1)
    with pytest.raises(UsageError, match="no actor was validated yet"):
        export_run(folder, tmp_path / "best.onnx", now_s=lambda: 0.0)


@pytest.mark.parametrize("seed", range(3))
def test_torch_and_onnx_agree(tmp_path, seed):
    trainer = Trainer(tiny("flight", "free"), Place(map="free"), seed)
    network = ActorNetwork(
        len(trainer.preset.layout.fields), (64, 32), torch.Generator().manual_seed(seed)
    )
    with torch.no_grad():
        network.head.weight.mul_(300.0)  # far into tanh, where differences would show
    contract = contract_of(make_record(), trainer, ())
    actor = export_actor(network, contract, tmp_path / "a.onnx")
    assert largest_difference(network, actor) <= 1e-5
    assert Actor.load(tmp_path / "a.onnx").contract == contract


@pytest.mark.parametrize(("home", "elsewhere"), [("env1", "env2"), ("env2", "env1")])
def test_the_shipped_actors_of_the_papers_maps_fly_there_only(home, elsewhere):
    actor = Actor.load(f"paper-{home}")
    evaluation = actor.contract.evaluation[0]
    assert (evaluation.map_name, evaluation.episodes) == (home, 1_000)
    actor.check_fits(load_map(home), 5.0)
    with pytest.raises(ActorError, match=home):
        actor.check_fits(load_map(elsewhere), 5.0)


BLOCK = """
name: block
description: One triangular block.
size_m: [80, 80, 50]
launch_m: [5, 5, 0]
obstacles: [{name: obs1, footprint_m: [[10, 10], [20, 10], [20, 20]], height_m: 30}]
"""


def test_an_actor_is_bound_to_the_one_map_it_knows_and_else_free(tmp_path):
    file = tmp_path / "block.yaml"
    file.write_text(BLOCK)
    places = {"obstacles": Place(map=str(file)), "free": Place(map="free")}
    contracts = {
        stage: contract_of(make_record(stage=stage), Trainer(tiny("flight", stage), place, 0), ())
        for stage, place in places.items()
    }
    bound, free = contracts["obstacles"], contracts["free"]
    assert bound.map.content_hash == load_map(file).content_hash
    assert bound.avoids_obstacles
    assert (bound.dynamics.edge_low_m, bound.dynamics.edge_high_m) == (80.0, 80.0)
    assert free.map is None
    assert not free.avoids_obstacles

    record = make_record(stage="obstacles", map=None, cities=2)
    trainer = Trainer(tiny("flight", "obstacles"), Place(cities=2), 0)
    cities = contract_of(record, trainer, ())
    assert cities.map is None
    assert cities.avoids_obstacles


def test_the_contract_tells_what_the_vehicle_was_like_in_training():
    record = make_record(stage="obstacles", layout="rays", map=None, cities=2)
    trainer = Trainer(tiny("flight", "obstacles"), Place(cities=2), 0)
    flight, world = contract_of(record, trainer, ()), trainer.preset.world
    dynamics = flight.dynamics
    assert dynamics.velocity_lag_s == world.dynamics.time_constant_s
    assert dynamics.v_max_mps == 5.0
    assert dynamics.step_s == pytest.approx(flight.action.rho_max * 100.0 / 5.0)

    for layout, clock in (("paper", (None, None)), ("rays", (4.0, 5.0))):
        preset = dataclasses.replace(tiny("paper", "free"), layout_name=layout)
        kinematic = Trainer(preset, Place(map="free"), 0)
        paper = contract_of(make_record(preset="paper", layout=layout), kinematic, ()).dynamics
        assert (paper.step_s, paper.v_max_mps) == clock
        assert paper.velocity_lag_s is None


def test_cities_need_a_layout_that_shows_obstacles(tmp_path):
    with pytest.raises(UsageError, match="layout relative shows no obstacles"):
        start_run(make_record(stage="obstacles", map=None, cities=2), RunFolder(tmp_path / "run"))


def test_cities_to_train_validate_and_test_on_are_different():
    place = Place(cities=3)
    maps = (*place.training_maps(), *place.validation_maps(), *place.test_maps())
    assert len({city.content_hash for city in maps}) == len(maps)


def test_open_ground_is_among_the_cities_to_train_on():
    built_up = [len(city.heights_m) for city in Place(cities=8).training_maps()]
    assert built_up[-1] == 0
    assert min(built_up[:-1]) > 0


@pytest.mark.parametrize("wrong", [{}, {"map": "free", "cities": 3}, {"cities": 0}])
def test_places_that_make_no_sense_are_refused(wrong):
    with pytest.raises(UsageError, match=r"--cities"):
        Place(**wrong)
