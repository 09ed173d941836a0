"""What ``companion run`` accepts, and that everything else is refused by name."""

from dataclasses import replace

import numpy as np
import pytest

from companion.config import RunConfig, load_run_config
from companion.errors import UsageError

GOOD = RunConfig(connect="udp:0.0.0.0:14540")


def test_the_defaults_move_nothing():
    GOOD.check()
    assert not any((GOOD.engage, GOOD.arm, GOOD.takeoff, GOOD.shadow))


@pytest.mark.parametrize(
    ("change", "names"),
    [
        ({"connect": ""}, "--connect"),
        ({"connect": "mock:betaflight"}, "mock:px4"),
        ({"v_max": 0.0}, "--v-max"),
        ({"v_max": float("nan")}, "--v-max"),
        ({"v_max": 21.0}, "--v-max"),
        ({"rate_hz": 2.0}, "--rate-hz"),
        ({"margin": 0.0}, "--margin"),
        ({"takeoff": 0.5}, "--takeoff"),
        ({"arm": True}, "--takeoff"),
        ({"shadow": True, "engage": True}, "--shadow"),
        ({"target": "1,2"}, "--target"),
        ({"target": "1,2,x"}, "--target"),
        ({"target": "1,2,nan"}, "--target"),
        ({"target": "1,2,3", "target_sysid": 42}, "--target-sysid"),
        ({"target_global": "95,8,500"}, "latitude"),
        ({"target_sysid": 0}, "--target-sysid"),
        ({"vehicle_sysid": 300}, "--vehicle-sysid"),
        ({"vehicle_sysid": 7, "target_sysid": 7}, "vehicle itself"),
        ({"connect": "mock:px4", "target_sysid": 1}, "mock vehicle"),
    ],
)
def test_refused_by_name_in_one_line(change, names):
    with pytest.raises(UsageError, match=names) as refused:
        replace(GOOD, **change).check()
    assert "\n" not in str(refused.value)


def test_target_is_three_numbers():
    config = replace(GOOD, target="80, 70.5,20")
    np.testing.assert_array_equal(config.target_enu_m(), [80.0, 70.5, 20.0])


def write(tmp_path, text):
    path = tmp_path / "run.yaml"
    path.write_text(text)
    return path


def test_file_holds_the_same_options(tmp_path):
    text = "connect: mock:px4\nmap: env1\ntarget: [80, 80, 20]\nv-max: 4\narm: true"
    path = write(tmp_path, text)
    config = load_run_config(path)
    assert (config.map, config.v_max, config.arm) == ("env1", 4.0, True)
    np.testing.assert_array_equal(config.target_enu_m(), [80.0, 80.0, 20.0])


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("speed: 4", "speed"),
        ("v_max: fast", "v_max"),
        ("arm: 1", "arm"),
        ("- a list", "options"),
        ("a: [", "YAML"),
        ("config: other.yaml", "config"),
        ("a: " + "[" * 5000, "deep"),
    ],
)
def test_file_errors_name_the_key(tmp_path, text, names):
    with pytest.raises(UsageError, match=names) as refused:
        load_run_config(write(tmp_path, text))
    assert "\n" not in str(refused.value)


def test_missing_file_is_a_usage_error(tmp_path):
    with pytest.raises(UsageError, match=r"none\.yaml"):
        load_run_config(tmp_path / "none.yaml")


@pytest.mark.parametrize("text", ["map: env1\nmap: env2\n", "v-max: 2\nv_max: 3\n"])
def test_a_key_given_twice_is_refused(tmp_path, text):
    (tmp_path / "run.yaml").write_text(text)
    with pytest.raises(UsageError, match="appears twice"):
        load_run_config(tmp_path / "run.yaml")
