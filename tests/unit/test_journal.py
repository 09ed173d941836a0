"""What the flying process is told comes back from the journal in the same order."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import LinkLostError, RefusedError
from companion.journal import Journal, JournaledTransport
from companion.playback import Playback, PlaybackOver
from companion.session.inputs import InputsOutput, read_inputs
from companion.session.records import (
    ActorRecord,
    Inputs,
    MapRecord,
    Raw,
    SessionEnd,
    SessionStart,
    VehicleRecord,
)
from companion.session.summary import Summary

START = SessionStart(
    session_id="s",
    start_utc_us=1,
    map=MapRecord("free", [100.0, 100.0, 100.0]),
    actor=ActorRecord("a"),
    vehicle=VehicleRecord(1, "px4"),
    config={"connect": "mock:px4"},
    v_max_mps=5.0,
    margin_m=2.0,
    arrival_radius_m=5.0,
)


class Link:
    """A transport that answers from a list."""

    speaks_first = True

    def __init__(self, answers):
        self.answers = list(answers)
        self.send_errors = 0

    def receive(self):
        answer = self.answers.pop(0)
        if isinstance(answer, str):
            raise LinkLostError(answer)
        return answer

    def send(self, data):
        self.send_errors += not data

    def wait(self, timeout_s):
        pass

    def reply_to(self, peer):
        pass

    def close(self):
        pass


peers = st.sampled_from([("127.0.0.1", 14540), ("10.0.0.7", 1), "peer"])
chunks = st.lists(st.tuples(peers, st.binary(max_size=30)), max_size=3)
steps = st.lists(
    st.one_of(
        st.tuples(st.just("now"), st.floats(0.0, 1e9)),
        st.tuples(st.just("receive"), chunks | st.text(max_size=5)),
        st.tuples(st.just("send"), st.binary(max_size=1)),
        st.tuples(st.just("stop"), st.booleans()),
    ),
    max_size=60,
)


def ask(kind, clock, link, stop, argument):
    """Do one step; return all that a program could see of it."""
    if kind == "now":
        return clock()
    if kind == "stop":
        return stop()
    if kind == "send":
        link.send(argument)
        return link.send_errors
    try:
        return [(str(peer), data) for peer, data in link.receive()], link.send_errors
    except LinkLostError as error:
        return str(error)


@given(steps)
def test_every_answer_comes_again(steps):
    blocks = []
    times = iter([7.0, *(value for kind, value in steps if kind == "now"), 8.0])
    stops = iter([value for kind, value in steps if kind == "stop"])
    journal = Journal(blocks.append, lambda: next(times))
    inner = Link([value for kind, value in steps if kind == "receive"])
    link = JournaledTransport(inner, journal)
    stop = journal.stop(lambda: next(stops))
    seen = [ask(kind, journal.now, link, stop, value) for kind, value in steps]
    journal.now()
    journal.flush()

    playback = Playback(b"".join(block.data for block in blocks))
    assert playback.start() == journal.start_s == 7.0
    again = playback.open()
    assert again.speaks_first
    for (kind, value), answer in zip(steps, seen, strict=True):
        assert ask(kind, playback.now, again, playback.stop_requested, value) == answer
    assert playback.now() == 8.0
    with pytest.raises(PlaybackOver) as over:
        playback.now()
    assert not over.value.diverged


def test_another_order_is_noticed():
    blocks = []
    journal = Journal(blocks.append, lambda: 1.0)
    link = JournaledTransport(Link([[]]), journal)
    link.receive()
    journal.now()
    journal.flush()
    playback = Playback(blocks[0].data)
    playback.start()
    playback.open()
    with pytest.raises(PlaybackOver) as over:
        playback.now()
    assert over.value.diverged


def test_blocks_are_numbered_and_count_the_frames_before_them():
    records = []
    journal = Journal(records.append, lambda: 1.0)
    for _ in range(5000):
        journal.now()
        journal.tap(True, 1.5, b"frame")
    journal.flush()
    blocks = [record for record in records if isinstance(record, Inputs)]
    assert len(blocks) > 2
    assert [block.number for block in blocks] == list(range(len(blocks)))
    for block in blocks:
        before = records[: records.index(block)]
        assert block.frames == sum(isinstance(record, Raw) for record in before)
    assert records[0] == Raw(True, 0.5, b"frame")


def write(path, records):
    output = InputsOutput(path)
    for record in records:
        output.write(record)
    output.flush(0.0)
    output.close()
    return path


BLOCKS = [Inputs(number, 10 * number, bytes([number]) * 100) for number in range(3)]
END = SessionEnd(Summary(outcome="arrived", reason="", exit_code=0))


def test_inputs_come_back_from_the_file(tmp_path):
    path = write(tmp_path / "inputs.bin", [START, *BLOCKS, Raw(True, 0.0, b"x"), END])
    inputs = read_inputs(path)
    assert inputs.start == START
    assert inputs.journal == b"".join(block.data for block in BLOCKS)
    assert inputs.frames == 20
    assert inputs.summary == END.summary


def test_a_file_that_is_cut_off_anywhere_loses_its_end_or_is_refused(tmp_path):
    whole = write(tmp_path / "inputs.bin", [START, *BLOCKS, END]).read_bytes()
    journal = b"".join(block.data for block in BLOCKS)
    for size in range(len(whole)):
        path = tmp_path / "cut.bin"
        path.write_bytes(whole[:size])
        try:
            inputs = read_inputs(path)
        except RefusedError:
            continue
        assert inputs.summary is None
        assert journal.startswith(inputs.journal)


@pytest.mark.parametrize("records", [[START, BLOCKS[0], BLOCKS[2]], [START, *BLOCKS[1:]]])
def test_a_dropped_block_is_noticed(tmp_path, records):
    with pytest.raises(RefusedError, match="gaps"):
        read_inputs(write(tmp_path / "inputs.bin", records))


@pytest.mark.parametrize("content", [b"", b"MZ" * 100, b"companion inputs 1\n\0\0\0\x05hello"])
def test_a_file_that_is_none_is_refused(tmp_path, content):
    path = tmp_path / "inputs.bin"
    path.write_bytes(content)
    with pytest.raises(RefusedError, match=r"inputs\.bin"):
        read_inputs(path)
