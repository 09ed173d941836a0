"""Where the mock stands, what its targets do and what its referee sees."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.errors import MapError, UsageError
from companion.world.frames import GeoPoint, geodetic_to_enu
from companion.world.maps import load_map
from sim.mock.bench import Bench
from sim.mock.geodesy import SphericalProjection
from sim.mock.placement import place_vehicle
from sim.mock.px4.personality import PX4
from sim.mock.targets import parse_target
from sim.mock.vehicle import Settings

LAUNCHED = """\
name: yard
size_m: [60, 60, 40]
launch_m: [10, 10, 0]
obstacles:
  - {name: wall, footprint_m: [[25, 0], [27, 0], [27, 60], [25, 60]], height_m: 20}
"""
PLACED = """\
name: block
size_m: [100, 100, 60]
origin: {latitude_deg: 47.3974, longitude_deg: 8.5452, altitude_m: 480.0}
obstacles:
  - {name: house, footprint_m: [[60, 60], [80, 60], [80, 80], [60, 80]], height_m: 20}
"""


@pytest.fixture
def yard(tmp_path):
    (tmp_path / "yard.yaml").write_text(LAUNCHED)
    return load_map(tmp_path / "yard.yaml")


@pytest.fixture
def block(tmp_path):
    (tmp_path / "block.yaml").write_text(PLACED)
    return load_map(tmp_path / "block.yaml")


def airborne(settings, down=-5.0, **options):
    bench = Bench(settings, **options)
    bench.run(2.0)
    up = bench.position(0.0, 0.0, down)
    bench.run(0.3, stream=up)
    bench.command(176, 1.0, 6.0)
    bench.command(400, 1.0)
    bench.run(12.0, stream=up)
    return bench


# -- placement -----------------------------------------------------------------------------


def test_a_map_with_a_launch_point_puts_local_zero_there(yard):
    place = place_vehicle(yard, None)
    np.testing.assert_allclose(place.to_map((0.0, 0.0, 0.0)), [10.0, 10.0, 0.0])
    np.testing.assert_allclose(place.to_map((3.0, 5.0, -7.0)), [15.0, 13.0, 7.0])
    assert place.home == PX4.home


def test_a_map_on_earth_has_the_vehicle_at_px4s_home_on_its_ground(block):
    place = place_vehicle(block, None)
    assert place.home.latitude_deg == pytest.approx(47.397742)
    assert place.home.longitude_deg == pytest.approx(8.545594)
    assert place.home.altitude_m == pytest.approx(480.0, abs=0.01)


@pytest.mark.parametrize("latitude_deg", [-33.9, 52.1])
def test_a_map_elsewhere_on_earth_has_the_vehicle_on_open_ground_near_its_middle(
    tmp_path, latitude_deg
):
    elsewhere = PLACED.replace("47.3974", str(latitude_deg)).replace(
        "60, 60], [80, 60", "30, 30], [80, 30"
    )
    (tmp_path / "block.yaml").write_text(elsewhere)
    city = load_map(tmp_path / "block.yaml")
    place = place_vehicle(city, None)
    launch_m = place.to_map((0.0, 0.0, 0.0))
    assert launch_m[2] == pytest.approx(0.0, abs=1e-6)
    assert place.home.altitude_m == pytest.approx(480.0, abs=0.01)
    assert 5.0 <= city.obstacles.signed_distance_m(launch_m) < 10.0
    assert np.abs(launch_m[:2] - 50.0).max() < 40.0


def test_what_global_position_int_says_is_where_the_referee_sees_the_vehicle(block):
    place = place_vehicle(block, None)
    bench = Bench(Settings(place))
    bench.run(2.0)
    bench.vehicle.autopilot.body.position_m = (30.0, -20.0, -10.0)
    bench.run(0.02)
    message = bench.last("GLOBAL_POSITION_INT")
    point = GeoPoint(message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3)
    assert block.origin is not None
    seen = place.to_map(bench.vehicle.autopilot.body.position_m)
    np.testing.assert_allclose(geodetic_to_enu(block.origin, point), seen, atol=0.02)


@pytest.mark.parametrize(
    "home",
    [GeoPoint(47.0, 8.0, 480.0), GeoPoint(47.39803, 8.54613, 480.0)],
    ids=["far away", "in the house"],
)
def test_a_home_outside_the_map_or_in_an_obstacle_is_refused(block, home):
    with pytest.raises(MapError, match="--home"):
        place_vehicle(block, home)


@pytest.mark.parametrize("latitude", [47.4, -35.4, 0.0, 70.0])
def test_projection_round_trip(latitude):
    projection = SphericalProjection(GeoPoint(latitude, 8.5, 0.0))
    for north, east in [(0.0, 0.0), (100.0, -250.0), (-1e3, 1e3)]:
        back = projection.to_local(*projection.to_geodetic(north, east))
        assert back == pytest.approx((north, east), abs=1e-3)


# -- targets -------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["static", "straight", "circle", "waypoints"])
@pytest.mark.parametrize("seed", range(5))
def test_targets_stay_in_the_map_and_out_of_obstacles(kind, seed):
    place = place_vehicle(load_map("env1"), None)
    text = f"kind={kind},speed=5" + (",radius=6" if kind == "circle" else "")
    target = parse_target(text, place, np.random.default_rng(seed))
    positions = np.array([target.position_enu_m(t) for t in np.arange(0.0, 120.0, 0.5)])
    assert place.map is not None
    assert bool(np.all(place.map.contains(positions)))
    assert float(np.min(place.map.obstacles.signed_distance_m(positions))) > 1.4


@pytest.mark.parametrize("kind", ["straight", "circle", "waypoints"])
def test_targets_keep_their_speed(kind):
    place = place_vehicle(None, None)
    target = parse_target(f"kind={kind},speed=3", place, np.random.default_rng(1))
    positions = np.array([target.position_enu_m(t) for t in np.arange(0.0, 60.0, 0.01)])
    speeds = np.linalg.norm(np.diff(positions, axis=0), axis=1) / 0.01
    assert float(np.median(speeds)) == pytest.approx(3.0, rel=0.01)
    assert float(np.max(speeds)) < 3.01


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("kind=spiral", "kind must be one of"),
        ("colour=red", "unknown key colour"),
        ("at=1:2", "at must be E:N:U"),
        ("at=1:2:nan", "at must be finite"),
        ("sysid=300", "sysid must lie in"),
        ("sysid=1", "sysid must be a number of at least 2"),
        ("kind=static,at=26:30:10", "within 2 m of an obstacle"),
        ("kind=static,at=500:30:10", "leaves the map"),
        ("kind=straight,at=5:5:5,to=50:5:5", "within 2 m of an obstacle"),
        ("kind=straight,at=5:5:5", "needs both"),
        ("kind=circle,radius=100", "no free place"),
    ],
)
def test_impossible_targets_are_refused(yard, text, complaint):
    with pytest.raises(UsageError, match=complaint):
        parse_target(text, place_vehicle(yard, None), np.random.default_rng(0))


def test_a_target_reports_at_its_rate_from_its_own_system():
    bench = Bench(targets=["kind=static,at=20:30:10,sysid=43,rate=8"])
    bench.run(10.0)
    mine = [m for m in bench.all("GLOBAL_POSITION_INT") if m.get_srcSystem() == 43]
    assert len(mine) == pytest.approx(80, abs=2)
    heartbeats = [m for m in bench.all("HEARTBEAT") if m.get_srcSystem() == 43]
    assert len(heartbeats) == pytest.approx(10, abs=1)
    assert {m.autopilot for m in heartbeats} == {8}
    assert mine[-1].relative_alt == 10_000


def test_a_target_with_px4_autopilot_looks_like_a_second_vehicle():
    bench = Bench(targets=["kind=static,at=20:30:10,autopilot=px4"])
    bench.run(2.0)
    assert 12 in {m.autopilot for m in bench.all("HEARTBEAT") if m.get_srcSystem() == 42}


def test_follow_target_carries_position_and_velocity():
    bench = Bench(targets=["kind=straight,at=0:0:10,to=0:100:10,speed=2,message=follow"])
    bench.run(5.0)
    message = bench.last("FOLLOW_TARGET")
    assert message.get_srcSystem() == 42
    assert message.est_capabilities == 3
    assert message.vel == pytest.approx([2.0, 0.0, 0.0], abs=0.05)
    assert message.alt == pytest.approx(499.4, abs=0.01)
    assert len(bench.all("FOLLOW_TARGET")) == pytest.approx(20, abs=1)


def test_a_recorded_path_is_flown_once_through_from_where_it_is_put(tmp_path):
    track = tmp_path / "track.csv"
    track.write_text("time_s,east_m,north_m,up_m\n5,0,0,10\n7,4,0,10\n9,4,6,12\n")
    place = place_vehicle(None, None)
    target = parse_target(f"kind=recorded,file={track}", place, np.random.default_rng(0))
    assert target.position_enu_m(1.0) == pytest.approx([2.0, 0.0, 10.0])
    assert target.position_enu_m(9.0) == pytest.approx([4.0, 6.0, 12.0])
    moved = parse_target(f"kind=recorded,at=1:2:3,file={track}", place, np.random.default_rng(0))
    assert moved.position_enu_m(2.0) == pytest.approx([5.0, 2.0, 3.0])


def test_the_flight_of_another_vehicle_can_be_followed(tmp_path):
    bench = Bench()
    bench.run(2.0)
    bench.run(0.3, stream=bench.velocity(0.0, 0.0, -1.0))
    bench.command(176, 1.0, 6.0)
    bench.command(400, 1.0)
    bench.run(8.0, stream=bench.velocity(2.0, -1.0, -1.0))
    flown = bench.last("LOCAL_POSITION_NED")
    log = tmp_path / "flight.tlog"
    log.write_bytes(
        b"".join(
            round((1e9 + r.time_s) * 1e6).to_bytes(8, "big") + r.packet for r in bench.received
        )
    )
    rng = np.random.default_rng(0)
    target = parse_target(f"kind=recorded,file={log}", place_vehicle(None, None), rng)
    assert target.position_enu_m(99.0) == pytest.approx([flown.y, flown.x, -flown.z], abs=0.2)


@pytest.mark.parametrize(
    ("content", "complaint"),
    [("0,0,0,1\n", "no track"), ("1,2\n", "expected time_s"), ("0,0,0,1\n0,0,0,2\n", "rise")],
)
def test_a_track_that_is_none_is_refused(tmp_path, content, complaint):
    track = tmp_path / "track.csv"
    track.write_text(content)
    with pytest.raises(UsageError, match=complaint):
        parse_target(
            f"kind=recorded,file={track}", place_vehicle(None, None), np.random.default_rng(0)
        )


def test_a_telephone_repeats_itself_and_drops_out():
    bench = Bench(targets=["kind=straight,at=0:0:10,to=0:500:10,message=follow,repeat=4,drop=25"])
    bench.run(50.0)
    reports = bench.all("FOLLOW_TARGET")
    assert len(reports) == pytest.approx(150, abs=25)
    assert len({message.lat for message in reports}) == pytest.approx(50, abs=2)


def test_two_systems_of_one_id_are_in_two_places():
    bench = Bench(targets=["kind=static,at=0:0:10"], faults=["t=1,kind=target_clash,east=40"])
    bench.run(3.0)
    assert (
        len(
            {
                message.lon
                for message in bench.all("GLOBAL_POSITION_INT")
                if message.get_srcSystem() == 42
            }
        )
        == 2
    )


# -- referee -------------------------------------------------------------------------------


def test_flying_into_a_wall_is_one_contact_seen_by_everybody(yard):
    bench = airborne(Settings(place_vehicle(yard, None)))
    bench.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), identity=(255, 190))
    bench.run(4.0, stream=bench.velocity(0.0, 4.0, 0.0))
    bench.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), identity=(255, 190))
    bench.run(4.0, stream=bench.velocity(0.0, 4.0, 0.0))
    report = bench.vehicle.report()
    assert len(report["contacts"]) == 1
    contact = report["contacts"][0]
    assert contact["position_enu_m"][0] == pytest.approx(25.1, abs=0.2)
    assert contact["speed_mps"] == pytest.approx(3.3, abs=0.2)
    assert report["min_clearance_m"] < 0.0
    assert any(text.startswith("Contact with an obstacle") for text in bench.texts())
    assert bench.last("NAMED_VALUE_INT").value == 1
    assert any("Contact" in line for line in bench.vehicle.take_log())


def test_a_wall_passed_at_a_distance_is_no_contact(yard):
    bench = airborne(Settings(place_vehicle(yard, None)))
    bench.run(6.0, stream=bench.velocity(4.0, 0.0, 0.0))
    report = bench.vehicle.report()
    assert report["contacts"] == []
    assert report["min_clearance_m"] == pytest.approx(15.0, abs=0.2)
    assert report["max_speed_mps"] == pytest.approx(3.3, abs=0.1)
    assert report["distance_flown_m"] > 20.0


def test_a_thin_wall_cannot_be_tunnelled_at_full_speed(tmp_path):
    text = LAUNCHED.replace("27, 0], [27, 60]", "25.1, 0], [25.1, 60]")
    (tmp_path / "thin.yaml").write_text(text)
    bench = airborne(Settings(place_vehicle(load_map(tmp_path / "thin.yaml"), None)))
    bench.run(5.0, stream=bench.velocity(0.0, 12.0, 0.0))
    assert len(bench.vehicle.report()["contacts"]) == 1


def test_leaving_the_map_is_noted(yard):
    bench = airborne(Settings(place_vehicle(yard, None)))
    assert not bench.vehicle.report()["left_map"]
    bench.run(6.0, stream=bench.velocity(-4.0, 0.0, 0.0))
    assert bench.vehicle.report()["left_map"]


def test_a_vehicle_on_the_ground_touches_nothing():
    bench = Bench(Settings(place_vehicle(load_map("env1"), None)))
    bench.run(5.0)
    report = bench.vehicle.report()
    assert report["contacts"] == []
    assert report["min_clearance_m"] is None


def test_the_timeline_tells_modes_and_failsafes(yard):
    bench = airborne(Settings(place_vehicle(yard, None)))
    bench.run(3.0)
    words = [entry[1] for entry in bench.vehicle.report()["timeline"]]
    assert words == [
        "LOITER disarmed",
        "OFFBOARD armed",
        "RTL armed (failsafe: setpoints lost)",
    ]


def test_a_companion_that_ignores_mode_changes_is_told_from_one_that_does_not():
    def after_takeover(*, stubborn):
        settings = Settings(place_vehicle(None, None))
        bench = airborne(settings, faults=["from=offboard,t=14,kind=rc_takeover"])
        shown = len(bench.all("HEARTBEAT"))
        hover = bench.velocity(0.0, 0.0, 0.0)

        def taken():
            return bench.last("HEARTBEAT").custom_mode == 0x00030000

        assert bench.run(10.0, stream=hover, until=taken)
        assert len(bench.all("HEARTBEAT")) > shown
        bench.run(3.0, stream=hover if stubborn else None)
        return bench.vehicle.report()["setpoints_after_mode_shown"]

    assert after_takeover(stubborn=False) <= 1
    assert after_takeover(stubborn=True) >= 59


# -- dynamics ------------------------------------------------------------------------------


def test_steady_shortfall_is_what_it_says():
    response = replace(PX4.response, shortfall=0.16)
    bench = airborne(Settings(place_vehicle(None, None), response=response))
    bench.run(30.0, stream=bench.velocity(2.0, 0.0, 0.0))
    assert bench.last("LOCAL_POSITION_NED").vx == pytest.approx(1.68, abs=0.02)


def test_velocity_step_is_as_fast_as_px4_sih():
    bench = airborne(Settings(place_vehicle(None, None)))
    bench.run(1.5, stream=bench.velocity(2.0, 0.0, 0.0))
    assert bench.last("LOCAL_POSITION_NED").vx == pytest.approx(1.45, abs=0.2)
    bench.run(3.5, stream=bench.velocity(2.0, 0.0, 0.0))
    assert bench.last("LOCAL_POSITION_NED").vx == pytest.approx(1.68, abs=0.05)


def test_wind_drifts_a_hovering_vehicle_and_noise_shakes_its_report():
    settings = Settings(place_vehicle(None, None), wind_ned_mps=(0.0, 5.0, 0.0), noise_m=0.1)
    bench = airborne(settings)
    bench.run(5.0, stream=bench.velocity(0.0, 0.0, 0.0))
    assert bench.last("LOCAL_POSITION_NED").vy == pytest.approx(0.5, abs=0.1)
    tail = [m.z for m in bench.all("LOCAL_POSITION_NED")][-60:]
    assert float(np.std(tail)) == pytest.approx(0.1, rel=0.4)


def test_takeoff_takes_as_long_as_recorded():
    bench = Bench()
    bench.run(2.0)
    up = bench.position(0.0, 0.0, -10.0)
    bench.run(0.5, stream=up)
    bench.command(176, 1.0, 6.0)
    bench.command(400, 1.0)
    armed_s = bench.time_s
    body = bench.vehicle.autopilot.body
    assert bench.run(20.0, stream=up, until=lambda: body.position_m[2] < -9.5)
    assert bench.time_s - armed_s == pytest.approx(8.1, abs=1.0)  # PX4 SIH: 8.1 s


def test_landing_from_ten_metres_takes_as_long_as_recorded():
    bench = airborne(Settings(place_vehicle(None, None)), down=-10.0)
    bench.command(21)
    start_s = bench.time_s
    assert bench.run(60.0, until=lambda: not bench.vehicle.autopilot.armed)
    assert bench.time_s - start_s == pytest.approx(19.0, abs=2.5)  # PX4 SIH: about 19 s
    assert math.hypot(*bench.vehicle.autopilot.body.position_m) < 0.5
