"""One telemetry log, told: what happened in it, and where the vehicle was."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.link.autopilots import Px4
from companion.link.telemetry import Telemetry
from companion.review.following import deaf_times, following_facts
from companion.review.health import Health
from companion.review.link_quality import LinkQuality, Texts
from companion.review.log_file import LogFile, open_log
from companion.review.mode_names import mode_namer
from companion.review.modes import Modes
from companion.review.motion_log import PERIOD_S, MotionLog, with_rates
from companion.review.others import Others
from companion.review.requests import Requests
from companion.review.senders import Senders, find_senders
from companion.review.setpoints import Setpoints
from companion.review.story import Message, Part, Story
from companion.session.records import Event, Tick
from companion.vehicle import Severity
from companion.world.frames import GeoPoint

_TOLD_STEPS = 3  # of the log's clock
_HOLE_S = 60.0  # no ticks are made up for a longer silence
_VERSION = dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION


@dataclass
class LogStory:
    """What a log tells."""

    path: Path
    start_utc_us: int
    duration_s: float
    senders: Senders
    version: str
    """Of the firmware, empty where nobody asked for it."""
    story: Story
    ticks: list[Tick]
    """Ten a second; positions in ENU metres around ``origin``, up from the ground."""
    origin: GeoPoint | None = None
    """On earth, if the log tells."""

    @property
    def events(self) -> list[Event]:
        """What happened, in order."""
        return sorted(self.story.events, key=lambda event: event.time_s)

    @property
    def vehicle_name(self) -> str:
        """Return the vehicle in words: ``PX4 1.18.0 beta quadrotor, system 1``."""
        firmware = {"px4": "PX4", "ardupilot": "ArduPilot"}.get(self.senders.firmware, "unknown")
        words = (firmware, self.version, self.senders.type_name)
        return f"{' '.join(filter(None, words))}, system {self.senders.vehicle}"


def read_story(path: Path) -> LogStory:
    """Read a telemetry log and tell it.

    Raises:
        UsageError: If it is no telemetry log, or no autopilot is heard in it.
    """
    log = open_log(path)
    senders = find_senders(log)
    story = Story(senders.vehicle, senders.component, who=senders.name)
    mode_name = mode_namer(senders.firmware, senders.vehicle_type)
    requests = Requests(story, mode_name, px4=senders.firmware == "px4")
    setpoints, texts, others = Setpoints(story), Texts(story), Others(story)
    health = Health(story, senders.firmware)
    motion = MotionLog(story, setpoints, health.height)
    link = LinkQuality(story)
    modes = Modes(story, requests, mode_name)
    parts: list[Part] = [requests, modes, setpoints, health, texts, others]
    tickers = (setpoints.tick, texts.tick, others.tick)
    end_s, version = _play(log, parts, tickers, motion, link, story)
    for part in parts:
        part.finish(end_s)
    link.finish(end_s)
    motion.finish()
    ticks = with_rates(_on_ground(motion), link.rates_hz)
    for begin_s, until_s in deaf_times(ticks):
        story.warn(
            until_s,
            f"the vehicle did NOT FOLLOW its setpoints for {until_s - begin_s:.1f} s, "
            f"from {begin_s:.1f} s on",
        )
    for other in senders.others:
        story.tell(0.0, f"another autopilot is heard too: system {other}", Severity.NOTICE)
    if log.bad_bytes:
        story.tell(end_s, f"{log.bad_bytes} bytes of the log could not be read", Severity.NOTICE)
    for at_s, step_s in log.clock_steps[:_TOLD_STEPS]:
        what = "went BACK" if step_s < 0.0 else "jumped AHEAD"
        story.warn(at_s, f"the log's clock {what} by {abs(step_s):.0f} s; time goes on without it")
    if len(log.clock_steps) > _TOLD_STEPS:
        story.warn(end_s, f"the log's clock was set {len(log.clock_steps)} times")
    story.facts[:0] = _flight_facts(ticks, end_s)
    story.facts += following_facts(ticks, PERIOD_S)
    return LogStory(path, log.start_utc_us, end_s, senders, version, story, ticks, motion.earth)


def _play(
    log: LogFile,
    parts: list[Part],
    tickers: tuple[Callable[[float], None], ...],
    motion: MotionLog,
    link: LinkQuality,
    story: Story,
) -> tuple[float, str]:
    """Hand every frame to whom it concerns; return the end of the log and the firmware."""
    handlers: dict[int, list[Callable[[Message], None]]] = {}
    for part in parts:
        for number, handle in part.handlers.items():
            handlers.setdefault(number, []).append(handle)
    decoder, identity, due_s, end_s = dialect.MAVLink(None), Telemetry(Px4()), 0.0, 0.0
    for frame in log.frames():
        end_s = max(end_s, frame.time_s)
        if frame.time_s - due_s > _HOLE_S:
            due_s = frame.time_s
        while due_s <= frame.time_s:
            for tick in tickers:
                tick(due_s)
            motion.sample(due_s)
            due_s = round(due_s + PERIOD_S, 6)
        link.take(frame)
        motion.take(frame)
        wanted = handlers.get(frame.message_id, ())
        if not wanted and frame.message_id != _VERSION:
            continue
        try:
            fields = decoder.decode(bytearray(frame.data))
        except dialect.MAVError:
            continue
        message = Message(frame.time_s, frame.system_id, frame.component_id, fields)
        for handle in wanted:
            handle(message)
        if frame.message_id == _VERSION and story.is_autopilot(frame):
            identity.handlers[_VERSION](fields, frame.time_s)
    return end_s, identity.version


def _on_ground(motion: MotionLog) -> list[Tick]:
    """Return the ticks with heights above the place of the take-off."""
    ground_m = motion.ground_m or 0.0

    def lifted(place: list[float] | None) -> list[float] | None:
        return None if place is None else [place[0], place[1], place[2] - ground_m]

    return [
        msgspec.structs.replace(
            tick,
            position_enu_m=lifted(tick.position_enu_m),
            target_enu_m=lifted(tick.target_enu_m),
        )
        for tick in motion.ticks
    ]


def _flight_facts(ticks: list[Tick], end_s: float) -> list[tuple[str, str]]:
    facts = [("Duration", f"{end_s:.1f} s")]
    flown = [tick for tick in ticks if tick.armed and tick.position_enu_m is not None]
    if not flown:
        return facts
    places = np.array([tick.position_enu_m for tick in flown])
    steps_m = np.linalg.norm(np.diff(places, axis=0), axis=-1)
    speeds = [tick.velocity_enu_mps for tick in flown if tick.velocity_enu_mps is not None]
    facts.append(("Distance flown", f"{steps_m[steps_m < 5.0].sum():.1f} m"))
    facts.append(("Highest above take-off", f"{places[:, 2].max():.1f} m"))
    away_m = np.linalg.norm(places[:, :2] - places[0, :2], axis=-1).max()
    facts.append(("Farthest from take-off", f"{away_m:.1f} m"))
    if speeds:
        velocity = np.array(speeds)
        level, up = np.linalg.norm(velocity[:, :2], axis=-1).max(), velocity[:, 2]
        facts.append(("Highest speed", f"{level:.1f} m/s level"))
        facts.append(("Climb and sink", f"{up.max():.1f} and {-up.min():.1f} m/s at most"))
    return facts
