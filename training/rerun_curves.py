"""A training run in Rerun: its curves, and how the actor flies as it learns.

    train/...        what ``log.jsonl`` says of training, a plot each
    validation/...   completion, and how the cases end
    world/map/...    the map, as in a session
    world/episodes/  cases flown after each validation, a colour for each end
    run              what was asked for

The timeline counts updates. Nothing else in ``training`` imports rerun.
"""

import contextlib
import copy
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from companion.errors import UsageError
from companion.session import colors
from companion.session.colors import Color
from companion.session.records import MapRecord, map_record
from companion.session.scene import draw_map
from companion.session.views import ALWAYS, city_view, series
from training.flights import Flights, Outcome, fly
from training.run_folder import RunRecord
from training.trainer import Trainer, network_policy

EPISODES = 30
"""Drawn after each validation."""
_APPLICATION = "companion-training"
_TIMELINE = "updates"
_FLUSH_S = 5.0
_COLORS: dict[Outcome, Color] = {
    "reached": colors.SENT,
    "collided": colors.DANGER,
    "timed out": colors.PROPOSED,
}
_LINES: tuple[Color, ...] = (colors.MEASURED, colors.PROPOSED, colors.SENT)
_CURVES: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "return": ("Reward of an episode", ("return",)),
    "reached": ("Reached in training", ("reached",)),
    "losses": ("Losses", ("critic_loss", "actor_loss")),
    "q": ("Mean Q", ("q",)),
    "epsilon": ("Epsilon", ("epsilon",)),
    "gradients": ("Gradient norms", ("critic_gradient", "actor_gradient")),
    "saturated": ("Saturated actions", ("rho", "phi", "psi")),
    "rates": ("Updates per second", ("updates_per_s",)),
}
"""Plots by entity under ``train``: title and columns of the log."""
_ENDS = {
    "completion_rate": _COLORS["reached"],
    "collision_rate": _COLORS["collided"],
    "timeout_rate": _COLORS["timed out"],
}


class TrainingRecording:
    """Writes one run to one ``.rrd`` file, as it goes."""

    def __init__(self, path: Path, record: RunRecord, trainer: Trainer) -> None:
        """Open the file and log what does not change.

        Raises:
            UsageError: If the file cannot be written.
        """
        city = map_record(trainer.maps[0])
        self._stream = rr.RecordingStream(_APPLICATION)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.open("wb").close()
        except OSError as error:
            raise UsageError(f"cannot write {path}: {error.strerror}") from error
        self._stream.set_sinks(rr.FileSink(str(path)))
        self._stream.send_blueprint(_blueprint(city))
        self._stream.set_log_time_enabled(False)
        self._stream.send_recording_name(f"{record.preset} {record.stage} seed {record.seed}")
        draw_map(self._stream, city)
        for name, (_, columns) in _CURVES.items():
            self._style(f"train/{name}", columns)
        self._style("validation/completion", ("actor", "average"))
        self._style("validation/ends", ("completed", "collided", "timed out"), _ENDS.values())
        self._stream.log("run", _summary(record), static=True)

    def write(self, entry: Mapping[str, Any], trainer: Trainer | None = None) -> None:
        """Write one line of the log.

        Args:
            entry: As ``log.jsonl`` holds it.
            trainer: After a validation, some episodes of its actor are drawn; ``None`` for a
                line of earlier.
        """
        self._stream.set_time(_TIMELINE, sequence=entry["updates"])
        if entry["kind"] == "validation":
            rates = [entry[name]["completion_rate"] for name in ("actor", "actor_average")]
            self._stream.log("validation/completion", rr.Scalars(rates))
            ends = [entry["actor"][end] for end in _ENDS]
            self._stream.log("validation/ends", rr.Scalars(ends))
            if trainer is not None:
                self._draw(fly_now(trainer))
            return
        values = {**entry, **dict(zip(("rho", "phi", "psi"), entry["saturated"], strict=True))}
        for name, (_, columns) in _CURVES.items():
            row = [values[column] for column in columns if values.get(column) is not None]
            if len(row) == len(columns):
                self._stream.log(f"train/{name}", rr.Scalars(row))

    def close(self) -> None:
        """Finish the file."""
        with contextlib.suppress(RuntimeError):
            self._stream.flush(timeout_sec=_FLUSH_S)
        self._stream.disconnect()

    def _style(self, path: str, names: Sequence[str], shades: Iterable[Color] = _LINES) -> None:
        lines = [color for color, _ in zip(shades, names, strict=False)]
        words = [name.replace("_", " ") for name in names]
        self._stream.log(path, rr.SeriesLines(names=words, colors=lines), static=True)

    def _draw(self, flights: Flights) -> None:
        by_outcome: dict[Outcome, list[Any]] = {outcome: [] for outcome in _COLORS}
        for number in range(min(EPISODES, len(flights.last))):
            flight = flights.case(number)
            by_outcome[flight.outcome].append(flight)
        for outcome, shown in by_outcome.items():
            path = f"world/episodes/{outcome.replace(' ', '_')}"
            color = np.array([_COLORS[outcome]], dtype=np.uint8)
            ways = [flight.position_enu_m for flight in shown]
            radii = rr.Radius.ui_points(1.2)
            self._stream.log(f"{path}/ways", rr.LineStrips3D(ways, colors=color, radii=radii))
            ends = np.array([way[-1] for way in ways]).reshape(-1, 3)
            dots = rr.Points3D(ends, colors=color, radii=rr.Radius.ui_points(4.0))
            self._stream.log(f"{path}/ends", dots)


def fly_now(trainer: Trainer) -> Flights:
    """Fly some episodes with the actor as it is, without touching the run.

    They are flown in a copy of the world of training: from its next random starts, as its
    options have it, but without exploration and with targets kept to the end.
    """
    world = copy.deepcopy(trainer.world)
    world.restart_probability = world.arrived_restart_probability = 0.0
    flights, _ = fly(world, network_policy(trainer.learner.actor))
    return flights


def _summary(record: RunRecord) -> rr.TextDocument:
    place = record.map or f"{record.cities} cities"
    rows = {
        "preset": f"{record.preset}, stage {record.stage}, layout {record.layout}",
        "place": place,
        "seed": record.seed,
        "updates": f"{record.updates:,}",
        "beta": record.beta,
        "from": record.init or "random networks",
        "revision": record.git_revision,
        "command": f"`{record.command}`",
    }
    lines = ["| run | |", "| --- | --- |", *(f"| {name} | {text} |" for name, text in rows.items())]
    ends = "Episodes: green reached, red collided, orange timed out."
    text = "\n".join([*lines, "", ends])
    return rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)


def _blueprint(city: MapRecord) -> rrb.Blueprint:
    plots = [series(f"train/{name}", title, ALWAYS) for name, (title, _) in _CURVES.items()]
    validation = [
        series("validation/completion", "Completed validation cases", ALWAYS),
        series("validation/ends", "How the actor's cases end", ALWAYS),
    ]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(*validation, *plots[:2]),
            rrb.Vertical(*plots[2:6]),
            rrb.Vertical(
                city_view(city),
                rrb.Horizontal(*plots[6:]),
                rrb.TextDocumentView(origin="run", name="Run"),
                row_shares=[6, 2, 2],
            ),
            column_shares=[2, 2, 3],
        ),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(state="collapsed", timeline=_TIMELINE, play_state="following"),
        auto_views=False,
        auto_layout=False,
    )
