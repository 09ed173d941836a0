"""One run of a reproduction: begun, gone on with, or found finished on the disk."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from companion import clock
from companion.errors import UsageError
from companion.world.maps import load_map
from training.curves import read_log
from training.export import git_revision
from training.machine import describe_machine
from training.places import Place
from training.reproduce_plan import ACTOR_ONLY, Job
from training.run_folder import RunFolder, RunRecord
from training.train import run, transfer
from training.trainer import Trainer


@dataclass(frozen=True, slots=True)
class Run:
    """A job with its folders; a ``workers.Work``."""

    job: Job
    folder: Path
    init: Path | None
    """Folder of the run that it starts from."""
    after: str | None
    """That run's name, where it is not over yet."""
    command: str

    @property
    def name(self) -> str:
        """Return the job's name."""
        return self.job.name

    def do(self, tell: Callable[[int], None], stop: Callable[[], bool]) -> bool:
        """Train from the last checkpoint, or from the start, to the end."""
        folder = RunFolder(self.folder)
        trainer = Trainer(self.job.preset, Place(map=self.job.map), self.job.seed)
        if folder.checkpoint_path.exists():
            state = folder.load_checkpoint()
            trainer.load_state_dict(state["trainer"])
            folder.cut_log(state["log_size"])
        else:
            if self.init is not None:
                actor_only = self.job.variant == ACTOR_ONLY
                transfer(trainer, RunFolder(self.init), actor_only=actor_only)
            folder.write_record(self._record())
            folder.log_path.unlink(missing_ok=True)
        tell(trainer.updates)
        return run(
            trainer,
            folder,
            lambda trainer, _: tell(trainer.updates),
            now_s=clock.now_s,
            stop=stop,
        )

    def _record(self) -> RunRecord:
        job = self.job
        return RunRecord(
            preset=job.preset.name,
            stage=job.preset.stage,
            layout=job.preset.layout_name,
            map=job.map,
            cities=None,
            map_hash=load_map(job.map).content_hash,
            seed=job.seed,
            updates=job.preset.updates,
            beta=job.preset.world.reward.beta,
            init=None if self.init is None else str(self.init),
            git_revision=git_revision(),
            command=self.command,
            preset_digest=job.preset.digest,
            machine=describe_machine(),
        )


def is_over(folder: Path, job: Job) -> bool:
    """Return whether a folder holds this very run, come to its end.

    Where it started from is not looked at: see ``find_run``.
    """
    run_folder = RunFolder(folder)
    try:
        record = run_folder.read_record()
    except UsageError:
        return False
    if (record.preset_digest, record.seed, record.map, record.cities) != (
        job.preset.digest,
        job.seed,
        job.map,
        None,
    ) or record.map_hash != load_map(job.map).content_hash:
        return False
    if not (run_folder.checkpoint_path.exists() and run_folder.log_path.exists()):
        return False
    validated = [
        entry["updates"] for entry in read_log(run_folder.log_path) if entry["kind"] == "validation"
    ]
    return bool(validated) and validated[-1] >= job.preset.updates


def find_run(job: Job, own: Path, init: Path | None, others: Iterable[Path]) -> Path | None:
    """Return the folder in which a job is over already.

    Args:
        job: The run looked for.
        own: The folder that it would be given.
        init: Folder of the run that it starts from, if that is over.
        others: Further folders to look in; a run in one of them must have started from ``init``.
    """
    if is_over(own, job):
        return own
    for folder in others:
        # Runs of the command line carry over all networks.
        if job.variant == ACTOR_ONLY or not is_over(folder, job):
            continue
        started = RunFolder(folder).read_record().init
        if started is None and job.init is None:
            return folder
        if started is not None and init is not None and _same_run(Path(started), init):
            return folder
    return None


def _same_run(first: Path, second: Path) -> bool:
    """Return whether two folders are one, or hold the same run twice: training repeats itself."""
    if first.resolve() == second.resolve():
        return True
    try:
        one, other = (RunFolder(folder).read_record() for folder in (first, second))
    except UsageError:
        return False
    keys = ("preset_digest", "seed", "map_hash", "init")
    return bool(one.preset_digest) and all(getattr(one, k) == getattr(other, k) for k in keys)
