"""The ``companion`` command: options in, one line of error out, exit codes as in ``errors``."""

import logging
import os
import signal
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType
from typing import Annotated, Literal, NoReturn

import msgspec
import tyro

from companion.config import PreflightConfig, RunConfig, load_run_config
from companion.errors import CompanionError, UsageError
from companion.guidance.reasons import Reason
from companion.guidance.situation import EXIT_CODES, Outcome
from companion.options import parse
from companion.session.summary import Summary
from companion.terminal import TerminalHandler

_USAGE = """\
usage: companion COMMAND [OPTIONS]      (companion COMMAND --help says more)

  run       fly a policy on a vehicle
  preflight look at a vehicle before a flight: GO or NO-GO
  service   print a systemd unit that runs it unattended
  mock      start the built-in mock vehicle
  review    say what happened in a flight: a run of ours, or any .tlog
  replay    make the decisions of a run again and compare
  maps      check or show a map file, or import one from building footprints
  actors    show an actor file and its contract
"""


@dataclass(frozen=True)
class ReviewArgs:
    """Say what happened in a flight, and open it in the viewer.

    Reads a session folder of `companion run`, a recording (.rrd), or a telemetry log (.tlog) of
    any PX4 or ArduPilot vehicle, whoever recorded it.
    """

    flights: tyro.conf.Positional[tuple[Path, ...]]
    """Session folder, recording or telemetry log; two of them with --compare."""
    text: bool = False
    """Only print the report."""
    png: Path | None = None
    """Render the recording into this picture, without a display."""
    at: float | None = None
    """Time of the picture (s since the start); by default the end."""
    html: Path | None = None
    """Write a page with summary, events and plots into this folder; it needs no network."""
    compare: bool = False
    """Lay two flights over each other, and their figures side by side."""
    map: str | None = None
    """Lay a telemetry log over this map (file or bundled name)."""


@dataclass(frozen=True)
class ReplayArgs:
    """Make every decision of a recorded run again and compare what it sent, bit for bit.

    The program runs again with the bytes, times and signals of the recording, and every frame it
    sends must be that of flight.tlog. Exit code 0: all the same; 8: something differs; 5: it
    cannot be told, because the recording has gaps, map or actor have changed, or this version
    asks clock and link in another order than the one that flew.
    """

    session: tyro.conf.Positional[Path]
    """Session folder, as named by ``companion run``."""
    actor: str | None = None
    """Also ask this actor (file or bundled name) what it would have decided in every situation
    of the flight, and write a session folder that ``companion review`` opens."""
    record: Path = Path("sessions")
    """Folder in which that session folder is made."""
    json: Annotated[bool, tyro.conf.arg(help="One object on stdout instead of words.")] = False


@dataclass(frozen=True)
class MapsArgs:
    """Check a map file, or draw it. `companion maps import --help`: make one of footprints."""

    action: tyro.conf.Positional[Literal["check", "show"]]
    map: tyro.conf.Positional[str]
    """Map file, or the name of a bundled map."""
    png: Path | None = None
    """show: write the picture here (default NAME.png)."""
    rerun: bool = False
    """show: open the map in the Rerun viewer as well."""


@dataclass(frozen=True)
class ActorsArgs:
    """Show what an actor was made for."""

    action: tyro.conf.Positional[Literal["show"]]
    actor: tyro.conf.Positional[str]
    """Actor file (.onnx), or the name of a bundled actor."""
    json: Annotated[bool, tyro.conf.arg(help="Print the contract as JSON.")] = False


_BY_EXIT_CODE = {
    2: (Outcome.FAILED, Reason.USAGE),
    3: (Outcome.FAILED, Reason.LINK_FAILED),
    4: (Outcome.LINK_LOST, Reason.LINK_SILENT),
    5: (Outcome.REFUSED, Reason.REFUSED),
    6: (Outcome.COMMAND_FAILED, Reason.REJECTED),
}
"""How a run ended that was over before the loop began."""


def main(argv: Sequence[str] | None = None) -> None:
    """Run the command line and exit with the code of ``companion.errors``."""
    try:
        code = _main(list(sys.argv[1:] if argv is None else argv))
        sys.stdout.flush()
    except BrokenPipeError:  # the reader, head or less, has seen enough
        _close_stdout()
        code = 0
    except OSError as error:
        _close_stdout()
        _complain(f"cannot write: {error.strerror or error}")
        code = CompanionError.exit_code
    sys.exit(code)


def _main(argv: list[str]) -> int:
    commands: dict[str, Callable[[list[str]], int]] = {
        "run": _run,
        "preflight": _preflight,
        "service": _service,
        "mock": _mock,
        "review": _review,
        "replay": _replay,
        "maps": _maps,
        "actors": _actors,
    }
    if not argv or argv[0] in ("-h", "--help", "help"):
        print(_USAGE, end="")
        return 0 if argv else UsageError.exit_code
    if argv[0] == "--version":
        from importlib.metadata import version

        print(f"mavlink-companion {version('mavlink-companion')}")
        return 0
    command = commands.get(argv[0])
    if command is None:
        _complain(f"no such command {argv[0]!r}; one of {', '.join(commands)}")
        return UsageError.exit_code
    try:
        return command(argv[1:])
    except CompanionError as error:
        _complain(str(error))
        return error.exit_code
    except KeyboardInterrupt:
        _complain("interrupted")
        return EXIT_CODES[Outcome.STOPPED]


