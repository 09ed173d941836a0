import json
import math
from datetime import UTC, datetime
from pathlib import Path

import pytest

from companion.errors import UsageError
from companion.session.folder import create_session_folder, write_config, write_summary
from companion.session.summary import Summary

START = datetime(2026, 11, 22, 14, 3, 7, tzinfo=UTC)


def test_two_sessions_in_one_second_do_not_share_a_folder(tmp_path):
    first = create_session_folder(tmp_path / "new" / "flights", START)
    second = create_session_folder(tmp_path / "new" / "flights", START)
    assert [first.name, second.name] == ["2026-11-22T14-03-07Z", "2026-11-22T14-03-07Z-2"]


def test_a_file_in_the_way_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match="file"):
        create_session_folder(tmp_path / "file", START)


def test_summary_has_the_keys_scripts_rely_on(tmp_path):
    write_summary(
        tmp_path,
        Summary(outcome="arrived", reason="within 5 m", exit_code=0, min_clearance_m=math.inf),
    )
    assert json.loads((tmp_path / "summary.json").read_text()).keys() >= {
        "outcome",
        "reason",
        "exit_code",
        "session_dir",
        "duration_s",
        "distance_flown_m",
        "final_distance_m",
        "min_clearance_m",
        "max_speed_mps",
        "setpoints_sent",
        "setpoint_rate_hz",
        "jitter_p99_ms",
        "latency_p50_ms",
        "latency_p99_ms",
        "late_ticks",
        "shield_interventions",
        "takeovers",
        "link_loss_percent",
    }
    assert [path.name for path in tmp_path.iterdir()] == ["summary.json"]


def test_config_may_hold_paths(tmp_path):
    write_config(tmp_path, {"map": Path("maps/env1.yaml"), "rate_hz": 20.0})
    text = (tmp_path / "config.json").read_text()
    assert json.loads(text) == {"map": "maps/env1.yaml", "rate_hz": 20.0}
