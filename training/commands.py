"""What the commands do once their options are known; needs torch."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from companion.errors import UsageError
from companion.policy.actor import Actor
from training import cli
from training.curves import read_log
from training.export import command_line, git_revision
from training.places import Place, content_hash
from training.presets import load_preset
from training.run_folder import RunFolder, RunRecord
from training.train import export_run, resume_run, run, start_run, stop_on_signal
from training.trainer import Trainer

__all__ = ["command_line", "export", "train"]

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
