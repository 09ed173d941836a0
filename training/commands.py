"""What the commands do once their options are known; needs torch."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from companion.arrays import Float32Array
from companion.errors import UsageError
from companion.policy.actor import Actor
from sim.guides import Surveyor
from sim.world import CityWorld
from training import cli
from training.curves import read_log
from training.evaluate import Evaluation, Policy, as_json, evaluate_policy, fly_straight
from training.export import command_line, git_revision
from training.loop import evaluate_loop
from training.places import Place, content_hash
from training.presets import load_preset
from training.run_folder import RunFolder, RunRecord
from training.train import export_run, resume_run, run, start_run, stop_on_signal
from training.trainer import Trainer

__all__ = ["command_line", "evaluate", "export", "train"]

_INTERRUPTED = 130


def train(options: "cli.Train", typed: str, *, now_s: Callable[[], float]) -> int:
    """Run ``training train``.

    Raises:
        UsageError: If the options contradict each other or the run folder.
    """
    torch.set_num_threads(1)  # layers this small lose more to a second thread than they gain
    place = _place(options)
    folder = RunFolder(options.out or _default_folder(options, place))
    if options.resume:
        trainer = resume_run(folder)
    else:
        trainer = start_run(_record(options, place, typed), folder)
    console = Console()
    if options.stage == "obstacles" and options.init is None and not options.resume:
        console.print("no --init: from random networks, not from those of a free run")
    console.print(f"run {folder.folder}: {trainer.updates} of {trainer.preset.updates} updates")
    with (
        stop_on_signal() as stop,
        _reporter(console) as reporter,
        _recording(options.rerun, folder, trainer) as record,
    ):

        def report(trainer: Trainer, entry: dict[str, Any]) -> None:
            reporter.report(trainer, entry)
            record(entry)

        over = run(trainer, folder, report, now_s=now_s, stop=stop)
    if not over:
        console.print(f"stopped after {trainer.updates} updates: go on with --resume")
        return _INTERRUPTED
    console.print(f"best on validation: {trainer.best.source}, {_percent(trainer.best.score[0])}")
    actor = export_run(folder, folder.actor_path, now_s=now_s)
    _print_record(console, actor)
    return 0


def evaluate(options: "cli.Evaluate", typed: str, *, now_s: Callable[[], float]) -> int:
    """Run ``training evaluate``.

    Raises:
        UsageError: If the options contradict each other or ask for what is not there.
    """
    place = Place(options.map, options.cities)
    if options.episodes < 1:
        raise UsageError(f"--episodes must be at least 1, got {options.episodes}")
    actor = Actor.load(options.actor)
    contract, maps = actor.contract, place.test_maps()
    v_max_mps = contract.dynamics.v_max_mps
    # What was trained on a vehicle with a lag is flown on one; the paper's point has none.
    in_the_loop = contract.dynamics.velocity_lag_s is not None
    if options.shield and not in_the_loop:
        raise UsageError(
            f"--shield needs a vehicle with a speed: {actor.name} is evaluated as the paper's "
            f"kinematic point"
        )
    if len(maps) > options.episodes:
        raise UsageError(f"--cities {len(maps)} needs at least as many --episodes")
    for city in maps:
        actor.check_fits(city, v_max_mps or 0.0)

    surveyor = Surveyor()

    def count(policy: Policy, *, shield: bool = False) -> Evaluation:
        flown = (policy, maps, contract.layout, contract.action)
        cases: dict[str, Any] = {
            "episodes": options.episodes,
            "seed": options.seed,
            "moving": options.moving,
            "measure_clearance": True,
            "now_s": now_s,
        }
        if v_max_mps is None or not in_the_loop:
            return evaluate_policy(*flown, **cases)
        return evaluate_loop(*flown, v_max_mps=v_max_mps, shield=shield, surveyor=surveyor, **cases)

    def ask(_: CityWorld, observation: Float32Array) -> Float32Array:
        return actor.act(observation)

    result, straight = count(ask), count(fly_straight)
    shielded = count(ask, shield=True) if options.shield else None
    if options.json:
        print(
            as_json(
                result,
                actor=actor.name,
                map=place.map,
                cities=place.cities,
                seed=options.seed,
                moving=options.moving,
                in_the_loop=in_the_loop,
                straight_completion_rate=straight.completion_rate,
                with_shield=shielded,
                command=typed,
            )
        )
        return 0
    results = {actor.name: result, "flying straight": straight}
    if shielded is not None:
        results = {
            f"{actor.name}, policy alone": result,
            f"{actor.name}, with shield": shielded,
            "flying straight": straight,
        }
    _print_evaluations(Console(), results, typed)
    return 0


def export(options: "cli.Export", *, now_s: Callable[[], float]) -> int:
    """Run ``training export``."""
    torch.set_num_threads(1)
    actor = export_run(RunFolder(options.run), options.out, now_s=now_s)
    console = Console()
    console.print(f"wrote {options.out}")
    _print_record(console, actor)
    return 0


@contextmanager
def _recording(
    path: Path | None, folder: RunFolder, trainer: Trainer
) -> Iterator[Callable[[dict[str, Any]], None]]:
    """Record the run for Rerun where asked to, what was logged before included."""
    if path is None:
        yield lambda _: None
        return
    try:
        # Only now: it takes a second to import, and may be missing.
        from training.rerun_curves import TrainingRecording
    except ImportError as error:
        raise UsageError('--rerun needs Rerun: pip install "rerun-sdk==0.41.*"') from error
    recording = TrainingRecording(path, folder.read_record(), trainer)
    try:
        if folder.log_path.exists():
            for entry in read_log(folder.log_path):
                recording.write(entry)
        yield lambda entry: recording.write(entry, trainer)
    finally:
        recording.close()


def _place(options: "cli.Train") -> Place:
    if options.cities is None and options.map is None:
        return Place(map="free" if options.stage == "free" else "env1")
    return Place(options.map, options.cities)


def _default_folder(options: "cli.Train", place: Place) -> Path:
    where = f"cities{place.cities}" if place.map is None else Path(place.map).stem
    return Path("runs") / f"{options.preset}-{where}-seed{options.seed}"


def _record(options: "cli.Train", place: Place, typed: str) -> RunRecord:
    preset = load_preset(
        options.preset,
        options.stage,
        layout=options.layout,
        updates=options.updates,
        beta=options.beta,
    )
    return RunRecord(
        preset=preset.name,
        stage=preset.stage,
        layout=preset.layout_name,
        map=place.map,
        cities=place.cities,
        map_hash=content_hash(place.training_maps()),
        seed=options.seed,
        updates=preset.updates,
        beta=preset.world.reward.beta,
        init=None if options.init is None else str(options.init),
        git_revision=git_revision(),
        command=typed,
        preset_digest=preset.digest,
        device=options.device,
    )


class _Reporter:
    """Shows a run: a bar on a terminal, plain lines otherwise; validations as lines in both."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._bar = Progress(
            TextColumn("{task.completed}/{task.total} updates"),
            BarColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[text]}"),
            console=console,
            disable=not console.is_terminal,
        )
        self._task = self._bar.add_task("train", total=None, text="")

    def __enter__(self) -> "_Reporter":
        self._bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._bar.stop()

    def report(self, trainer: Trainer, entry: dict[str, Any]) -> None:
        """Show one line of the log."""
        if entry["kind"] == "validation":
            rates = ", ".join(
                f"{name} {_percent(entry[name]['completion_rate'])}"
                for name in ("actor", "actor_average")
            )
            self._console.print(f"{entry['updates']:7d} updates  validation: {rates}")
            return
        text = (
            f"return {_number(entry['return'])}  reached {_number(entry['reached'])}  "
            f"Q {_number(entry['q'])}  critic loss {entry['critic_loss'] or 0.0:.1e}  "
            f"epsilon {entry['epsilon']:.2f}  "
            f"saturated {'/'.join(f'{100 * share:.0f}' for share in entry['saturated'])} %  "
            f"{entry['updates_per_s']:.0f} updates/s"
        )
        total = trainer.preset.updates
        self._bar.update(self._task, total=total, completed=trainer.updates, text=text)
        if not self._console.is_terminal:
            self._console.print(f"{entry['updates']:7d} updates  {text}", soft_wrap=True)
            sys.stdout.flush()


