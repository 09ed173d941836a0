"""One training run from start, transfer or checkpoint to an exported actor."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import torch

from companion.errors import UsageError
from companion.policy.actor import Actor
from companion.policy.contract import (
    Contract,
    DynamicsContract,
    EvaluationRecord,
    MapContract,
    ObservationContract,
    SeenContract,
)
from sim.guides import Surveyor
from training.ddpg import ACTORS
from training.evaluate import Evaluation, Policy, fly_straight
from training.export import export_actor
from training.machine import describe_machine
from training.networks import ActorNetwork
from training.places import TEST_CITIES, Place, content_hash
from training.presets import DeviceName, Preset, load_preset
from training.run_folder import RunFolder, RunRecord
from training.seeds import Purpose
from training.trainer import Trainer, fly_cases, network_policy

LOG_EVERY = 500
"""Updates between two lines of the log."""
TEST_EPISODES = 1_000
"""As many as the paper's."""
TEST_SEED = 0
UNSEEN_MAPS = ("env1", "env2", "free", "zurich")
"""Where actors trained on cities are proven, beside cities; in half as many cases each."""
_FREE_EDGES = (0.5, 10.0)
"""Edges on which an actor free of maps may fly, as multiples of the edge of its training. The
kinematic world looks the same at every scale, but 1 % of the edge is all the precision it has;
a layout with fixed units sees nothing of the edge, only targets beyond its range as nearer."""

Report = Callable[[Trainer, dict[str, Any]], None]
"""Told of every line of the log as it is written."""


def start_run(record: RunRecord, folder: RunFolder) -> Trainer:
    """Set up a new run, with the networks of another where ``record.init`` names one.

    Raises:
        UsageError: If the folder holds a run already, or the other run does not fit.
    """
    if folder.checkpoint_path.exists():
        raise UsageError(
            f"{folder.folder} holds a run already: --resume it or choose another --out"
        )
    trainer = _build(record, record.device)
    if record.init is not None:
        transfer(trainer, RunFolder(Path(record.init)))
    machine = describe_machine(record.device)
    folder.write_record(msgspec.structs.replace(record, machine=machine))
    folder.log_path.unlink(missing_ok=True)
    return trainer


def resume_run(folder: RunFolder) -> Trainer:
    """Set up a run to go on from its checkpoint to the result it would have had.

    Raises:
        UsageError: If there is no run, no checkpoint, or the map or the preset has changed since.
    """
    record = folder.read_record()
    trainer = _rebuild(record, folder, record.device)
    if content_hash(trainer.maps) != record.map_hash:
        raise UsageError(f"what {trainer.place.label} means has changed since {folder.folder}")
    state = folder.load_checkpoint()
    trainer.load_state_dict(state["trainer"])
    folder.cut_log(state["log_size"])
    return trainer


def run(
    trainer: Trainer,
    folder: RunFolder,
    report: Report,
    *,
    now_s: Callable[[], float],
    stop: Callable[[], bool],
) -> bool:
    """Train until the run is over or ``stop`` says so; always leaves a checkpoint.

    Args:
        trainer: As ``start_run`` or ``resume_run`` returned it.
        folder: Where log and checkpoint go.
        report: Told of every line of the log.
        now_s: Monotonic clock, for rates only: it changes no result.
        stop: Asked between two steps.

    Returns:
        Whether the run is over.
    """
    began_s, began_updates, began_steps = now_s(), trainer.updates, trainer.steps
    while not trainer.finished and not stop():
        before = trainer.updates
        trainer.advance()
        if _crossed(LOG_EVERY, before, trainer.updates):
            seconds = max(now_s() - began_s, 1e-9)
            entry = {
                "kind": "training",
                "updates": trainer.updates,
                "steps": trainer.steps * trainer.preset.num_worlds,
                **trainer.meter.take(),
                "epsilon": trainer.epsilon,
                "saturated": trainer.saturated(),
                "updates_per_s": (trainer.updates - began_updates) / seconds,
                "steps_per_s": (trainer.steps - began_steps) * trainer.preset.num_worlds / seconds,
            }
            folder.append_log(entry)
            report(trainer, entry)
        if _crossed(trainer.preset.validate_every, before, trainer.updates) or trainer.finished:
            results = trainer.validate(now_s)
            entry = {
                "kind": "validation",
                "updates": trainer.updates,
                **{name: msgspec.to_builtins(result) for name, result in results.items()},
            }
            folder.append_log(entry)
            report(trainer, entry)
            _save(trainer, folder)
    _save(trainer, folder)
    return trainer.finished


