"""Fixtures that more than one folder of tests needs."""

import heapq
import itertools
import lzma
import struct
from pathlib import Path

import hypothesis
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

# A busy machine is slow now and then; that is no failure.
hypothesis.settings.register_profile("patient", deadline=None)
hypothesis.settings.load_profile("patient")

DATA = Path(__file__).parent / "data"


class MemoryTransport:
    """A ``companion.link`` transport without a socket, under a clock that only ``wait`` moves."""

    def __init__(self, *, speaks_first=False):
        self.speaks_first = speaks_first
        self.send_errors = 0
        self.now_s = 1000.0
        self.sent = []
        self.reply_peer = None
        self.closed = False
        self.on_sent = None
        self._coming = []
        self._order = itertools.count()
        self._reader = dialect.MAVLink(None)

    def now(self):
        return self.now_s

    def deliver(self, data, *, after_s=0.0, peer="peer"):
        """Let ``data`` arrive ``after_s`` from now."""
        heapq.heappush(self._coming, (self.now_s + after_s, next(self._order), peer, data))

    def wait(self, timeout_s):
        target_s = self.now_s + max(0.0, timeout_s)
        if self._coming:
            target_s = min(target_s, max(self._coming[0][0], self.now_s))
        self.now_s = target_s

    def receive(self):
        due = []
        while self._coming and self._coming[0][0] <= self.now_s:
            _, _, peer, data = heapq.heappop(self._coming)
            due.append((peer, data))
        return due

    def reply_to(self, peer):
        self.reply_peer = peer

    def send(self, data):
        message = self._reader.decode(bytearray(data))
        self.sent.append(message)
        if self.on_sent is not None:
            self.on_sent(message)

    def close(self):
        self.closed = True

    def sent_of(self, name):
        """Return what was sent of one message type, oldest first."""
        return [message for message in self.sent if message.get_type() == name]


class Sender:
    """Packs messages of one system and component, by pymavlink alone."""

    def __init__(self, transport, system_id, component_id=1, *, peer="peer"):
        self.transport = transport
        self._mavlink = dialect.MAVLink(None, system_id, component_id)
        self._peer = peer

    def pack(self, message):
        frame = message.pack(self._mavlink)
        self._mavlink.seq = (self._mavlink.seq + 1) % 256
        return frame

    def send(self, message, *, after_s=0.0):
        self.transport.deliver(self.pack(message), after_s=after_s, peer=self._peer)

    def heartbeat(
        self,
        custom_mode=0x03040000,
        *,
        armed=False,
        status=3,
        autopilot=12,
        kind=2,
        after_s=0.0,
    ):
        base_mode = 0x1D | (0x80 if armed else 0)
        self.send(
            dialect.MAVLink_heartbeat_message(kind, autopilot, base_mode, custom_mode, status, 3),
            after_s=after_s,
        )


def read_tlog(data):
    """Return ``(time_s, frame)`` of every frame of a .tlog."""
    frames = []
    position = 0
    while position < len(data):
        (stamp_us,) = struct.unpack_from(">Q", data, position)
        start = position + 8
        position = start + 12 + data[start + 1] + (13 if data[start + 2] & 1 else 0)
        frames.append((stamp_us * 1e-6, data[start:position]))
    return frames


@pytest.fixture
def memory_transport():
    return MemoryTransport


@pytest.fixture
def sender():
    return Sender


@pytest.fixture(scope="session")
def tlog_reader():
    return read_tlog


@pytest.fixture(scope="session")
def recorded_flight():
    """Return the frames of a recorded flight in ``tests/data``, by its name."""

    def load(name):
        return read_tlog(lzma.decompress((DATA / f"{name}.tlog.xz").read_bytes()))

    return load


@pytest.fixture
def constant_actor(tmp_path):
    """Return a function that writes an actor which always answers the same action.

    In layout ``relative``, action ``(x, 0, 0)`` flies level and straight at the target.
    """
    from onnx import TensorProto, helper

    from companion.policy.action import TARGET_SCALING
    from companion.policy.contract import (
        CONTRACT_KEY,
        Contract,
        DynamicsContract,
        ObservationContract,
        encode_contract,
    )
    from companion.policy.observation import LAYOUTS

    def write(action=(0.5, 0.0, 0.0), name="constant.onnx"):
        layout = LAYOUTS["relative"]
        columns = len(layout.fields)
        zeros = helper.make_tensor("w", TensorProto.FLOAT, [columns, 3], [0.0] * columns * 3)
        bias = helper.make_tensor("b", TensorProto.FLOAT, [3], list(action))
        graph = helper.make_graph(
            [helper.make_node("Gemm", ["observation", "w", "b"], ["action"])],
            "constant",
            [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["N", columns])],
            [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["N", 3])],
            initializer=[zeros, bias],
        )
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
        contract = Contract(
            observation=ObservationContract.of(layout),
            action=TARGET_SCALING,
            dynamics=DynamicsContract(edge_m=100.0, edge_low_m=50.0, edge_high_m=1000.0),
            map=None,
            avoids_obstacles=False,
            preset="test",
            stage="free",
            seed=0,
            git_revision="none",
            command="none",
        )
        helper.set_model_props(model, {CONTRACT_KEY: encode_contract(contract)})
        path = tmp_path / name
        path.write_bytes(model.SerializeToString())
        return path

    return write
