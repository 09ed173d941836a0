"""All comparisons of one recording."""

from sim.mock.conformance import motion, requests, timelines
from sim.mock.conformance.recording import Recording
from sim.mock.conformance.replay import replay
from sim.mock.conformance.table import Row


def compare(recording: Recording) -> list[Row]:
    """Return all rows for a recording."""
    flown = replay(recording)
    return [
        *requests.rows(recording, flown),
        *timelines.rows(recording, flown),
        *motion.rows(recording, flown),
    ]