def export_run(folder: RunFolder, path: Path, *, now_s: Callable[[], float]) -> Actor:
    """Export the best actor of a run, proven on held-out cases, to ``path``.

    Raises:
        UsageError: If the run has no checkpoint, none of its actors was validated yet, or the
            preset has changed since: the contract would tell of another training.
    """
    record = folder.read_record()
    trainer = _rebuild(record, folder)
    trainer.load_state_dict(folder.load_checkpoint()["trainer"])
    if not trainer.best.network:
        raise UsageError(f"{folder.folder}: no actor was validated yet, train on with --resume")
    network: ActorNetwork = trainer.learner.actor
    network.load_state_dict(trainer.best.network)
    evaluation = tuple(
        _test(trainer, place, episodes, network, path.stem, now_s)
        for place, episodes in _test_places(trainer)
    )
    return export_actor(network, contract_of(record, trainer, evaluation), path)


def contract_of(
    record: RunRecord, trainer: Trainer, evaluation: tuple[EvaluationRecord, ...]
) -> Contract:
    """Return what flight must know of the actors of a run.

    An actor trained on one map with obstacles is bound to it: it has learnt them by heart, or
    at least has never been proven elsewhere. One trained without obstacles, or on cities that
    its layout shows, is free of maps.
    """
    edge_m = trainer.world.edge_m
    city = trainer.maps[0]
    among_obstacles = record.stage == "obstacles"
    bound = among_obstacles and record.cities is None
    low, high = (1.0, 1.0) if bound else _FREE_EDGES
    # The kinematic point has no clock; but an actor that sees its velocity has seen only these.
    layout, world = trainer.preset.layout, trainer.world
    sees_velocity = any(column.startswith("velocity") for column in layout.columns)
    has_clock = sees_velocity or trainer.preset.in_the_loop
    return Contract(
        observation=ObservationContract.of(layout),
        action=trainer.preset.scaling,
        dynamics=DynamicsContract(
            edge_m=edge_m,
            edge_low_m=edge_m * low,
            edge_high_m=edge_m * high,
            step_s=world.dt_s if has_clock else None,
            v_max_mps=world.v_max_mps if has_clock else None,
            velocity_lag_s=trainer.preset.world.dynamics.time_constant_s,
        ),
        map=MapContract(city.name, city.content_hash) if bound else None,
        avoids_obstacles=among_obstacles,
        preset=record.preset,
        stage=record.stage,
        seed=record.seed,
        git_revision=record.git_revision,
        command=record.command,
        evaluation=evaluation,
        seen=SeenContract.of(layout, trainer.buffer.observations) if trainer.buffer.size else None,
    )


@contextmanager
def stop_on_signal() -> Iterator[Callable[[], bool]]:
    """Turn the first Ctrl-C or SIGTERM into a question answered with yes; the second kills."""
    asked = False

    def remember(number: int, frame: object) -> None:
        nonlocal asked
        asked = True
        for kind, handler in before.items():
            signal.signal(kind, handler)

    before = {kind: signal.signal(kind, remember) for kind in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: asked
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)


