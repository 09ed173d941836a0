"""``companion preflight`` as people use it: a real mock, real sockets, every byte looked at."""

import contextlib
import json
import select
import socket
import struct
import subprocess
import sys
import threading

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

PREFLIGHT = [sys.executable, "-m", "companion.cli", "preflight"]
MOCK = [sys.executable, "-m", "sim.mock", "--autopilot", "px4", "--exit-with-parent"]
LOOPBACK = "127.0.0.1"


def bound():
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    opened.bind((LOOPBACK, 0))
    return opened


class Wire(threading.Thread):
    """Passes datagrams between a mock and the companion; keeps what the companion sends."""

    def __init__(self):
        super().__init__(daemon=True)
        self.to_mock, self.to_companion, probe = bound(), bound(), bound()
        self.mock_port = self.to_mock.getsockname()[1]
        self.companion_port = probe.getsockname()[1]
        probe.close()
        self.over = threading.Event()
        self.sent = []
        self.before = []
        """What the mock is told before anything else of the companion."""

    def run(self):
        mavlink = dialect.MAVLink(None)
        mavlink.robust_parsing = True
        mock = None
        while not self.over.is_set():
            readable, _, _ = select.select([self.to_mock, self.to_companion], [], [], 0.1)
            for socket_ in readable:
                data, peer = socket_.recvfrom(65536)
                if socket_ is self.to_mock:
                    mock = peer
                    for datagram in self.before:
                        self.to_mock.sendto(datagram, mock)
                    self.before = []
                    with contextlib.suppress(OSError):
                        self.to_companion.sendto(data, (LOOPBACK, self.companion_port))
                else:
                    self.sent += mavlink.parse_buffer(data) or []
                    self.to_mock.sendto(data, mock)

    def close(self):
        self.over.set()
        self.join(5.0)
        self.to_mock.close()
        self.to_companion.close()


@pytest.fixture
def wire():
    """Start a mock behind a wire; return the wire."""
    wires, processes = [], []

    def start(*options, before=()):
        wires.append(Wire())
        wires[-1].before = list(before)
        wires[-1].start()
        processes.append(
            subprocess.Popen(
                [*MOCK, "--connect", f"udpout:{LOOPBACK}:{wires[-1].mock_port}", *options],
                stdout=subprocess.DEVNULL,
            )
        )
        return wires[-1]

    yield start
    for process in processes:
        process.kill()
        process.wait()
    for started in wires:
        started.close()


def preflight(*options):
    """Return exit code, what stdout held and what stderr held."""
    done = subprocess.run(
        [*PREFLIGHT, *map(str, options)], capture_output=True, text=True, timeout=60, check=False
    )
    assert "Traceback" not in done.stderr
    return done.returncode, done.stdout, done.stderr


def inspected(*options):
    code, out, _ = preflight("--json", *options)
    seen = json.loads(out)
    assert (seen["exit_code"], seen["go"]) == (code, code == 0)
    return seen


def test_a_table_that_fits_eighty_columns_and_says_go():
    code, out, err = preflight("--connect", "mock:px4", "--map", "env1", "--target", "85,80,25")
    assert (code, err) == (0, "")
    lines = out.splitlines()
    assert max(map(len, lines)) <= 80
    assert lines[-1].split() == ["Verdict", "GO"]
    flat = " ".join(out.split())
    assert "system 1, px4 1.18.0" in flat
    assert "If this program dies, PX4 flies on for 1.0 s, then climbs to 30 m above home" in flat
    assert "COM_OBL_RC_ACT 0" in flat
    assert "COM_OF_LOSS_T 1.0" in flat
    assert "13.3 m at 5 m/s" in flat
    assert "env1 at (10.0, 10.0, 0.0) m" in flat
    assert "agree within 0.0" in flat


def test_a_target_inside_the_margin_is_told_or_refused():
    beside_obs1 = ("--connect", "mock:px4", "--map", "env1", "--target", "11.5,68,30")
    seen = inspected(*beside_obs1)
    assert seen["go"]
    assert "comes no nearer to it than 2.0 m" in seen["warnings"][0]
    seen = inspected(*beside_obs1, "--margin", "8")
    assert not seen["go"]
    assert "out of reach" in seen["reasons"][0]


