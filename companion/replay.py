"""``companion replay``: makes the decisions of a recorded flight again and compares every frame.

The whole flying program runs again: link, requests, supervisor, policy and shield, with the bytes,
times and signals of ``inputs.bin`` (see ``journal``). What it sends must be what ``flight.tlog``
holds, bit for bit and at the same microsecond.
"""

import contextlib
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import msgspec
import numpy as np

from companion.config import RunConfig, restore_run_config
from companion.errors import CompanionError, RefusedError
from companion.launch import CONNECT_TIMEOUT_S, fly, load_files, speed_cap, target_sysids
from companion.link.messages import velocity_of
from companion.link.opening import attach, make_codec
from companion.link.signing import load_key
from companion.playback import Playback, PlaybackOver
from companion.policy.actor import Actor
from companion.recording import made_by
from companion.session.folder import INPUTS, TLOG
from companion.session.inputs import RecordedInputs, read_inputs
from companion.session.records import Record
from companion.session.summary import Summary
from companion.session.tlog import read_tlog
from companion.world.maps import Map

DIFFERS_EXIT_CODE = CompanionError.exit_code
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_NOT_OF_THE_LOOP = ("session_dir", "v_max_mps")


class Replayed(msgspec.Struct, frozen=True, kw_only=True):
    """How the replay compares with the flight."""

    same: bool
    """Whether every frame came out bit for bit as it was sent."""
    session: str
    exit_code: int
    frames_sent: int
    setpoints_sent: int
    different_frames: int = 0
    different_setpoints: int = 0
    first_difference_s: float | None = None
    """Since the start of the session."""
    largest_difference_mps: float | None = None
    """Between two setpoints of the same moment."""
    cut_off: bool = False
    """The recording has no end: program or recorder was killed. What there is was replayed."""
    same_summary: bool | None = None
    """Whether the summary came out the same; ``None`` where there is none."""
    recorded_by: str = ""
    replayed_by: str = ""


class RecordedSession:
    """A session folder that can be replayed."""

    def __init__(self, folder: Path) -> None:
        """Read and check the folder.

        Raises:
            RefusedError: If the recording is incomplete, or map or actor have changed since.
            CompanionError: If map or actor cannot be loaded.
        """
        self.folder = folder
        self.inputs: RecordedInputs = read_inputs(folder / INPUTS)
        self.config: RunConfig = restore_run_config(self.inputs.start.config)
        self.map, self.actor = self._load()
        try:
            self.frames = read_tlog((folder / TLOG).read_bytes())
        except OSError as error:
            raise RefusedError(f"cannot read {folder / TLOG}: {error.strerror}") from error
        missing = self.inputs.frames - len(self.frames)
        if missing > 0:
            raise RefusedError(
                f"{folder / TLOG} lacks {missing} frames that the recorder dropped or could not "
                "write: there is nothing to compare the flight with"
            )

    def _load(self) -> tuple[Map, Actor]:
        city, actor = load_files(self.config)
        start = self.inputs.start
        if city.content_hash != start.map.content_hash:
            raise RefusedError(f"map {self.config.map} is not the one that was flown on any more")
        if actor.sha256 != start.actor.sha256:
            raise RefusedError(f"actor {self.config.actor} is not the one that flew any more")
        return city, actor

    def replay(self, record: Callable[[Record], None]) -> Replayed:
        """Make the decisions again.

        Args:
            record: Is handed what the loop records, as in the flight.

        Raises:
            RefusedError: If this program asks the link in another order than the one that flew,
                or the recording does not hold together.
        """
        playback = Playback(self.inputs.journal)
        comparison = _Comparison(self.frames, self.inputs.start.start_utc_us, playback.start())
        summary: Summary | None = None
        try:
            summary = self._fly(playback, comparison, record)
        except PlaybackOver as over:
            if over.diverged and comparison.first_difference_s is None:
                raise RefusedError(
                    "this program reads clock and link in another order than the one that "
                    f"recorded {self.folder}, so its decisions cannot be made again; recorded by "
                    f"{self.inputs.start.made_by}, this is {made_by()}"
                ) from None
        if comparison.torn and comparison.first_difference_s is None:
            raise RefusedError(
                f"{self.folder / TLOG} and {INPUTS} do not belong together: what was received "
                "differs before anything that was sent does"
            )
        return self._result(comparison, summary)

    def _fly(
        self, playback: Playback, comparison: "_Comparison", record: Callable[[Record], None]
    ) -> Summary:
        config, start = self.config, self.inputs.start
        vehicle = attach(
            playback.open(),
            url=start.vehicle.link,
            codec=make_codec(config.backend, config.vehicle_sysid),
            vehicle_sysid=config.vehicle_sysid,
            target_sysids=target_sysids(config),
            timeout_s=CONNECT_TIMEOUT_S,
            signing_key=None if config.signing_key is None else load_key(config.signing_key),
            tap=comparison.tap,
            computer=playback.computer,
            now=playback.now,
            utc_now=lambda: _EPOCH + timedelta(microseconds=start.start_utc_us),
        )
        with contextlib.closing(vehicle):
            return fly(
                vehicle,
                config,
                self.map,
                self.actor,
                speed_cap(vehicle, config),
                record=record,
                stop_requested=playback.stop_requested,
                start_s=comparison.start_s,
            )

    def _result(self, comparison: "_Comparison", summary: Summary | None) -> Replayed:
        flown = self.inputs.summary
        same_summary = None
        if flown is not None and summary is not None:
            same_summary = _of_the_loop(flown) == _of_the_loop(summary)
        same = not comparison.different_frames and not comparison.torn and same_summary is not False
        return Replayed(
            same=same,
            session=str(self.folder),
            exit_code=0 if same else DIFFERS_EXIT_CODE,
            frames_sent=comparison.frames_sent,
            setpoints_sent=comparison.setpoints_sent,
            different_frames=comparison.different_frames,
            different_setpoints=comparison.different_setpoints,
            first_difference_s=comparison.first_difference_s,
            largest_difference_mps=comparison.largest_difference_mps,
            cut_off=flown is None,
            same_summary=same_summary,
            recorded_by=self.inputs.start.made_by,
            replayed_by=made_by(),
        )


