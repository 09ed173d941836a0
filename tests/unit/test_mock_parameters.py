"""PX4's parameters on the wire: byte-wise, named, numbered and set."""

import struct

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim.mock.bench import Bench
from sim.mock.px4.parameters import PX4_DEFAULTS, Px4Parameters


def booted(**options):
    bench = Bench(**options)
    bench.run(2.0)
    return bench


def ask_param(bench, name):
    bench.send(mavlink.MAVLink_param_request_read_message(1, 1, name.encode(), -1))
    values = [m for m in bench.all("PARAM_VALUE") if m.param_id == name]
    return values[-1] if values else None


def raw_bytes(message):
    return bytes(message.get_msgbuf())[10:14]


# -- parameters ----------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "value"), [("COM_DL_LOSS_T", 10), ("COM_FLTMODE1", -1)])
def test_integers_travel_byte_wise(name, value):
    message = ask_param(booted(), name)
    assert message.param_type == 6
    assert struct.unpack("<i", raw_bytes(message)) == (value,)


def test_floats_travel_as_floats():
    message = ask_param(booted(), "COM_OF_LOSS_T")
    assert (message.param_type, message.param_value) == (9, 1.0)


def test_bit_patterns_of_signalling_nans_survive():
    bench = booted()
    raw = struct.pack("<i", -5_000_000)
    assert bench.vehicle.autopilot.parameters.store("COM_FLTMODE1", 6, raw)
    assert raw_bytes(ask_param(bench, "COM_FLTMODE1")) == raw


def test_unknown_parameter_meets_silence():
    assert ask_param(booted(), "NO_SUCH_THING") is None


def test_parameter_list_is_complete_and_every_index_can_be_read():
    bench = booted()
    bench.send(mavlink.MAVLink_param_request_list_message(1, 1))
    listed = {m.param_index: m.param_id for m in bench.all("PARAM_VALUE")}
    assert sorted(listed.values()) == sorted(PX4_DEFAULTS)
    assert sorted(listed) == list(range(len(PX4_DEFAULTS)))
    assert {m.param_count for m in bench.all("PARAM_VALUE")} == {len(PX4_DEFAULTS)}
    bench.send(mavlink.MAVLink_param_request_read_message(1, 1, b"", 5))
    assert bench.last("PARAM_VALUE").param_id == listed[5]


def test_param_set_works_and_is_obeyed():
    bench = booted()
    bench.send(mavlink.MAVLink_param_set_message(1, 1, b"COM_OF_LOSS_T", 3.0, 9))
    assert bench.last("PARAM_VALUE").param_value == 3.0
    assert bench.vehicle.autopilot.parameters.number("COM_OF_LOSS_T") == 3.0


@pytest.mark.parametrize("wire_type", [6, 1])
def test_param_set_with_the_wrong_type_changes_nothing(wire_type):
    bench = booted()
    bench.send(mavlink.MAVLink_param_set_message(1, 1, b"COM_OF_LOSS_T", 3.0, wire_type))
    assert bench.vehicle.autopilot.parameters.number("COM_OF_LOSS_T") == 1.0


def test_hash_changes_with_any_value():
    table = Px4Parameters()
    before = table.wire_bytes("_HASH_CHECK")
    table.override("COM_OF_LOSS_T", 2.0)
    assert table.wire_bytes("_HASH_CHECK") != before


def test_every_name_fits_the_wire():
    assert all(len(name) <= 16 for name in PX4_DEFAULTS)
