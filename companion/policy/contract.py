"""What an actor was made for: the JSON inside its file, written by training, obeyed by flight."""

from typing import Any

import msgspec
import numpy as np

from companion.arrays import Float32Array
from companion.errors import ActorError
from companion.policy.action import ActionScaling
from companion.policy.measures import measures
from companion.policy.observation import LAYOUTS, Layout

CONTRACT_KEY = "mavlink_companion_contract"
"""Key of the contract in the ONNX file's ``metadata_props``."""

CONTRACT_VERSION = 2
"""Newest contract this code understands. Version 2 may say what training has seen."""

_SEEN_TAIL = 0.001

Range = tuple[float, float]
"""Least and largest."""


class ObservationContract(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The layout the actor was trained on, down to the column."""

    layout: str
    version: int
    columns: tuple[str, ...]

    @classmethod
    def of(cls, layout: Layout) -> "ObservationContract":
        """Return the contract of a layout as it is now."""
        return cls(layout.name, layout.version, layout.columns)


class DynamicsContract(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How the vehicle moved in training; ``None`` where training knew no such thing."""

    edge_m: float
    """Edge of the training maps: the unit of every length the actor sees."""
    edge_low_m: float
    """Smallest map edge on which it may fly."""
    edge_high_m: float
    """Largest map edge on which it may fly."""
    step_s: float | None = None
    """Time between two decisions in training. ``None`` for the paper's kinematic point: it has
    no clock, only ``rho_max`` per step."""
    v_max_mps: float | None = None
    """Largest speed seen in training; a faster vehicle is refused. ``None``: kinematic point."""
    velocity_lag_s: tuple[float, float] | None = None
    """Least and largest time constant of the velocity response seen in training."""


class MapContract(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The one map an actor has learnt by heart."""

    name: str
    content_hash: str


class SeenContract(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What training has shown the actor; flight goes slower where it leaves it."""

    observations: int
    """From so many,"""
    tail: float
    """of which this share lies below, and this share above each range."""
    columns: tuple[Range, ...]
    """Of each column of the layout."""
    measures: dict[str, Range]
    """Of what can be read off an observation, by name (``companion.policy.measures``)."""

    def __post_init__(self) -> None:
        """Refuse ranges that are none.

        Raises:
            ValueError: If a range does not ascend; msgspec turns it into a ``ValidationError``.
        """
        for low, high in (*self.columns, *self.measures.values()):
            if not low <= high:
                raise ValueError(f"range {low} to {high} does not ascend")

    @classmethod
    def of(cls, layout: Layout, observations: Float32Array) -> "SeenContract":
        """Return the ranges of observations ``(K, columns)``, ``K`` at least 1."""
        shares = (_SEEN_TAIL, 1.0 - _SEEN_TAIL)
        low, high = np.quantile(observations, shares, axis=0).tolist()
        ranges = {
            name: tuple(np.quantile(values, shares).tolist())
            for name, values in measures(layout, observations).items()
        }
        return cls(len(observations), _SEEN_TAIL, tuple(zip(low, high, strict=True)), ranges)


class EvaluationRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One evaluation on held-out cases, with the command that repeats it."""

    map_name: str
    episodes: int
    seed: int
    completion_rate: float
    completion_rate_low: float
    """Lower end of the 95 % Wilson interval."""
    completion_rate_high: float
    completion_2m: float
    completion_1m: float
    collision_rate: float
    timeout_rate: float
    straight_completion_rate: float
    """Flying straight at the target, on the same cases: how hard they are."""
    command: str


class Contract(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Everything flight must know of an actor before it trusts it."""

    observation: ObservationContract
    action: ActionScaling
    dynamics: DynamicsContract
    map: MapContract | None
    """``None``: free of maps, the actor has learnt no obstacles by heart."""
    avoids_obstacles: bool
    """Whether obstacles were part of its training; else only the shield keeps it clear."""
    preset: str
    stage: str
    seed: int
    git_revision: str
    command: str
    """The command that made it."""
    evaluation: tuple[EvaluationRecord, ...] = ()
    seen: SeenContract | None = None
    """``None``: of before it was noted, or brought along; nothing can be said of it then."""
    contract_version: int = CONTRACT_VERSION

    @property
    def layout(self) -> Layout:
        """Return the observation layout; ``check_layout`` has vouched for it."""
        return LAYOUTS[self.observation.layout]


class _VersionOnly(msgspec.Struct):
    contract_version: Any = None


def encode_contract(contract: Contract) -> str:
    """Return the JSON that goes into the file."""
    return msgspec.json.encode(contract).decode()


def decode_contract(text: str, *, file: str) -> Contract:
    """Return the contract in ``text``.

    Args:
        text: The JSON of the file's metadata.
        file: Name of the file, for the error.

    Raises:
        ActorError: If the contract is newer than this code, has a wrong field, or names a
            layout that is unknown or has changed.
    """
    try:
        version = msgspec.json.decode(text, type=_VersionOnly).contract_version
        if isinstance(version, int) and version > CONTRACT_VERSION:
            raise ActorError(
                f"actor {file}: contract version {version} is newer than {CONTRACT_VERSION}, "
                f"the newest known here: update mavlink-companion"
            )
        contract = msgspec.json.decode(text, type=Contract)
    except msgspec.DecodeError as error:
        raise ActorError(f"actor {file}: contract is wrong: {error}") from error
    if not 1 <= contract.contract_version <= CONTRACT_VERSION:
        raise ActorError(f"actor {file}: contract version {version} never existed")
    _check_layout(contract.observation, file=file)
    seen, columns = contract.seen, contract.layout.columns
    if seen is not None and len(seen.columns) != len(columns):
        raise ActorError(
            f"actor {file}: contract is wrong: {len(seen.columns)} ranges seen in training, "
            f"{len(columns)} columns"
        )
    return contract


def _check_layout(observation: ObservationContract, *, file: str) -> None:
    layout = LAYOUTS.get(observation.layout)
    if layout is None:
        raise ActorError(
            f"actor {file}: unknown observation layout {observation.layout!r}, "
            f"known are {', '.join(LAYOUTS)}"
        )
    if observation.version != layout.version:
        raise ActorError(
            f"actor {file}: layout {layout.name} version {observation.version}, "
            f"but this software builds version {layout.version}: export the actor again"
        )
    if observation.columns != layout.columns:
        differing = [
            f"{mine!r} instead of {ours!r}"
            for mine, ours in zip(observation.columns, layout.columns, strict=False)
            if mine != ours
        ]
        reason = (
            differing[0]
            if differing
            else f"{len(observation.columns)} instead of {len(layout.columns)}"
        )
        raise ActorError(f"actor {file}: columns of layout {layout.name} differ: {reason}")
