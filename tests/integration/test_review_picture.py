"""The picture of a session, from a made-up flight: does it open, and does it show everything?"""

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
import rerun.blueprint as rrb
import shapely
from PIL import Image
from rerun.chunk import RrdReader
from rerun.experimental import ViewerClient

from companion.clock import sleep_s
from companion.errors import CompanionError, UsageError
from companion.review.recordings import make_recordings
from companion.review.show import open_viewer, render_png
from companion.review.sources import open_flight
from companion.review.words import brief, report
from companion.session.folder import write_config, write_summary
from companion.session.recorder import Recorder
from companion.session.records import (
    ActorRecord,
    Event,
    Mark,
    Record,
    SessionEnd,
    SessionStart,
    Tick,
    VehicleRecord,
    map_record,
)
from companion.session.summary import Summary
from companion.session.viewer import headless_viewer
from companion.vehicle import Severity
from companion.world.maps import load_map

PICTURES = Path(__file__).parents[2] / "build" / "pictures"
"""Where CI finds what was rendered."""
RATE_HZ = 20
V_MAX_MPS = 5.0
MARGIN_M = 2.0
EDGE_M = 100.0
COLUMNS = ["east", "north", "up", "target east", "target north", "target up"]

CITY = map_record(load_map("env1"))
START = SessionStart(
    session_id="2026-11-22T14-03-07Z",
    start_utc_us=1_795_356_187_000_000,
    map=CITY,
    actor=ActorRecord("paper-env1", "9f" * 32, "paper", COLUMNS),
    vehicle=VehicleRecord(1, "px4", "1.18.0", "udpin:127.0.0.1:14540"),
    config={"map": "env1"},
    v_max_mps=V_MAX_MPS,
    margin_m=MARGIN_M,
    arrival_radius_m=5.0,
)


