"""The link against the mock vehicle, beyond the contract: transports, frames, targets, loss."""

import socket

import pytest

from companion.vehicle import EventKind, RequestKind, RequestState


@pytest.fixture
def px4(port, mock, linked):
    """A PX4 that calls us over UDP, ready to arm."""

    def start(*options, **link_options):
        listening = port()
        mock("--connect", f"udpout:127.0.0.1:{listening}", *options)
        pilot = linked(f"udpin:127.0.0.1:{listening}", **link_options)
        pilot.fly(pilot.ready)
        return pilot

    return start


@pytest.mark.parametrize("scheme", ["udpout", "tcp"])
def test_calling_a_vehicle_that_waits(port, mock, linked, scheme):
    calling = port(socket.SOCK_STREAM if scheme == "tcp" else socket.SOCK_DGRAM)
    listening = "tcpin" if scheme == "tcp" else "udpin"
    mock("--connect", f"{listening}:127.0.0.1:{calling}")
    pilot = linked(f"{scheme}:127.0.0.1:{calling}")
    pilot.fly(pilot.ready)
    assert pilot.ask(RequestKind.ARM) is RequestState.CONFIRMED


@pytest.mark.parametrize("fault", ["ekf_reset", "origin_move"])
def test_frame_events_raise_the_epoch(px4, fault):
    pilot = px4("--fault", f"from=arm,t=4,kind={fault}")
    before = pilot.state.frame_epoch
    assert pilot.ask(RequestKind.ARM) is RequestState.CONFIRMED
    pilot.fly(lambda: pilot.state.frame_epoch > before)


def test_a_reboot_is_told_and_recovered_from(px4):
    pilot = px4("--fault", "from=arm,t=4,kind=reboot")
    assert pilot.ask(RequestKind.ARM) is RequestState.CONFIRMED
    pilot.fly(lambda: pilot.heard(EventKind.REBOOT))
    pilot.fly(pilot.ready)
    assert not pilot.state.armed


@pytest.mark.parametrize("message", ["gpi", "follow"])
def test_a_target_is_followed_by_its_reports(px4, message):
    pilot = px4(
        "--target", f"kind=straight,sysid=42,speed=2,at=30:0:10,to=30:80:10,message={message}",
        target_sysids=(42,),
    )  # fmt: skip
    pilot.fly(lambda: 42 in pilot.vehicle.targets())
    first = pilot.vehicle.targets()[42]
    pilot.fly(
        lambda: (
            pilot.vehicle.targets()[42].position.latitude_deg > first.position.latitude_deg + 2e-5
        )
    )
    later = pilot.vehicle.targets()[42]
    assert later.position.longitude_deg == pytest.approx(first.position.longitude_deg, abs=1e-6)
    assert later.time_s > first.time_s
    assert later.velocity_ned_mps[0] == pytest.approx(2.0, abs=0.2)


def test_a_bad_link_is_counted_and_survived(px4):
    pilot = px4(
        "--fault", "kind=loss,percent=10",
        "--fault", "kind=corrupt,percent=5",
        "--fault", "kind=duplicate,percent=5",
    )  # fmt: skip
    pilot.get_external()
    stats = pilot.vehicle.stats()
    assert 8.0 < stats.loss_percent < 25.0
    assert stats.bytes_bad > 0
