import math

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.session.records import (
    ActorRecord,
    Event,
    MapRecord,
    Mark,
    Raw,
    RecordReader,
    SessionEnd,
    SessionStart,
    Tick,
    VehicleRecord,
    encode_record,
)
from companion.session.summary import Summary
from companion.vehicle import Severity

numbers = st.floats(allow_nan=False)
vectors = st.none() | st.lists(numbers, min_size=3, max_size=3)
ticks = st.builds(
    Tick,
    time_s=numbers,
    position_enu_m=vectors,
    safe_enu_mps=vectors,
    clearance_m=st.none() | numbers,
    mode=st.text(),
    intervened=st.booleans(),
    rates_hz=st.none() | st.dictionaries(st.text(), numbers),
)
raws = st.builds(Raw, sent=st.booleans(), time_s=numbers, data=st.binary())
events = st.builds(
    Event,
    time_s=numbers,
    severity=st.sampled_from(Severity),
    source=st.sampled_from(["autopilot", "companion"]),
    text=st.text(),
)
START = SessionStart(
    session_id="s",
    start_utc_us=1,
    map=MapRecord("m", [1.0, 2.0, 3.0], [[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]], [2.0], ["a"]),
    actor=ActorRecord("paper-free"),
    vehicle=VehicleRecord(1, "px4"),
    config={"v_max_mps": 4.0, "record": None},
    v_max_mps=4.0,
    margin_m=2.0,
    arrival_radius_m=5.0,
)
END = SessionEnd(Summary(outcome="arrived", reason="within 5 m", exit_code=0))
records = ticks | raws | events | st.just(Mark("closest", [1.0, 2.0, 3.0])) | st.just(END)


@settings(deadline=None)
@given(st.lists(records), st.integers(min_value=1, max_value=300))
def test_records_survive_the_pipe_in_any_portions(sent, portion):
    stream = b"".join(encode_record(record) for record in [START, *sent])
    reader = RecordReader()
    received = []
    for start in range(0, len(stream), portion):
        received += reader.feed(stream[start : start + portion])
    assert received == [START, *sent]


def test_arrays_and_numpy_scalars_arrive_as_plain_numbers():
    tick = Tick(
        time_s=np.float64(1.5),
        position_enu_m=np.array([1.0, 2.0, 3.0]),
        distance_m=np.float32(0.5),
        intervened=np.bool_(True),
    )
    (received,) = RecordReader().feed(encode_record(tick))
    assert received == Tick(
        time_s=1.5, position_enu_m=[1.0, 2.0, 3.0], distance_m=0.5, intervened=True
    )


@pytest.mark.parametrize("value", [math.inf, -math.inf])
def test_no_obstacle_means_infinite_clearance(value):
    (received,) = RecordReader().feed(encode_record(Tick(time_s=0.0, clearance_m=value)))
    assert received.clearance_m == value


def test_what_is_not_data_is_refused():
    with pytest.raises(TypeError, match="object"):
        encode_record(Tick(time_s=0.0, distance_m=object()))


def test_foreign_bytes_are_refused():
    with pytest.raises(msgspec.DecodeError):
        RecordReader().feed(b"\x00\x00\x00\x02hi")