@dataclass
class Pilot:
    """Chases a walking target through the made-up city: a policy, a shield and a vehicle."""

    rng: np.random.Generator
    position_m: np.ndarray = field(default_factory=lambda: np.array([8.0, 8.0, 0.0]))
    velocity_mps: np.ndarray = field(default_factory=lambda: np.zeros(3))
    yaw_rad: float = 0.8
    bias_mps: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self):
        self.polygons = shapely.polygons([shapely.linearrings(f) for f in CITY.footprints_m])

    def nearest(self, position_m):
        """Distance to the nearest wall or roof and the way out."""
        point = shapely.Point(position_m[:2])
        best, away = math.inf, np.zeros(3)
        for polygon, height_m in zip(self.polygons, CITY.heights_m, strict=True):
            wall = polygon.exterior.interpolate(polygon.exterior.project(point))
            offset_m = np.array([point.x - wall.x, point.y - wall.y, 0.0])
            if position_m[2] > height_m:
                offset_m[2] = position_m[2] - height_m
            distance_m = float(np.linalg.norm(offset_m))
            if distance_m < best:
                best, away = distance_m, offset_m / max(distance_m, 1e-6)
        return best, away

    def step(self, time_s):
        target_m = np.array([94.0, 30.0 + 0.8 * time_s, 32.0 + 6.0 * math.sin(0.15 * time_s)])
        taking_off = time_s < 6.0
        offset_m = target_m - self.position_m
        distance_m = float(np.linalg.norm(offset_m))
        self.bias_mps += 0.05 * (self.rng.normal(0.0, 1.2, 3) - 0.2 * self.bias_mps)
        proposed_mps = offset_m / distance_m * min(V_MAX_MPS, 0.5 * distance_m) + self.bias_mps
        proposed_mps *= min(1.0, V_MAX_MPS / np.linalg.norm(proposed_mps))
        clearance_m, away = self.nearest(self.position_m)
        safe_mps = proposed_mps.copy()
        approach_mps = -float(safe_mps @ away)
        allowed_mps = max(0.0, 0.8 * (clearance_m - MARGIN_M))
        intervened = not taking_off and approach_mps > allowed_mps
        if intervened:
            along = np.cross(away, [0.0, 0.0, 1.0])
            safe_mps += (approach_mps - allowed_mps) * (away + along)
            safe_mps *= min(1.0, V_MAX_MPS / np.linalg.norm(safe_mps))
        wanted_mps = np.array([0.0, 0.0, 3.0]) if taking_off else safe_mps
        acceleration_mps2 = (wanted_mps - self.velocity_mps) / 0.45
        self.velocity_mps += acceleration_mps2 / RATE_HZ + self.rng.normal(0.0, 0.02, 3)
        self.position_m = self.position_m + self.velocity_mps / RATE_HZ
        east, north, up = proposed_mps
        tier = "coast" if 38.0 < time_s < 40.0 else "fresh"
        target_age_s = time_s - 38.0 if tier == "coast" else float(self.rng.uniform(0.0, 0.2))
        return Tick(
            time_s=time_s,
            position_enu_m=self.position_m.tolist(),
            velocity_enu_mps=self.velocity_mps.tolist(),
            attitude_rad=[-0.06 * acceleration_mps2[1], -0.06 * acceleration_mps2[0], self.yaw_rad],
            target_enu_m=target_m.tolist(),
            target_tier=tier,
            observation=[*(self.position_m / EDGE_M).tolist(), *(target_m / EDGE_M).tolist()],
            action=None if taking_off else (proposed_mps / V_MAX_MPS).tolist(),
            spherical=None
            if taking_off
            else [
                0.05 * float(np.linalg.norm(proposed_mps)) / V_MAX_MPS,
                math.acos(up / np.linalg.norm(proposed_mps)),
                math.atan2(north, east),
            ],
            proposed_enu_mps=None if taking_off else proposed_mps.tolist(),
            safe_enu_mps=None if taking_off else safe_mps.tolist(),
            clearance_m=clearance_m,
            distance_m=distance_m,
            shield_reason="obstacle" if intervened else "",
            intervened=intervened,
            supervisor="taking off" if taking_off else "engaged",
            mode="AUTO.TAKEOFF" if taking_off else "OFFBOARD",
            armed=True,
            battery_fraction=0.96 - 0.002 * time_s,
            link_age_s=time_s % 1.0,
            position_age_s=float(self.rng.uniform(0.0, 0.03)),
            target_age_s=target_age_s,
            latency_ms=float(self.rng.gamma(3.0, 0.15)),
            lateness_ms=float(self.rng.gamma(1.0, 0.2)),
            rates_hz={"LOCAL_POSITION_NED": 30.0, "ATTITUDE": 50.0, "HEARTBEAT": 1.0}
            if time_s % 1.0 == 0.0
            else None,
        )


