"""The reproduction: what it plans, that it goes on where it stopped, that it reports honestly."""

import json
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from companion.errors import UsageError
from training import cli, presets, report_measure, reproduce, reproduce_plan, reproduce_run
from training.presets import PRESETS
from training.report_data import read_report
from training.reproduce_plan import BETA, Budget, plan
from training.reproduce_run import Run, find_run, is_over
from training.run_folder import RunFolder
from training.workers import do_all

TINY = Budget(
    free_updates=8,
    obstacle_updates=8,
    coordinates_updates=8,
    ablation_updates=8,
    coordinates_seeds=1,
    transfer_seeds=1,
    ablation_seeds=1,
    cases=6,
)
CHANGES = {
    "relative": reproduce.ABLATIONS["relative"],
    "large-buffer": reproduce.ABLATIONS["large-buffer"],
}


@pytest.fixture(autouse=True)
def tiny_presets(monkeypatch):
    torch.set_num_threads(1)
    for key in (("paper", "free"), ("paper", "obstacles"), ("coordinates", "obstacles")):
        preset = PRESETS[key]
        tiny = replace(
            preset,
            ddpg=replace(preset.ddpg, hidden=(8, 8)),
            batch_size=16,
            num_worlds=8,
            replay_capacity=200,
            warmup_steps=2,
            validate_every=4,
            validation_episodes=4,
            updates=16,
        )
        monkeypatch.setitem(presets.PRESETS, key, tiny)
    monkeypatch.setattr(reproduce_plan, "_VALIDATIONS", 2)
    monkeypatch.setattr(reproduce, "QUICK", TINY)
    monkeypatch.setattr(reproduce, "CHANGES", CHANGES)


@pytest.fixture
def in_this_process(monkeypatch):
    """Train one run after the other here: processes take seconds to start."""

    def do_all_here(works, *, processes, told, stop):
        left = {}
        for work in works:
            if stop():
                left[work.name] = "not begun"
            elif not work.do(lambda far, name=work.name: told(name, far), stop):
                left[work.name] = "stopped"
        return left

    monkeypatch.setattr(reproduce, "do_all", do_all_here)
    for module in (reproduce, reproduce_run):
        monkeypatch.setattr(module, "git_revision", lambda: "unknown")
    # One map of two, and one change, are the same code in half the time.
    monkeypatch.setattr(reproduce_plan, "OBSTACLE_MAPS", ("env1",))
    monkeypatch.setattr(report_measure, "MAPS", ("free", "env1"))
    monkeypatch.setattr(reproduce, "CHANGES", {"large-buffer": CHANGES["large-buffer"]})


def job(name):
    return next(job for job in plan(TINY, (1,), CHANGES) if job.name == name)


def run_of(job, folder, init=None):
    return Run(job, folder / job.label, init, None, "training reproduce")


def test_every_run_comes_after_the_one_it_starts_from():
    jobs = plan(Budget(), (1, 2, 3), reproduce.ABLATIONS)
    names = [job.name for job in jobs]
    assert len(set(names)) == len(names)
    for job_ in jobs:
        assert job_.init is None or names.index(job_.init) < names.index(job_.name)
    table = [(job_.map, job_.seed) for job_ in jobs if job_.group == "obstacles"]
    assert sorted(table) == [(city, seed) for city in ("env1", "env2") for seed in (1, 2, 3)]
    assert all(job_.init is None for job_ in jobs if job_.variant == "scratch")


def test_networks_of_another_meaning_get_a_free_stage_of_their_own():
    jobs = {job.name: job for job in plan(TINY, (1,), {**CHANGES, BETA.name: BETA})}
    assert jobs["env1-short-large-buffer-seed1"].init == "free-seed1"
    assert jobs["env1-short-relative-seed1"].init == "free-relative-seed1"
    assert jobs["free-relative-seed1"].preset.layout_name == "relative"
    assert jobs["env1-short-beta-0.4-seed1"].preset.world.reward.beta == 0.4
    assert jobs["env1-short-beta-0.4-seed1"].init == "free-beta-0.4-seed1"


def test_the_same_free_stage_is_trained_once():
    twice = dict.fromkeys(("relative", "again"), reproduce.ABLATIONS["relative"])
    jobs = {job.name: job for job in plan(TINY, (1,), twice)}
    assert "free-again-seed1" not in jobs
    assert jobs["env1-short-again-seed1"].init == "free-relative-seed1"


def test_a_run_stopped_in_the_middle_ends_as_if_it_had_not_been(tmp_path):
    whole, parts = (run_of(job("free-seed1"), tmp_path / name) for name in ("whole", "parts"))
    assert whole.do(lambda _: None, lambda: False)
    asked = 0

    def after_a_while():
        nonlocal asked
        asked += 1
        return asked > 3

    assert not parts.do(lambda _: None, after_a_while)
    assert not is_over(parts.folder, parts.job)
    assert parts.do(lambda _: None, lambda: False)
    assert is_over(parts.folder, parts.job)
    first, second = (RunFolder(run.folder).load_checkpoint()["trainer"] for run in (whole, parts))
    assert first["updates"] == second["updates"] == 8
    for name, weights in first["learner"]["actor"].items():
        assert torch.equal(weights, second["learner"]["actor"][name])