class _Comparison:
    """Looks at every frame of the replay beside that of the flight."""

    def __init__(self, frames: list[tuple[int, bytes]], start_utc_us: int, start_s: float) -> None:
        self.start_s = start_s
        self._start_utc_us = start_utc_us
        self._frames = iter(frames)
        self.torn = False
        """Whether the two have come apart, so that nothing more can be compared."""
        self.frames_sent = 0
        self.setpoints_sent = 0
        self.different_frames = 0
        self.different_setpoints = 0
        self.first_difference_s: float | None = None
        self.largest_difference_mps: float | None = None

    def tap(self, sent: bool, time_s: float, frame: bytes) -> None:
        """Take one frame of the replay; ``companion.link.connection.Tap``."""
        since_s = time_s - self.start_s
        then_us, then = next(self._frames, (0, b""))
        same = (then_us, then) == (self._start_utc_us + round(since_s * 1e6), frame)
        self.torn |= not same and not sent
        if not sent or self.torn:
            return
        velocity = velocity_of(frame)
        self.frames_sent += 1
        self.setpoints_sent += velocity is not None
        if same:
            return
        self.different_frames += 1
        if self.first_difference_s is None:
            self.first_difference_s = since_s
        velocity_then = velocity_of(then)
        if velocity is None or velocity_then is None:
            return
        self.different_setpoints += 1
        difference_mps = float(np.linalg.norm(velocity - velocity_then))
        self.largest_difference_mps = max(self.largest_difference_mps or 0.0, difference_mps)


def words(replayed: Replayed) -> str:
    """Return the result for people."""
    sent = f"{replayed.frames_sent} frames sent, {replayed.setpoints_sent} of them setpoints"
    if replayed.cut_off:
        sent += " (until the recording was cut off)"
    if replayed.same:
        return f"{replayed.session}: {sent}: all of them came out the same, bit for bit"
    lines = [f"{replayed.session}: {sent}"]
    if replayed.different_frames:
        lines.append(
            f"  {replayed.different_frames} frames differ, {replayed.different_setpoints} of them "
            f"setpoints, the first at {replayed.first_difference_s:.3f} s"
        )
    if replayed.largest_difference_mps is not None:
        lines.append(f"  by at most {replayed.largest_difference_mps:.3g} m/s")
    if replayed.same_summary is False:
        lines.append("  the summary differs")
    if replayed.recorded_by != replayed.replayed_by:
        lines += [f"  recorded by {replayed.recorded_by}", f"  replayed by {replayed.replayed_by}"]
    return "\n".join(lines)


def _of_the_loop(summary: Summary) -> Summary:
    return msgspec.structs.replace(summary, **dict.fromkeys(_NOT_OF_THE_LOOP))