def fly(duration_s: float) -> list[Record]:
    pilot = Pilot(np.random.default_rng(7))
    ticks = [pilot.step(index / RATE_HZ) for index in range(round(duration_s * RATE_HZ))]
    closest = min(ticks, key=lambda tick: tick.clearance_m)
    events = [
        Event(0.0, Severity.INFO, "companion", "one vehicle: px4 1.18.0, system 1"),
        Event(0.4, Severity.INFO, "autopilot", "Armed by external command"),
        Event(0.6, Severity.INFO, "autopilot", "Using minimum takeoff altitude: 2.50 m"),
        Event(1.1, Severity.INFO, "autopilot", "Takeoff detected"),
        Event(6.0, Severity.NOTICE, "companion", "engaged: the policy flies"),
    ]
    was = False
    for tick in ticks:
        if tick.intervened and not was:
            text = f"shield: obstacle, {tick.clearance_m:.1f} m"
            events.append(Event(tick.time_s, Severity.WARNING, "companion", text))
        was = tick.intervened
    events.append(Event(38.2, Severity.WARNING, "companion", "target silent: fresh -> coast"))
    speed_mps = [math.hypot(*tick.velocity_enu_mps) for tick in ticks]
    summary = Summary(
        outcome="ended",
        reason="followed the target until Ctrl-C",
        exit_code=0,
        duration_s=duration_s,
        distance_flown_m=sum(speed_mps) / RATE_HZ,
        final_distance_m=ticks[-1].distance_m,
        min_clearance_m=closest.clearance_m,
        max_speed_mps=max(speed_mps),
        setpoints_sent=sum(tick.safe_enu_mps is not None for tick in ticks),
        setpoint_rate_hz=20.0,
        jitter_p99_ms=1.1,
        latency_p50_ms=0.42,
        latency_p99_ms=1.2,
        shield_interventions=sum(tick.intervened for tick in ticks),
        link_loss_percent=0.1,
    )
    timed = sorted([*ticks, *events], key=lambda record: record.time_s)
    mark = Mark(f"closest: {closest.clearance_m:.1f} m", closest.position_enu_m)
    return [START, *timed, mark, SessionEnd(summary)]


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """A session of half a minute, recorded by the recorder itself."""
    folder = tmp_path_factory.mktemp("session")
    recorder = Recorder(folder)
    records = fly(30.0)
    for record in records:
        recorder.put(record)
    assert recorder.close(60.0)
    assert recorder.take_messages() == []
    assert recorder.dropped == 0
    write_config(folder, START.config)
    write_summary(folder, records[-1].summary)
    return folder


def rows_of(recording):
    """Rows by entity; static ones count too."""
    rows = {}
    for chunk in RrdReader(str(recording)).stream():
        batch = chunk.to_record_batch()
        rows[chunk.entity_path] = rows.get(chunk.entity_path, 0) + batch.num_rows
    return rows


def test_every_tick_is_in_the_recording(session):
    rows = rows_of(session / "session.rrd")
    ticks = 30 * RATE_HZ
    assert rows["/world/vehicle"] == ticks
    assert rows["/world/target"] == ticks
    assert rows["/plots/speed"] == ticks + 1  # and its style
    assert rows["/world/velocity/measured"] == ticks + 1
    assert {f"/world/map/obstacles/{name}" for name in CITY.names} <= rows.keys()
    assert {"/log/autopilot", "/log/companion", "/state/companion", "/summary"} <= rows.keys()


def test_the_picture_shows_every_view_and_no_complaint(session, vulkan):
    with headless_viewer((1920, 1080)) as address:
        client = ViewerClient.connect(address)
        client.open([str(session / "session.rrd")])
        while client.get_state().loading:
            sleep_s(0.1)
        sleep_s(1.0)
        views = client.get_state().views
    names = {view.name for view in views}
    assert {
        "City",
        "Plan",
        "Chase",
        "States",
        "Messages",
        "Summary",
        "Clearance of obstacles and ground [m]",
    } <= names
    assert [f"{view.name}: {report.summary}" for view in views for report in view.reports] == []


def test_the_picture_is_not_blank(session, vulkan):
    PICTURES.mkdir(parents=True, exist_ok=True)
    render_png(open_flight(session), PICTURES / "session.png", at_s=20.0, size=(1280, 720))
    with Image.open(PICTURES / "session.png") as picture:
        assert picture.size == (1280, 720)
        scene = np.asarray(picture.convert("L"), dtype=float)[60:480, :740]
    assert scene.std() > 10.0


def test_what_the_review_found_lies_over_the_recording(session, tmp_path):
    before = (session / "session.rrd").read_bytes()
    recording, layer = make_recordings(open_flight(session), tmp_path)
    assert recording == session / "session.rrd"
    assert recording.read_bytes() == before
    ids = {
        (entry.application_id, entry.recording_id)
        for path in (recording, layer)
        for entry in RrdReader(str(path)).recordings()
    }
    assert len(ids) == 1
    page = str(
        next(
            chunk.to_record_batch().column("TextDocument:text")[0]
            for chunk in RrdReader(str(layer)).stream()
            if str(chunk.entity_path) == "/summary"
        )
    )
    assert "followed the target" in page
    assert "target silent" in page


