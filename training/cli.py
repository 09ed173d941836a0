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
from training.presets import LayoutName, PresetName, StageName

_NEEDED = ("torch", "onnx", "matplotlib")
INTERRUPTED = 130


@dataclass(frozen=True, slots=True)
class Train:
    """Train an actor, or go on training one."""

    stage: StageName = "free"
    """free: the paper's source task; obstacles: a map, from the networks of a free run."""
    preset: PresetName = "flight"
    """paper: as literal as its errata allow; flight: what works."""
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


@dataclass(frozen=True, slots=True)
class Evaluate:
    """Fly held-out cases and count; flying straight at the target is counted beside it.

    An actor whose contract has a speed is flown as it flies: asked 20 times a second, on a vehicle
    that lags, in gusts. One of the paper's kinematic point is flown by the paper's step.
    """

    actor: str
    """Actor file or name."""
    map: str | None = None
    """Map file or name."""
    cities: int | None = None
    """Number of random cities that no training has seen, instead of a map."""
    episodes: int = 1000
    seed: int = 0
    shield: bool = False
    """Fly the same cases once more with the shield behind the policy; counted beside it."""
    moving: bool = False
    """Let the targets move."""
    json: bool = False
    """Print one JSON object."""


@dataclass(frozen=True, slots=True)
class Export:
    """Export the best actor of a run, with its contract."""

    run: Path
    """Run folder."""
    out: Path
    """ONNX file to write."""


Command = (
    Annotated[Train, tyro.conf.subcommand("train")]
    | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
    | Annotated[Export, tyro.conf.subcommand("export")]
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    command = tyro.cli(Command, prog="training", args=given, config=(tyro.conf.OmitArgPrefixes,))
    try:
        _check_extra()
        # Only now: torch takes a second to import, and may be missing.
        from training import commands

        typed = commands.command_line("training", given)
        if isinstance(command, Train):
            return commands.train(command, typed, now_s=clock.now_s)
        if isinstance(command, Evaluate):
            return commands.evaluate(command, typed, now_s=clock.now_s)
        return commands.export(command, now_s=clock.now_s)
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
