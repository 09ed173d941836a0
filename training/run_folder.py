"""The folder of one training run: what was asked, the log, the checkpoint."""

import os
import pickle
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch

from companion.errors import UsageError
from training.presets import DeviceName, LayoutName, PresetName, StageName


class RunRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What was asked for: ``run.json``, enough to start the same run again."""

    preset: PresetName
    stage: StageName
    layout: LayoutName
    map: str | None
    """Name or file of the one map,"""
    cities: int | None
    """or how many random cities."""
    map_hash: str
    seed: int
    updates: int
    beta: float
    init: str | None
    git_revision: str
    command: str
    preset_digest: str = ""
    """Of the preset as it was; runs of before it was noted cannot be told from changed ones."""
    device: DeviceName = "cpu"
    machine: str = ""
    """Where it was begun, with the version of torch; earlier runs did not note it."""


class RunFolder:
    """Paths and formats; a checkpoint replaces the one before in one move."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.record_path = folder / "run.json"
        self.log_path = folder / "log.jsonl"
        self.checkpoint_path = folder / "checkpoint.pt"
        self.actor_path = folder / "actor.onnx"

    def write_record(self, record: RunRecord) -> None:
        """Write ``run.json``."""
        self.folder.mkdir(parents=True, exist_ok=True)
        self.record_path.write_bytes(msgspec.json.format(msgspec.json.encode(record)) + b"\n")

    def read_record(self) -> RunRecord:
        """Return ``run.json``.

        Raises:
            UsageError: If there is none, or it is not one of ours.
        """
        try:
            return msgspec.json.decode(self.record_path.read_bytes(), type=RunRecord)
        except OSError as error:
            raise UsageError(f"{self.folder} is no training run: {error.strerror}") from error
        except msgspec.DecodeError as error:
            raise UsageError(f"cannot read {self.record_path}: {error}") from error

    def append_log(self, entry: dict[str, Any]) -> None:
        """Add one line to ``log.jsonl``."""
        with self.log_path.open("ab") as log:
            log.write(msgspec.json.encode(entry) + b"\n")

    def cut_log(self, size: int) -> None:
        """Forget what was logged after a checkpoint that knew ``size`` bytes of log."""
        if self.log_path.exists():
            os.truncate(self.log_path, size)

    def log_size(self) -> int:
        """Return the bytes logged so far."""
        return self.log_path.stat().st_size if self.log_path.exists() else 0

    def save_checkpoint(self, state: dict[str, Any]) -> None:
        """Write the checkpoint beside the old one, then put it in its place."""
        unfinished = self.checkpoint_path.with_suffix(".tmp")
        torch.save(_arrays_to_tensors(state), unfinished)
        unfinished.replace(self.checkpoint_path)

    def load_checkpoint(self) -> dict[str, Any]:
        """Return the checkpoint; only tensors and plain values are read, no code is run.

        Raises:
            UsageError: If there is none, or it cannot be read.
        """
        try:
            state = torch.load(self.checkpoint_path, map_location="cpu", weights_only=True)
        except FileNotFoundError as error:
            raise UsageError(f"{self.folder} has no checkpoint") from error
        except (RuntimeError, EOFError, pickle.UnpicklingError) as error:
            raise UsageError(f"cannot read {self.checkpoint_path}: not a checkpoint") from error
        restored: dict[str, Any] = _tensors_to_arrays(state)
        return restored


_ARRAY = "numpy array"


def _arrays_to_tensors(value: Any) -> Any:
    """Wrap numpy arrays for torch's safe loader, which knows tensors and plain values."""
    if isinstance(value, np.ndarray):
        return {_ARRAY: torch.from_numpy(value)}
    if isinstance(value, dict):
        return {key: _arrays_to_tensors(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(_arrays_to_tensors(entry) for entry in value)
    return value


def _tensors_to_arrays(value: Any) -> Any:
    """Undo ``_arrays_to_tensors``."""
    if isinstance(value, dict):
        if _ARRAY in value:
            return value[_ARRAY].numpy()
        return {key: _tensors_to_arrays(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(_tensors_to_arrays(entry) for entry in value)
    return value
