"""The ``training`` command. Starts without the ``training`` extra and says what to install."""

import importlib.util
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from companion import clock
from companion.errors import CompanionError, UsageError
from training.presets import DeviceName, LayoutName, PresetName, StageName

_NEEDED = ("torch", "onnx", "matplotlib")
INTERRUPTED = 130


@dataclass(frozen=True, slots=True)
class Train:
    """Train an actor, or go on training one."""

    stage: StageName = "free"
    """free: the paper's source task; obstacles: a map, from the networks of a free run."""
    preset: PresetName = "flight"
    """paper: as literal as its errata allow; coordinates: from its six coordinates alone; flight:
    what works."""
    map: str | None = None
    """Map file or name; by default free, or env1 for stage obstacles."""
    cities: int | None = None
    """Number of random cities to train on, instead of a map."""
    init: Path | None = None
    """Run folder whose networks to start from (transfer learning)."""
    seed: int = 0
    out: Path | None = None
    """Run folder; by default runs/PRESET-PLACE-seedN."""
    resume: bool = False
    """Go on from the checkpoint in the run folder, to the same result; all other options are
    those the run was started with."""
    layout: LayoutName | None = None
    """Another observation layout than the preset's."""
    updates: int | None = None
    """Another number of gradient steps than the preset's."""
    beta: float | None = None
    """Another weight of the obstacle penalty than the preset's, in [0, 1)."""
    device: DeviceName = "cpu"
    """cuda: the networks on a GPU, the worlds stay on the CPU. Only cpu repeats bit for bit."""
    rerun: Path | None = None
    """Also record the run as a .rrd file for Rerun: curves, and episodes on the map."""


@dataclass(frozen=True, slots=True)
class Evaluate:
    """Fly held-out cases and count; flying straight at the target is counted beside it.

    An actor of a vehicle that lags is flown as it flies: asked 20 times a second, on vehicles as
    sluggish as recorded ones, in gusts. One of the paper's kinematic point is flown by the paper's
    step.
    """

    actor: str
    """Actor file or name."""
    map: str | None = None
    """Map file or name."""
    cities: int | None = None
    """Number of random cities that no training has seen, instead of a map."""
    edge_cases: bool = False
    """Hand-made places where flights go wrong, each by its name, instead of a map: behind a wall,
    in a dead end, out of a court, on a roof ..."""
    episodes: int = 1000
    """Number of cases, spread evenly over cities or edge cases."""
    seed: int = 0
    shield: bool = False
    """Fly the same cases once more with the shield behind the policy; counted beside it."""
    baselines: bool = False
    """Beside the actor also fly a planner that aims where the actor is shown the way, and an
    artificial potential field; with --shield all of them with it, too."""
    moving: bool = False
    """Let the targets move."""
    imperfect: bool = False
    """Fly on a poor radio: setpoints get lost, targets waver and fall silent."""
    processes: int = 1
    """How many parts of the cases are flown at a time; the result is the same."""
    json: bool = False
    """Print one JSON object."""


@dataclass(frozen=True, slots=True)
class Export:
    """Export the best actor of a run, with its contract."""

    run: Path
    """Run folder."""
    out: Path
    """ONNX file to write."""


@dataclass(frozen=True, slots=True)
class Reproduce:
    """Reproduce the paper: train everything, fly the test cases, write the report.

    Hours. Ctrl-C leaves checkpoints and a report of what is there; the same command goes on. Runs
    that are over are used again as long as their preset is the same, and so is what a report in the
    same folder says of them.
    """

    quick: bool = False
    """About ten minutes on two cores: fewer updates, seeds and cases, and the report says so."""
    out: Path | None = None
    """Folder of the report; by default runs/report or runs/report-quick."""
    runs: Path = Path("runs")
    """Folder of training runs."""
    seeds: tuple[int, ...] = ()
    """Training seeds; by default 1 2 3, with --quick 1."""
    processes: int | None = None
    """How many runs at a time, by default as many as there are cores."""


@dataclass(frozen=True, slots=True)
class Figures:
    """Draw the figures of a report again and write its page, without training or flying."""

    report: Path
    """Folder with numbers.json and curves.json."""


Command = (
    Annotated[Train, tyro.conf.subcommand("train")]
    | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
    | Annotated[Export, tyro.conf.subcommand("export")]
    | Annotated[Reproduce, tyro.conf.subcommand("reproduce")]
    | Annotated[Figures, tyro.conf.subcommand("figures")]
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    command = tyro.cli(Command, prog="training", args=given, config=(tyro.conf.OmitArgPrefixes,))
    try:
        _check_extra()
        # Only now: torch takes a second to import, and may be missing.
        from training import commands, evaluate_command

        typed = commands.command_line("training", given)
        if isinstance(command, Train):
            return commands.train(command, typed, now_s=clock.now_s)
        if isinstance(command, Evaluate):
            return evaluate_command.evaluate(command, typed, now_s=clock.now_s)
        if isinstance(command, Export):
            return commands.export(command, now_s=clock.now_s)
        from training import reproduce

        if isinstance(command, Reproduce):
            return reproduce.reproduce(command, typed, now_s=clock.now_s)
        return reproduce.figures(command)
    except CompanionError as error:
        print(f"training: {error}", file=sys.stderr)
        return error.exit_code


def _check_extra() -> None:
    missing = [name for name in _NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        raise UsageError(
            f'{", ".join(missing)} not installed: pip install "mavlink-companion[training]"'
        )


if __name__ == "__main__":
    raise SystemExit(main())
