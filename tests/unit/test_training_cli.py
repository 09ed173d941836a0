"""The training command: what it refuses, what it prints, how it exits."""

import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from training import cli, parts, presets, train

EVALUATION_KEYS = {
    "episodes",
    "completion_rate",
    "completion_rate_ci95",
    "completion_5m",
    "completion_2m",
    "completion_1m",
    "collision_rate",
    "timeout_rate",
    "spl",
    "path_stretch",
    "min_clearance_m",
    "shield_interventions",
    "seconds",
    "out_of_reach",
    "straight_completion_rate",
}


@pytest.fixture(autouse=True)
def few_cases(monkeypatch):
    """Actors that have learnt nothing wander until the time is up: a few of them will do."""
    monkeypatch.setattr(train, "TEST_EPISODES", 20)
    for key, preset in presets.PRESETS.items():
        monkeypatch.setitem(presets.PRESETS, key, replace(preset, validation_episodes=20))


def failure(capsys, *arguments):
    code = cli.main(arguments)
    captured = capsys.readouterr()
    assert captured.err.startswith("training: ")
    assert captured.err.count("\n") == 1
    return code, captured.err


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["train", "--beta", "4"], "it is the ratio beta / (1 - beta), so ask for --beta 0.8"),
        (["train", "--beta", "1"], "--beta must be in [0, 1)"),
        (["train", "--updates", "0"], "--updates must be at least 1"),
        (["evaluate", "--actor", "x.onnx"], "need one of --map and --cities"),
        (["evaluate", "--actor", "paper-free", "--map", "free", "--shield"], "--shield needs"),
        (
            ["evaluate", "--actor", "paper-free", "--map", "free", "--baselines"],
            "--baselines needs",
        ),
        (["evaluate", "--actor", "paper-free", "--edge-cases"], "--edge-cases needs a vehicle"),
        (
            ["evaluate", "--actor", "paper-free", "--map", "free", "--imperfect"],
            "--imperfect needs a vehicle",
        ),
        (
            ["evaluate", "--actor", "paper-free", "--map", "free", "--processes", "2"],
            "--processes needs a vehicle",
        ),
        (["evaluate", "--actor", "flight", "--map", "free", "--processes", "0"], "--processes"),
        (["evaluate", "--actor", "flight", "--edge-cases", "--moving"], "of its own"),
        (["evaluate", "--actor", "flight", "--edge-cases", "--episodes", "3"], "at least 7"),
        (["train", "--map", "free", "--cities", "4"], "need one of --map and --cities"),
        (["evaluate", "--actor", "x.onnx", "--map", "free", "--episodes", "0"], "--episodes"),
    ],
)
def test_options_that_make_no_sense(capsys, tmp_path, monkeypatch, arguments, reason):
    monkeypatch.chdir(tmp_path)
    code, message = failure(capsys, *arguments)
    assert code == 2
    assert reason in message
    assert list(tmp_path.iterdir()) == []


def test_a_gpu_that_is_not_there(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    out = tmp_path / "run"
    code, message = failure(capsys, "train", "--device", "cuda", "--out", str(out))
    assert code == 2
    assert "finds no GPU here: use --device cpu" in message
    assert not out.exists()


def test_an_actor_that_is_not_there(capsys):
    code, message = failure(capsys, "evaluate", "--actor", "none.onnx", "--map", "free")
    assert code == 5
    assert "none.onnx" in message


def test_a_map_that_is_not_there(capsys, tmp_path):
    code, message = failure(capsys, "train", "--map", "nowhere", "--out", str(tmp_path / "run"))
    assert code == 5
    assert "nowhere" in message


def test_without_the_extra_it_says_what_to_install(capsys, monkeypatch):
    find_spec = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "torch" else find_spec(name)
    )
    code, message = failure(capsys, "train")
    assert code == 2
    assert message == 'training: torch not installed: pip install "mavlink-companion[training]"\n'


