"""A link that is replayed from its journal sends the very bytes it once sent."""

from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.errors import LinkLostError
from companion.journal import Journal, JournaledTransport
from companion.link.messages import velocity_of, velocity_setpoint
from companion.link.opening import attach
from companion.link.signing import Signing, SigningKey, stamp_at
from companion.playback import Playback
from companion.session.records import Inputs
from companion.vehicle import RequestKind, Severity, SystemStatus

BEGAN = datetime(2026, 11, 22, 14, 3, 7, 123456, tzinfo=UTC)
KEY = SigningKey(bytes(range(32)), "for this test")


def use(vehicle, now):
    """Do a little of everything that a flight does with its link; return what it saw."""
    seen = [vehicle.read_params(["COM_OF_LOSS_T"], 1.0), vehicle.info]
    vehicle.request(RequestKind.ARM)
    for step in range(60):
        vehicle.wait_until(now() + 0.05)
        vehicle.send_velocity(np.array([0.1 * step, 0.0, -0.5]))
        if step % 20 == 0:
            vehicle.send_heartbeat(SystemStatus.ACTIVE)
            vehicle.say("a text that is longer than one chunk of fifty characters", Severity.INFO)
        seen += [repr(vehicle.state()), vehicle.request_status(), vehicle.take_events()]
    return seen, vehicle.stats()


def autopilot_talks(transport, sender, key):
    """Let two peers speak, one of them nonsense, in packets that are cut and joined."""
    px4, stranger = sender(transport, 1), sender(transport, 9, peer="stranger")
    signing = None if key is None else Signing(key, stamp=stamp_at(BEGAN), now_s=0.0, link_id=1)
    for step in range(120):
        frames = [
            px4.pack(dialect.MAVLink_heartbeat_message(2, 12, 0x1D, 0x03040000, 3, 3)),
            px4.pack(dialect.MAVLink_local_position_ned_message(step, step, 1, -2, 0, 0, 0)),
            px4.pack(dialect.MAVLink_attitude_message(step, 0, 0, 0.1, 0, 0, 0)),
        ]
        if signing is not None:
            frames = [signing.sign(frame, 0.05 * step) for frame in frames]
        data = b"".join(frames)
        transport.deliver(data[:37], after_s=0.05 * step)
        transport.deliver(data[37:], after_s=0.05 * step + 0.013)
        transport.deliver(b"\xfdrubbish", after_s=0.05 * step, peer="stranger")
        stranger.heartbeat(after_s=0.05 * step, autopilot=8)


@pytest.mark.parametrize("key", [None, KEY], ids=["open", "signed"])
def test_the_same_bytes_again(memory_transport, sender, key):
    records, sent, sent_again = [], [], []
    transport = memory_transport()
    journal = Journal(records.append, transport.now)
    options = {"url": "memory", "signing_key": key, "utc_now": lambda: BEGAN}
    autopilot_talks(transport, sender, key)
    vehicle = attach(
        JournaledTransport(transport, journal),
        now=journal.now,
        tap=lambda *frame: sent.append(frame),
        **options,
    )
    seen = use(vehicle, journal.now)
    journal.flush()

    playback = Playback(b"".join(r.data for r in records if isinstance(r, Inputs)))
    assert playback.start() == journal.start_s
    again = attach(
        playback.open(),
        now=playback.now,
        tap=lambda *frame: sent_again.append(frame),
        **options,
    )
    assert use(again, playback.now) == seen
    assert sent_again == sent
    assert sum(was_sent for was_sent, _, _ in sent) > 60


def test_a_lost_link_is_lost_again_at_the_same_moment(memory_transport, sender):
    class Breaking(memory_transport):
        def receive(self):
            if self.now_s > 1003.0:
                raise LinkLostError("unplugged")
            return super().receive()

    transport, records = Breaking(), []
    journal = Journal(records.append, transport.now)
    autopilot_talks(transport, sender, None)
    vehicle = attach(JournaledTransport(transport, journal), url="memory", now=journal.now)
    with pytest.raises(LinkLostError, match="unplugged"):
        vehicle.wait_until(1010.0)
    lost_s = journal.now()
    journal.flush()
    playback = Playback(b"".join(r.data for r in records if isinstance(r, Inputs)))
    playback.start()
    again = attach(playback.open(), url="memory", now=playback.now)
    with pytest.raises(LinkLostError, match="unplugged"):
        again.wait_until(1010.0)
    assert playback.now() == lost_s


@given(st.tuples(*[st.floats(-900, 900, width=32)] * 3))
def test_the_velocity_of_a_setpoint_can_be_read_off_its_frame(velocity):
    message = velocity_setpoint(1, np.array(velocity), None, time_boot_ms=7)
    frame = message.pack(dialect.MAVLink(None, 1, 191))
    np.testing.assert_array_equal(velocity_of(frame), velocity)


def test_other_frames_have_no_velocity():
    mavlink = dialect.MAVLink(None, 1, 191)
    assert velocity_of(b"") is None
    heartbeat = dialect.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
    assert velocity_of(heartbeat.pack(mavlink)) is None