@pytest.mark.slow
def test_a_viewer_follows_a_flight_live(tmp_path, vulkan, monkeypatch):
    """In our layout, whichever the viewer has kept of an earlier one."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    kept = tmp_path / "data" / "rerun" / "blueprints" / "companion.rbl"
    kept.parent.mkdir(parents=True)
    rrb.Blueprint(rrb.TextDocumentView(name="Kept"), auto_views=False).save("companion", str(kept))
    recorder = Recorder(tmp_path, live="serve")
    records = [record for record in fly(20.0) if not isinstance(record, SessionEnd)]
    recorder.put(records[0])
    said = []
    while not said:
        said += recorder.take_messages()
        sleep_s(0.1)
    address = said[0].split()[-1]
    with headless_viewer((1280, 720), "--connect", address) as control:
        client = ViewerClient.connect(control)
        ends_s = []
        for part in (records[1:201], records[201:401]):
            for record in part:
                recorder.put(record)
            sleep_s(4.0)
            (found,) = client.get_state().recordings
            ends_s += [line.end / 1e9 for line in found.timelines if line.name == "session"]
        PICTURES.mkdir(parents=True, exist_ok=True)
        client.save_screenshot(str(PICTURES / "live.png"), None)
        views = client.get_state().views
    recorder.close(60.0)
    assert 8.0 < ends_s[0] < ends_s[1] - 8.0
    assert "Chase" in {view.name for view in views}
    assert [report.summary for view in views for report in view.reports] == []
    with Image.open(PICTURES / "live.png") as picture:
        assert np.asarray(picture.convert("L"), dtype=float)[60:480, :740].std() > 10.0


def test_the_report_fits_a_terminal(session):
    text = report(open_flight(session))
    assert max(map(len, text.splitlines()[1:])) <= 80
    for expected in ("followed the target", "Smallest clearance", "session.rrd", "env1"):
        assert expected in text


def test_a_cut_off_recording_is_mended_beside_itself(session, tmp_path, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    whole = (session / "session.rrd").read_bytes()
    cut = tmp_path / "session.rrd"
    cut.write_bytes(whole[: len(whole) * 3 // 4])
    assert "cut off" in report(open_flight(tmp_path))
    assert "session.mended.rrd" in open_viewer(open_flight(tmp_path))
    assert cut.read_bytes() == whole[: len(whole) * 3 // 4]
    assert rows_of(tmp_path / "session.mended.rrd")


@pytest.mark.parametrize("content", [b"", b"no recording at all"], ids=["empty", "foreign"])
def test_what_is_no_recording_is_said_in_one_line(tmp_path, content):
    (tmp_path / "session.rrd").write_bytes(content)
    with pytest.raises(CompanionError, match=r"session\.rrd") as raised:
        open_flight(tmp_path)
    assert "\n" not in str(raised.value)


def test_what_is_no_session_is_said(tmp_path):
    with pytest.raises(UsageError, match="not a session"):
        open_flight(tmp_path)
    with pytest.raises(UsageError, match="there is no"):
        open_flight(tmp_path / "missing")


def test_a_session_without_rerun_still_has_its_report(tmp_path):
    (tmp_path / "flight.tlog").write_bytes(b"")
    assert "missing" in brief(tmp_path)
    with pytest.raises(UsageError, match="nothing to show"):
        render_png(open_flight(tmp_path), tmp_path / "review.png")


def test_a_damaged_summary_is_named(tmp_path):
    (tmp_path / "summary.json").write_text("{")
    for read in (open_flight, brief):
        with pytest.raises(UsageError, match=r"summary\.json is damaged"):
            read(tmp_path)
