"""``python -m sim.mock.fit FLIGHT.tlog FIT.png``: how well the mock's dynamics fit a real flight.

Draws the recorded velocity against that of the mock, which got the same requests at the same
moments of the autopilot's clock: the steps, and how it stops when the stream of setpoints ends.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

from companion.errors import CompanionError, UsageError
from sim.mock.conformance.motion import stops_of
from sim.mock.conformance.recording import Recording, read_recording
from sim.mock.conformance.replay import Flown, replay
from sim.mock.packet import message_id

EDGE_S = 4.0
"""So much is shown before the first and after the last setpoint."""
SETPOINT_IDS = (84, 86)


def main() -> int:
    """Draw the picture and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m sim.mock.fit", description=__doc__)
    parser.add_argument("recording", type=Path, metavar="FLIGHT.tlog")
    parser.add_argument("picture", type=Path, metavar="FIT.png")
    options = parser.parse_args()
    try:
        recording = read_recording(options.recording)
        draw(recording, replay(recording), options.picture)
    except CompanionError as error:
        print(f"fit: {error}", file=sys.stderr)
        return error.exit_code
    return 0


def draw(recording: Recording, flown: Flown, picture: Path) -> None:
    """Write the picture of one flight.

    Raises:
        UsageError: If matplotlib is missing, or nobody steered in the recording.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise UsageError("pictures need matplotlib: install the training extra") from error
    streamed = [t for t, frame in recording.requests if message_id(frame) in SETPOINT_IDS]
    if not streamed:
        raise UsageError(f"{recording.name}: nobody sends setpoints in it")
    start_s, end_s = streamed[0] - EDGE_S, streamed[-1] + EDGE_S
    figure = Figure(figsize=(9.0, 5.6), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True)
    sides = (("recorded", recording.of("LOCAL_POSITION_NED"), "#888888", 2.5),
             ("mock", flown.of("LOCAL_POSITION_NED"), "#c03020", 1.2))  # fmt: skip
    for panel, name, words in zip(axes, ("vx", "vy", "vz"), ("north", "east", "down"), strict=True):
        for label, messages, colour, width in sides:
            times_s, values = _curve(messages, name, start_s, end_s)
            panel.plot(times_s, values, color=colour, linewidth=width, label=label)
        for stop in stops_of(recording):
            panel.axvline(stop.time_s, color="#3060a0", linewidth=0.8, linestyle=":")
        panel.set_ylabel(f"{words}, m/s")
        panel.grid(alpha=0.3)
    axes[0].legend(loc="upper right", frameon=False)
    axes[0].set_title(f"{recording.name}: velocity; dotted, a stream of setpoints ends")
    axes[-1].set_xlabel("seconds of the autopilot's clock")
    figure.savefig(picture, dpi=90)


def _curve(messages: Any, name: str, start_s: float, end_s: float) -> tuple[Any, Any]:
    points = [(t, getattr(message, name)) for t, message in messages if start_s <= t <= end_s]
    return np.array([t for t, _ in points]), np.array([value for _, value in points])


if __name__ == "__main__":
    raise SystemExit(main())