def test_nothing_leaves_but_heartbeats_and_requests_for_data(wire):
    between = wire("--map", "zurich")
    seen = inspected(
        "--connect", f"udpin:{LOOPBACK}:{between.companion_port}",
        "--map", "zurich", "--target", "94,96,40",
    )  # fmt: skip
    assert seen["go"], seen["reasons"]
    kinds = {message.get_type() for message in between.sent}
    assert kinds <= {"HEARTBEAT", "PARAM_REQUEST_READ", "COMMAND_LONG", "TIMESYNC"}
    assert {"HEARTBEAT", "PARAM_REQUEST_READ"} <= kinds
    commands = {m.command for m in between.sent if m.get_type() == "COMMAND_LONG"}
    assert commands <= {
        dialect.MAV_CMD_REQUEST_MESSAGE,
        dialect.MAV_CMD_SET_MESSAGE_INTERVAL,
    }
    beats = [m for m in between.sent if m.get_type() == "HEARTBEAT"]
    assert 4 <= len(beats) <= 8
    assert {(m.get_srcSystem(), m.get_srcComponent(), m.type) for m in beats} == {
        (1, 191, dialect.MAV_TYPE_ONBOARD_CONTROLLER)
    }
    assert seen["local_origin"] == pytest.approx([47.397742, 8.545594, 488.0], abs=0.01)
    assert seen["tie_residual_m"] < 0.5
    assert seen["position_rate_hz"] == pytest.approx(30.0, abs=2.0)
    assert seen["target_distance_m"] == pytest.approx(40.0, abs=0.5)


def param_set(name, value):
    raw = struct.pack("<i" if isinstance(value, int) else "<f", value)
    message = dialect.MAVLink_param_set_message(
        1, 1, name.encode(), struct.unpack("<f", raw)[0], 6 if isinstance(value, int) else 9
    )
    return message.pack(dialect.MAVLink(None, 255, 190))


def test_the_failsafe_is_that_of_the_vehicle_on_the_link(wire):
    between = wire(before=[param_set("COM_OF_LOSS_T", 0.25), param_set("COM_OBL_RC_ACT", 5)])
    seen = inspected("--connect", f"udpin:{LOOPBACK}:{between.companion_port}")
    assert seen["parameters"]["COM_OF_LOSS_T"] == 0.25
    assert seen["parameters"]["COM_OBL_RC_ACT"] == 5
    assert seen["failsafe"].startswith("if this program dies, PX4 flies on for 0.2 s, then holds")
    assert seen["blind_travel_m"] == pytest.approx(5.0 * 0.35 + 25 / 3.2, abs=0.01)


@pytest.mark.parametrize(
    ("mock_options", "options", "says"),
    [
        ([], ["--map", "env1", "--target", "50,48,20"], "inside obstacle obs2"),
        ([], ["--map", "env1", "--target", "50,48,900"], "outside map env1"),
        ([], ["--map", "env1", "--takeoff", "99"], "a take-off to 99 m"),
        (["--home", "47.5,8.5,400"], ["--map", "zurich"], "outside map zurich"),
        (["--fault", "t=0.1,kind=second_companion"], [], "1/192"),
        (["--fault", "kind=loss,percent=80"], [], "times a second"),
        ([], ["--target-sysid", "42"], "no position of target system 42"),
    ],
)
def test_no_go_says_why(wire, mock_options, options, says):
    between = wire(*mock_options)
    seen = inspected("--connect", f"udpin:{LOOPBACK}:{between.companion_port}", *options)
    assert not seen["go"]
    assert seen["exit_code"] == 5
    assert any(says in reason for reason in seen["reasons"]), seen["reasons"]


@pytest.mark.parametrize(
    ("options", "code"),
    [
        ([], 2),
        (["--connect", "carrier-pigeon:1"], 2),
        (["--connect", "mock:px4", "--map", "atlantis"], 5),
        (["--connect", "mock:px4", "--target", "1,2"], 2),
    ],
)
def test_what_cannot_be_looked_at_ends_in_one_line(options, code):
    got, out, err = preflight("--json", *options)
    assert got == code
    assert json.loads(out)["exit_code"] == code
    assert len(err.splitlines()) == 1


@pytest.fixture
def heartbeats_only():
    """A PX4 of which nothing is heard but its heartbeat; return the port it calls."""
    port = (probe := bound()).getsockname()[1]
    probe.close()
    over = threading.Event()

    def beat():
        mavlink = dialect.MAVLink(None, 1, 1)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            while not over.wait(0.2):
                message = dialect.MAVLink_heartbeat_message(2, 12, 0x1D, 0x03040000, 3, 3)
                out.sendto(message.pack(mavlink), (LOOPBACK, port))

    thread = threading.Thread(target=beat, daemon=True)
    thread.start()
    yield port
    over.set()
    thread.join(5.0)


def test_a_vehicle_that_says_next_to_nothing_is_told_of_all_the_same(heartbeats_only):
    code, out, err = preflight(
        "--connect", f"udpin:{LOOPBACK}:{heartbeats_only}", "--map", "env1", "--target", "50,48,20"
    )
    assert (code, err) == (5, "")
    flat = " ".join(out.split())
    assert "Verdict NO-GO - no position from the vehicle yet" in flat
    assert "inside obstacle obs2" in flat
    assert "COM_OF_LOSS_T (assumed)" in flat
    assert "not read, defaults assumed: COM_OF_LOSS_T" in flat
    assert "climbs to 60 m above home" in flat
    assert "not checked against GLOBAL_POSITION_INT" in flat
