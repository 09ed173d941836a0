"""How a report was made: for those who want to make it again."""

from collections import Counter

from training.report_data import Report
from training.report_words import listed, minutes, table


def how_it_was_made(report: Report) -> str:
    """Return the table of commands, code, machine and time."""
    trained_s = [run.train_s for run in report.runs if run.train_s is not None]
    versions = ", ".join(f"{name} {number}" for name, number in report.versions.items())
    trained_by = sorted({run.git_revision for run in report.runs})
    revisions = f"report: {report.git_revision}; training: {listed(trained_by)}"
    return table(
        ["What", ""],
        [
            ["command", f"`{report.command}`"],
            ["code revisions", revisions],
            ["training seeds", listed(report.seeds)],
            [
                "test cases",
                f"{report.cases} a map, drawn from seed {report.test_seed} and a stream of its "
                "own that neither training nor the choice of the actor ever uses",
            ],
            [
                "choice of the actor",
                "the best of the actor and its running average at any validation, on cases of a "
                "third stream",
            ],
            ["updates", f"{budget(report)}; the paper's budget is {report.paper_updates:,}"],
            ["machine", _machines(report)],
            ["versions", versions],
            [
                "wall-clock",
                f"{minutes(report.wall_s)} for this call; {len(report.runs)} runs of "
                f"{minutes(sum(trained_s))} of training in all, one core each, some of them "
                "beside other work",
            ],
            ["finished", report.finished_utc],
        ],
    )


def _machines(report: Report) -> str:
    """Return where runs were trained, and where their actors flew the test cases."""
    trained = Counter(run.machine or "not noted" for run in report.runs).most_common()
    if [name for name, _ in trained] == [report.machine]:
        return report.machine
    where = "; ".join(f"{count} on {name}" for name, count in trained)
    return f"runs trained: {where}; test cases flown on {report.machine}"


def budget(report: Report) -> str:
    """Return the updates of each kind of run."""
    return ", ".join(f"{kind} {count:,}" for kind, count in report.updates.items())