def _reporter(console: Console) -> _Reporter:
    return _Reporter(console)


def _print_evaluations(console: Console, results: dict[str, Evaluation], typed: str) -> None:
    for name, result in results.items():
        low, high = result.completion_rate_ci95
        stretch = "-" if result.path_stretch is None else f"{result.path_stretch:.3f}"
        console.print(
            f"{name}: {_percent(result.completion_rate)} of {result.episodes} "
            f"(95 %: {_percent(low)} to {_percent(high)})\n"
            f"  within 5 m {_percent(result.completion_5m)}, "
            f"2 m {_percent(result.completion_2m)}, 1 m {_percent(result.completion_1m)}; "
            f"collided {_percent(result.collision_rate)}, "
            f"timed out {_percent(result.timeout_rate)}\n"
            f"  SPL {result.spl:.3f}, path stretch {stretch}, "
            f"{result.shield_interventions} interventions, {result.seconds:.1f} s",
            highlight=False,
        )
        if result.out_of_reach:
            console.print(
                f"  out of reach for whoever keeps the shield's margin: {result.out_of_reach} of "
                f"{result.episodes} targets",
                highlight=False,
            )
        if result.min_clearance_m is not None:
            values = ", ".join(f"{p} {v:.2f} m" for p, v in result.min_clearance_m.items())
            console.print(f"  smallest clearance: {values}", highlight=False)
    console.print(typed, highlight=False, soft_wrap=True)


def _print_record(console: Console, actor: Actor) -> None:
    for record in actor.contract.evaluation:
        console.print(
            f"{actor.name} on {record.map_name}: {_percent(record.completion_rate)} of "
            f"{record.episodes} held-out cases; 2 m {_percent(record.completion_2m)}, "
            f"1 m {_percent(record.completion_1m)}, collided {_percent(record.collision_rate)}, "
            f"flying straight {_percent(record.straight_completion_rate)}",
            highlight=False,
        )


def _percent(rate: float) -> str:
    return f"{100 * rate:.1f} %"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