def test_the_command_starts_without_torch():
    """Parsing options and refusing politely must not need the extra."""
    script = (
        "import sys; sys.modules['torch'] = None\n"
        "import training.cli\n"
        "assert not any(name.split('.')[0] == 'onnx' for name in sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True)


def test_train_export_and_evaluate(capsys, tmp_path):
    run = tmp_path / "run"
    assert cli.main(["train", "--updates", "20", "--out", str(run), "--seed", "1"]) == 0
    assert "held-out cases" in capsys.readouterr().out
    assert json.loads((run / "run.json").read_text())["seed"] == 1

    out = tmp_path / "mine.onnx"
    assert cli.main(["export", "--run", str(run), "--out", str(out)]) == 0
    assert out.is_file()
    capsys.readouterr()

    arguments = ["evaluate", "--actor", str(out), "--map", "env1", "--episodes", "20", "--json"]
    assert cli.main(arguments) == 0
    result = json.loads(capsys.readouterr().out)
    assert result.keys() >= EVALUATION_KEYS
    assert result["episodes"] == 20
    assert result["min_clearance_m"].keys() == {"p1", "p5", "p25", "p50"}
    assert result["command"].startswith("training evaluate --actor ")
    assert result["in_the_loop"]
    assert result["with_shield"] is None

    assert cli.main([*arguments[:-1], "--moving"]) == 0
    assert "flying straight" in capsys.readouterr().out


def test_with_the_shield_both_results_stand_side_by_side(capsys):
    arguments = ["evaluate", "--actor", "flight", "--map", "env1", "--episodes", "4", "--shield"]
    assert cli.main([*arguments, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    shielded = result["with_shield"]
    assert shielded.keys() == EVALUATION_KEYS - {"straight_completion_rate"}
    assert shielded["collision_rate"] == 0.0
    assert shielded["shield_interventions"] > 0 == result["shield_interventions"]
    assert shielded["min_clearance_m"]["p1"] > 0.0

    assert cli.main(arguments) == 0
    lines = capsys.readouterr().out.splitlines()
    row = next(number for number, line in enumerate(lines) if line.startswith("flight "))
    assert lines[row + 1].startswith("  with shield ")
    assert lines[row + 2].startswith("flying straight ")


def test_two_processes_count_what_one_does(capsys, monkeypatch):
    monkeypatch.setattr(parts, "PART_CASES", 3)
    arguments = ["evaluate", "--actor", "flight", "--map", "env1", "--episodes", "5", "--json"]
    results = []
    for processes in ("1", "2"):
        assert cli.main([*arguments, "--processes", processes]) == 0
        results.append(json.loads(capsys.readouterr().out))
        del results[-1]["seconds"], results[-1]["command"]
        for flown in results[-1]["baselines"].values():
            del flown["alone"]["seconds"]
    assert results[0] == results[1]


def test_baselines_fly_the_same_cases_alone_and_with_the_shield(capsys):
    arguments = ["evaluate", "--actor", "flight", "--map", "env1", "--episodes", "6", "--shield"]
    assert cli.main([*arguments, "--baselines", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result.keys() >= EVALUATION_KEYS
    assert result["baselines"].keys() == {"straight", "planner", "potential_field"}
    assert result["straight_completion_rate"] < 1.0
    for flown in result["baselines"].values():
        assert flown["alone"].keys() == EVALUATION_KEYS - {"straight_completion_rate"}
        assert flown["with_shield"]["episodes"] == 6
        assert flown["with_shield"]["collision_rate"] == 0.0
    assert result["baselines"]["planner"]["alone"]["completion_rate"] > 0.8


def test_edge_cases_are_counted_one_by_one(capsys):
    arguments = ["evaluate", "--actor", "flight", "--edge-cases", "--episodes", "8", "--shield"]
    assert cli.main([*arguments, "--json"]) == 0
    cases = json.loads(capsys.readouterr().out)["edge_cases"]
    assert len(cases) == 7
    assert [case["actor"]["alone"]["episodes"] for case in cases.values()] == [2] + 6 * [1]
    assert {case["actor"]["with_shield"]["collision_rate"] for case in cases.values()} == {0.0}
    assert cases["dead end"]["straight"]["alone"]["collision_rate"] == 1.0


def test_a_run_in_the_way_is_not_overwritten(capsys, tmp_path):
    arguments = ["train", "--updates", "20", "--out", str(tmp_path / "run")]
    assert cli.main(arguments) == 0
    capsys.readouterr()
    code, message = failure(capsys, *arguments)
    assert code == 2
    assert "--resume" in message


def test_ctrl_c_leaves_a_checkpoint_to_resume(tmp_path):
    run = tmp_path / "run"
    process = subprocess.Popen(
        [sys.executable, "-m", "training.cli", "train", "--updates", "1000000", "--out", str(run)],
        cwd=Path(cli.__file__).parents[1],
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        text=True,
    )
    log = run / "log.jsonl"
    try:
        deadline_s = time.monotonic() + 90
        while not log.exists() and time.monotonic() < deadline_s:
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130
    assert "go on with --resume" in out
    assert (run / "checkpoint.pt").is_file()
