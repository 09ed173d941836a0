"""Telemetry logs that were not recorded here: who asked for what, who said what, where it flew."""

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.errors import MapError
from companion.review.findings import findings
from companion.review.log_flight import log_flight
from companion.review.log_story import read_story
from companion.review.sources import open_flight
from companion.review.words import report
from companion.vehicle import Severity
from companion.world.frames import GeoPoint, enu_to_geodetic
from companion.world.maps import build_map

OFFBOARD, LOITER = 0x60000, 0x03040000


def test_who_asked_for_a_mode_is_told(flight_log):
    beat = dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    flight_log.add(0.0, beat, 255, 190)
    flight_log.heartbeat(0.1, LOITER, armed=False)
    ask = dialect.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
    flight_log.add(1.0, ask, 255, 190)
    flight_log.heartbeat(1.1, LOITER)
    mode = dialect.MAVLink_command_long_message(1, 1, 176, 0, 1, 6, 0, 0, 0, 0, 0)
    flight_log.add(2.0, mode, 255, 190)
    flight_log.heartbeat(2.1, OFFBOARD)
    flight_log.add(3.0, mode, 255, 190)
    flight_log.add(3.1, dialect.MAVLink_command_ack_message(176, 1, 0, 0, 255, 190))
    texts = [event.text for event in read_story(flight_log.write()).events]
    assert "armed, asked for by ground station 255/190" in texts
    assert "mode AUTO.LOITER -> OFFBOARD: asked for by ground station 255/190" in texts
    assert "refused: mode OFFBOARD, ground station 255/190 (temporarily rejected)" in texts


def test_texts_in_chunks_are_joined_and_keep_their_severity(flight_log):
    flight_log.heartbeat(0.0, LOITER)
    text = b"RTL: start return at 520 m (30 m above destination)"
    flight_log.add(1.0, dialect.MAVLink_statustext_message(4, text[:50], 7, 0))
    flight_log.add(1.1, dialect.MAVLink_statustext_message(4, text[50:], 7, 1))
    (event,) = [
        event for event in read_story(flight_log.write()).events if event.source == "autopilot"
    ]
    assert (event.text, event.severity) == (text.decode(), Severity.WARNING)


def test_a_real_arducopter_is_told(real_logs):
    story = read_story(real_logs / "ap_short_flight_companion.tlog")
    texts = [event.text for event in story.events]
    assert "ArduPilot" in story.vehicle_name
    assert any("STABILIZE -> GUIDED: asked for by companion 1/191" in text for text in texts)
    assert any("asks for take-off to 10 m" in text for text in texts)
    assert [text for text in texts if "took off" in text or text.startswith("landed")]
    flight = log_flight(story)
    assert 8.0 < flight.vehicle.position_enu_m[:, 2].max() < 12.0
    assert findings(flight) == []


def test_a_real_px4_is_told(real_logs):
    story = read_story(real_logs / "px4_short_flight_companion_30s.tlog")
    texts = [event.text for event in story.events]
    assert any("AUTO.LOITER -> OFFBOARD: asked for by companion 1/191" in text for text in texts)
    assert "took off" in texts
    curve = log_flight(story).curves["plots/velocity/north"]
    _, sent = curve.line("setpoint")
    _, measured = curve.line("measured")
    assert sent.max() > 1.0
    assert measured.max() > 1.0


def test_a_log_without_local_position_is_placed_by_the_global_one(flight_log):
    for index in range(100):
        t = index / 10
        if index % 10 == 0:
            flight_log.heartbeat(t, LOITER)
        at = dialect.MAVLink_global_position_int_message(
            round(t * 1000), 473977420 + 90 * index, 85455940, 500_000, 0, 200, 0, 0, 0
        )
        flight_log.add(t + 0.01, at)
    flight = log_flight(read_story(flight_log.write()))
    north_m = np.ptp(flight.vehicle.position_enu_m[:, 1])
    assert north_m == pytest.approx(99 * 90e-7 * 111_180, rel=0.02)


def test_a_session_without_a_recording_is_read_from_its_log(flight_log):
    flight_log.fly(end_s=5.0)
    text = report(open_flight(flight_log.write().parent))
    assert "the run was cut off" in " ".join(text.split())
    assert "OFFBOARD" in text


def placed(flight_log, latitude, longitude):
    """A flight of ten seconds north, its local origin somewhere on earth."""
    flight_log.add(0.0, dialect.MAVLink_gps_global_origin_message(latitude, longitude, 489_400))
    flight_log.fly(end_s=10.0)
    return read_story(flight_log.write())


def test_a_log_is_laid_over_a_map_where_it_was_flown(flight_log):
    here = GeoPoint(47.39774, 8.54559, 489.4)
    corner = enu_to_geodetic(here, np.array((-30.0, -10.0, 0.0)))
    house = [[36.0, 20.0], [46.0, 20.0], [46.0, 30.0], [36.0, 30.0]]
    city = build_map("yard", (80.0, 80.0, 50.0), [house], [25.0], origin=corner)
    story = placed(flight_log, round(here.latitude_deg * 1e7), round(here.longitude_deg * 1e7))
    flight = log_flight(story, city)
    np.testing.assert_allclose(flight.vehicle.position_enu_m[0], [30.0, 10.0, 0.0], atol=0.3)
    _, clearance_m = flight.curves["plots/clearance"].line("clearance")
    assert clearance_m.min() == pytest.approx(6.0, abs=0.1)
    elsewhere = build_map("far", (80.0, 80.0, 50.0), [], [], origin=GeoPoint(10.0, 10.0, 0.0))
    with pytest.raises(MapError, match="outside of far"):
        log_flight(story, elsewhere)


def test_a_map_without_a_place_takes_the_log_at_its_launch_point(flight_log):
    flight_log.fly(end_s=10.0)
    story = read_story(flight_log.write())
    city = build_map("box", (80.0, 80.0, 50.0), [], [], launch_enu_m=(40.0, 5.0, 0.0))
    flight = log_flight(story, city)
    np.testing.assert_allclose(flight.vehicle.position_enu_m[0], [40.0, 5.0, 0.0], atol=0.3)
    on_earth = build_map("far", (80.0, 80.0, 50.0), [], [], origin=GeoPoint(10.0, 10.0, 0.0))
    with pytest.raises(MapError, match="does not tell where on earth"):
        log_flight(story, on_earth)