def _run(argv: list[str]) -> int:
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, _interrupt)
    as_json = "--json" in argv
    log = TerminalHandler()
    logging.basicConfig(level=logging.INFO, handlers=[log])
    try:
        config = _parse_run(argv)
        as_json |= config.json
        from companion.run import run

        summary = run(config)
    except (CompanionError, KeyboardInterrupt) as error:
        if as_json:
            _print_json(_failed(error))
        raise
    finally:
        log.flush()
    if as_json:
        _print_json(summary)
    else:
        from companion.review.words import brief

        print(brief(Path(summary.session_dir or ".")))
    if summary.exit_code:
        _complain(f"{summary.outcome}: {summary.reason}")
    return summary.exit_code


def _parse_run(argv: list[str], prog: str = "companion run") -> RunConfig:
    """Return the options: the command line over the file of ``--config`` over the defaults."""
    config = parse(RunConfig, argv, prog)
    if config.config is None:
        return config
    from_file = replace(load_run_config(config.config), config=config.config)
    return parse(RunConfig, argv, prog, default=from_file)


def _service(argv: list[str]) -> int:
    config = _parse_run(argv, "companion service")
    from companion.service import unit

    print(unit(config, argv), end="")
    return 0


def _preflight(argv: list[str]) -> int:
    args = parse(PreflightConfig, argv, "companion preflight")
    from companion.inspection import Inspection, inspect
    from companion.inspection_table import table

    try:
        seen = inspect(args)
    except CompanionError as error:
        if args.json:
            _print_json(Inspection(go=False, reasons=[str(error)], exit_code=error.exit_code))
        raise
    if args.json:
        _print_json(seen)
    else:
        print(table(seen))
    return seen.exit_code


def _mock(argv: list[str]) -> NoReturn:
    """Become the mock, a program of its own: whoever ends us ends it, and no child is left."""
    sys.stdout.flush()
    os.execv(sys.executable, [sys.executable, "-m", "sim.mock", *argv])


def _review(argv: list[str]) -> int:
    args = parse(ReviewArgs, argv, "companion review")
    if len(args.flights) != 1 + args.compare:
        raise UsageError(f"{len(args.flights)} flights were given: name one, or two with --compare")
    from companion.review.command import review_command

    return review_command(
        args.flights, text=args.text, png=args.png, at_s=args.at, html=args.html, map_name=args.map
    )


def _replay(argv: list[str]) -> int:
    args = parse(ReplayArgs, argv, "companion replay")
    logging.getLogger("companion").setLevel(logging.CRITICAL)  # what it says was said in flight
    from companion import replay, second_opinion
    from companion.policy.actor import Actor

    session = replay.RecordedSession(args.session)
    replayed = session.replay(lambda record: None)
    opinion = None
    if args.actor is not None:
        opinion = second_opinion.second_opinion(session, Actor.load(args.actor), args.record)
    if args.json:
        found = msgspec.to_builtins(replayed) | {"other": msgspec.to_builtins(opinion)}
        print(msgspec.json.encode(found).decode())
    else:
        print(replay.words(replayed))
        if opinion is not None:
            print(second_opinion.words(opinion))
    return replayed.exit_code


def _maps(argv: list[str]) -> int:
    if argv[:1] == ["import"]:
        from companion.maps_import import import_command

        return import_command(argv[1:])
    args = parse(MapsArgs, argv, "companion maps")
    from companion.world.maps import describe_map, load_map

    city = load_map(args.map)
    print(describe_map(city))
    if args.action == "show":
        from companion.world.draw import draw_map

        png = args.png or Path(f"{city.name}.png")
        draw_map(city, png)
        print(f"wrote {png}")
        if args.rerun:
            from companion.review.show import show_map

            print(show_map(city))
    return 0


def _actors(argv: list[str]) -> int:
    args = parse(ActorsArgs, argv, "companion actors")
    from companion.policy.actor import Actor, describe_actor

    actor = Actor.load(args.actor)
    if args.json:
        print(msgspec.json.format(msgspec.json.encode(actor.contract), indent=2).decode())
    else:
        print(describe_actor(actor))
    return 0


def _failed(error: BaseException) -> Summary:
    """Return the summary of a run that ended before the loop began."""
    outcome, reason_code, code = Outcome.STOPPED, Reason.SIGNAL, EXIT_CODES[Outcome.STOPPED]
    if isinstance(error, CompanionError):
        code = error.exit_code
        outcome, reason_code = _BY_EXIT_CODE.get(code, (Outcome.FAILED, Reason.INTERNAL))
    return Summary(
        outcome=outcome,
        reason=str(error) or "interrupted",
        reason_code=reason_code,
        exit_code=code,
    )


def _print_json(result: msgspec.Struct) -> None:
    print(msgspec.json.encode(result).decode(), flush=True)


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _close_stdout() -> None:
    """Leave nothing for the interpreter to flush at its end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _complain(text: str) -> None:
    """Say what is wrong, but do not wait for a terminal that takes nothing."""
    last_words = TerminalHandler()
    last_words.write(f"companion: {text}")
    last_words.flush()


if __name__ == "__main__":
    main()