def test_finished_runs_elsewhere_are_used_only_if_they_are_the_same(tmp_path):
    free, env1 = job("free-seed1"), job("env1-seed1")
    source = run_of(free, tmp_path)
    source.do(lambda _: None, lambda: False)
    run = run_of(env1, tmp_path, source.folder)
    run.do(lambda _: None, lambda: False)

    elsewhere = tmp_path / "elsewhere"
    others = [source.folder, run.folder]
    assert find_run(env1, elsewhere, source.folder, others) == run.folder
    assert find_run(free, elsewhere, None, others) == source.folder
    assert find_run(env1, elsewhere, tmp_path, others) is None
    assert find_run(replace(env1, seed=2), elsewhere, source.folder, others) is None
    assert find_run(replace(env1, map="env2"), elsewhere, source.folder, others) is None
    longer = replace(env1, preset=replace(env1.preset, updates=12))
    assert find_run(longer, elsewhere, source.folder, others) is None


def test_the_whole_paper(tmp_path, capsys, in_this_process, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["reproduce", "--quick"]) == 0
    out = Path("runs/report-quick")
    report, _ = read_report(out)
    page = (out / "README.md").read_text()
    assert report.unfinished == []
    assert "**This is a quick run**" in page
    assert "| obstacle free | 100 % |" in page
    assert "(ablations.png)" in page
    assert (out / "ablations.png").stat().st_size > 10_000
    planner = report.baseline("env1").planner
    assert planner.evaluation.completion_rate == 1.0
    assert planner.spl_shortest > planner.evaluation.spl
    assert {run.variant for run in report.runs} == {
        "paper",
        "scratch",
        "actor-only",
        "large-buffer",
    }
    assert "## Six coordinates" in page
    assert "(coordinates.png)" in page

    # Again, with one run missing in the report: only what it starts from is looked for as well.
    numbers = json.loads((out / "numbers.json").read_text())
    numbers["runs"] = [run for run in numbers["runs"] if run["name"] != "env1-seed1"]
    (out / "numbers.json").write_text(json.dumps(numbers))
    capsys.readouterr()
    monkeypatch.setattr(reproduce, "draw_all", lambda *_: [])
    before = {path: path.stat().st_mtime_ns for path in Path("runs").rglob("checkpoint.pt")}
    assert cli.main(["reproduce", "--quick"]) == 0
    said = capsys.readouterr().out
    assert "free-seed1: done before" in said
    assert "env1-seed1: done before" in said
    assert "env1-short-scratch-seed1: measured before" in said
    again = read_report(out)[0].runs
    assert [(run.name, run.static.mean_return) for run in again] == [
        (run.name, run.static.mean_return) for run in report.runs
    ]
    assert before == {path: path.stat().st_mtime_ns for path in Path("runs").rglob("checkpoint.pt")}

    # One run trained elsewhere: the page tells which, and where.
    assert f"| machine | {report.machine} |" in page
    numbers = json.loads((out / "numbers.json").read_text())
    numbers["runs"][0]["machine"] = "another machine"
    (out / "numbers.json").write_text(json.dumps(numbers))
    (out / "README.md").unlink()
    assert cli.main(["figures", "--report", str(out)]) == 0
    page = (out / "README.md").read_text()
    assert page.startswith("# The paper, reproduced")
    assert "; 1 on another machine; test cases flown on" in page


def test_what_did_not_finish_is_said(tmp_path, capsys, in_this_process, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = []

    def enough():
        done.append(1)
        return len(done) > 6

    @contextmanager
    def stop_soon():
        yield enough

    monkeypatch.setattr(reproduce, "stop_on_signal", stop_soon)
    assert cli.main(["reproduce", "--quick"]) == 130
    page = Path("runs/report-quick/README.md").read_text()
    assert "**Not finished**" in page
    assert "no run came to its end" in page
    numbers = json.loads(Path("runs/report-quick/numbers.json").read_text())
    assert "env1-seed1" in numbers["unfinished"]


def test_processes_work_side_by_side_and_say_what_went_wrong(tmp_path):
    free, env1 = job("free-seed1"), job("env1-seed1")
    good = run_of(free, tmp_path)
    works = [
        good,
        replace(run_of(env1, tmp_path, tmp_path / "nowhere"), after=free.name),
        replace(run_of(job("env2-seed1"), tmp_path, good.folder), after=env1.name),
    ]
    heard = []
    left = do_all(
        works, processes=2, told=lambda name, far: heard.append((name, far)), stop=lambda: False
    )
    assert left.keys() == {"env1-seed1", "env2-seed1"}
    assert "no training run" in left["env1-seed1"]
    assert left["env2-seed1"] == "waits for env1-seed1"
    assert ("free-seed1", 0) in heard
    assert is_over(good.folder, free)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--seeds", "1", "1"], "--seeds must all be different"),
        (["--processes", "0"], "--processes must be at least 1"),
    ],
)
def test_options_that_make_no_sense(capsys, tmp_path, monkeypatch, arguments, reason):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["reproduce", *arguments]) == 2
    assert reason in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_figures_of_no_report(tmp_path):
    with pytest.raises(UsageError, match="holds no report"):
        reproduce.write_figures(tmp_path)