def _build(record: RunRecord, device: DeviceName) -> Trainer:
    if device == "cuda" and not torch.cuda.is_available():
        raise UsageError(
            f"--device cuda: torch {torch.__version__} finds no GPU here: use --device cpu, or "
            "install a torch built for your GPU"
        )
    preset = load_preset(
        record.preset,
        record.stage,
        layout=record.layout,
        updates=record.updates,
        beta=record.beta,
    )
    place = Place(record.map, record.cities)
    if place.cities is not None and not preset.layout.sees_obstacles:
        raise UsageError(
            f"layout {preset.layout_name} shows no obstacles: it learns one --map only"
        )
    return Trainer(preset, place, record.seed, device)


def _rebuild(record: RunRecord, folder: RunFolder, device: DeviceName = "cpu") -> Trainer:
    trainer = _build(record, device)
    if record.preset_digest != trainer.preset.digest:
        raise UsageError(
            f"preset {record.preset} has changed since {folder.folder}: train again, or go back "
            f"to revision {record.git_revision}"
        )
    return trainer


def transfer(trainer: Trainer, source: RunFolder, *, actor_only: bool = False) -> None:
    """Start from the critics of another run and from its best actor, where one was validated.

    Args:
        trainer: Of the new run.
        source: The other run.
        actor_only: Leave the critics as they are, random.

    Raises:
        UsageError: If the networks of the two do not mean or measure the same.
    """
    record = source.read_record()
    if record.layout != trainer.preset.layout_name:
        raise UsageError(
            f"--init {source.folder} was trained on layout {record.layout}, "
            f"this run uses {trainer.preset.layout_name}"
        )
    state = source.load_checkpoint()["trainer"]
    networks = dict(state["learner"])
    if best := state["best"]["network"]:
        networks |= dict.fromkeys(ACTORS, best)
    try:
        trainer.learner.transfer_from(networks, actor_only=actor_only)
    except RuntimeError as error:
        raise UsageError(
            f"--init {source.folder}: its networks differ in shape from those of preset "
            f"{trainer.preset.name}, use a free run of the same preset"
        ) from error


def _test_places(trainer: Trainer) -> list[tuple[Place, int]]:
    """Return where to prove an actor, and in how many cases.

    On its own map, or on cities and maps it has never seen.
    """
    if trainer.place.cities is None:
        return [(trainer.place, TEST_EPISODES)]
    unseen = [(Place(map=name), TEST_EPISODES // 2) for name in UNSEEN_MAPS]
    return [(Place(cities=TEST_CITIES), TEST_EPISODES), *unseen]


def _test(
    trainer: Trainer,
    where: Place,
    episodes: int,
    network: ActorNetwork,
    name: str,
    now_s: Callable[[], float],
) -> EvaluationRecord:
    surveyor = Surveyor()

    def count(policy: Policy, preset: Preset) -> Evaluation:
        return fly_cases(
            preset,
            trainer.world.v_max_mps,
            policy,
            where.test_maps(),
            episodes=episodes,
            seed=TEST_SEED,
            purpose=Purpose.TEST,
            surveyor=surveyor,
            now_s=now_s,
        )

    result = count(network_policy(network), trainer.preset)
    # The same cases, in a world that is not looked at.
    straight = count(fly_straight, replace(trainer.preset, layout_name="relative"))
    low, high = result.completion_rate_ci95
    return EvaluationRecord(
        map_name=where.map or f"{where.cities} cities",
        episodes=episodes,
        seed=TEST_SEED,
        completion_rate=result.completion_rate,
        completion_rate_low=low,
        completion_rate_high=high,
        completion_2m=result.completion_2m,
        completion_1m=result.completion_1m,
        collision_rate=result.collision_rate,
        timeout_rate=result.timeout_rate,
        straight_completion_rate=straight.completion_rate,
        command=f"training evaluate --actor {name} {where.label} "
        f"--episodes {episodes} --seed {TEST_SEED}",
    )


def _save(trainer: Trainer, folder: RunFolder) -> None:
    folder.save_checkpoint({"trainer": trainer.state_dict(), "log_size": folder.log_size()})


def _crossed(every: int, before: int, after: int) -> bool:
    return after // every > before // every
