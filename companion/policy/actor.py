"""An actor in an ONNX file: loaded with suspicion, then run on one thread.

ONNX, because loading it runs no code, other tools open it and policies trained elsewhere can be
brought along: one float32 input ``(N, columns)``, one float32 output ``(N, 3)`` in [-1, 1], and
the contract as JSON in ``metadata_props``.
"""

import hashlib
import re
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np
import onnxruntime

from companion.arrays import Float32Array
from companion.errors import ActorError
from companion.policy.contract import CONTRACT_KEY, Contract, SeenContract, decode_contract
from companion.policy.measures import MEASURES
from companion.policy.observation import Layout, describe_layout
from companion.world.maps import Map

ACTION_SIZE = 3
_PROBES = 256
_TOLERANCE = 1e-6
_EDGE_TOLERANCE_M = 1e-6


class Actor:
    """A trained policy whose file has been checked."""

    def __init__(
        self,
        session: onnxruntime.InferenceSession,
        contract: Contract,
        *,
        name: str,
        asked_as: str,
        sha256: str,
    ) -> None:
        self.contract = contract
        self.name = name
        self.asked_as = asked_as
        """What ``--actor`` takes for it: a file or the name of a bundled one."""
        self.sha256 = sha256
        self._session = session
        self._input = session.get_inputs()[0].name
        self._output = [session.get_outputs()[0].name]

    @classmethod
    def load(cls, path_or_name: str | Path) -> "Actor":
        """Read and check an actor.

        Args:
            path_or_name: A file, or the name of a bundled actor.

        Raises:
            ActorError: If the file is missing, is no ONNX model or a truncated one, carries no
                contract or one that does not fit this software, or answers a probe with
                anything but numbers in [-1, 1].
        """
        path = _find(path_or_name)
        try:
            content = path.read_bytes()
        except OSError as error:
            raise ActorError(f"actor {path}: cannot be read: {error.strerror}") from error
        session = _open(content, file=path.name)
        metadata = session.get_modelmeta().custom_metadata_map
        if CONTRACT_KEY not in metadata:
            raise ActorError(
                f"actor {path.name}: carries no contract ({CONTRACT_KEY} in metadata_props): "
                f"export it with `training export`"
            )
        contract = decode_contract(metadata[CONTRACT_KEY], file=path.name)
        _check_shapes(session, contract.layout, file=path.name)
        actor = cls(
            session,
            contract,
            name=path.stem,
            asked_as=str(path_or_name),
            sha256=hashlib.sha256(content).hexdigest(),
        )
        _probe(actor, file=path.name)
        return actor

    def act(self, observation: Float32Array) -> Float32Array:
        """Return the action in [-1, 1], shape ``(..., 3)``.

        Args:
            observation: Shape ``(..., columns)``, float32, of the contract's layout.
        """
        rows = observation.reshape(-1, observation.shape[-1])
        action: Float32Array = self._session.run(self._output, {self._input: rows})[0]
        return np.clip(action, -1.0, 1.0).reshape(*observation.shape[:-1], ACTION_SIZE)

    @property
    def flies_on_any_edge(self) -> bool:
        """Return whether the map's edge is in nothing that it sees: its units are its own."""
        return self.contract.map is None and self.contract.layout.sees_obstacles

    def check_fits(self, city: Map, v_max_mps: float) -> None:
        """Refuse a map or a speed the actor was not made for.

        Args:
            city: The map it is to fly on.
            v_max_mps: The speed limit it is to fly with.

        Raises:
            ActorError: If the actor is bound to another map, the edge lies outside what its
                contract allows, or ``v_max_mps`` is above the largest speed of its training.
        """
        bound_to, dynamics = self.contract.map, self.contract.dynamics
        if bound_to is not None and bound_to.content_hash != city.content_hash:
            raise ActorError(
                f"actor {self.name} is bound to map {bound_to.name} "
                f"({bound_to.content_hash[:12]}), not to {city.name} ({city.content_hash[:12]}): "
                f"train on this map or choose an actor free of maps"
            )
        low_m, high_m = dynamics.edge_low_m, dynamics.edge_high_m
        fits = low_m - _EDGE_TOLERANCE_M <= city.edge_m <= high_m + _EDGE_TOLERANCE_M
        if not fits and not self.flies_on_any_edge:
            raise ActorError(
                f"actor {self.name} flies on map edges of {low_m:g} to {high_m:g} m, "
                f"map {city.name} has {city.edge_m:g} m"
            )
        if dynamics.v_max_mps is not None and v_max_mps > dynamics.v_max_mps:
            raise ActorError(
                f"actor {self.name} was trained for up to {dynamics.v_max_mps:g} m/s, "
                f"asked for {v_max_mps:g} m/s: lower --v-max"
            )


def actors_folder() -> Path:
    """Return the folder of the bundled actors."""
    return Path(str(files("companion"))) / "actors"


def bundled_actors() -> list[str]:
    """Return the names of the actors that come with the package."""
    return sorted(path.stem for path in actors_folder().glob("*.onnx"))


def describe_actor(actor: Actor) -> str:
    """Return the contract for people, at 80 columns where names allow."""
    contract, dynamics, scaling = actor.contract, actor.contract.dynamics, actor.contract.action
    if contract.map is None:
        place = "any (free of maps)"
    else:
        place = f"{contract.map.name} only ({contract.map.content_hash[:12]})"
    if not contract.avoids_obstacles:
        place += "; has learnt no obstacles, only the shield keeps it clear"
    step = "kinematic point, no clock" if dynamics.step_s is None else f"{dynamics.step_s:g} s"
    v_max = "any" if dynamics.v_max_mps is None else f"up to {dynamics.v_max_mps:g} m/s"
    lag = dynamics.velocity_lag_s
    lag_text = "none" if lag is None else f"{lag[0]:g} to {lag[1]:g} s"
    edges = f"{dynamics.edge_low_m:g} to {dynamics.edge_high_m:g} m"
    if actor.flies_on_any_edge:
        edges = "any: sees what is near"
    lines = [
        f"actor     {actor.name}",
        f"sha256    {actor.sha256}",
        f"map       {place}",
        f"edge      {dynamics.edge_m:g} m, flies on {edges}",
        f"step      {step}; speed {v_max}; velocity lag {lag_text}",
        f"action    rho {scaling.rho_min:g} to {scaling.rho_max:g} of the edge, "
        f"phi {scaling.polar_low_rad:.4g} to {scaling.polar_high_rad:.4g} rad"
        + (" around the target," if scaling.polar_reference == "target" else ","),
        f"          psi {scaling.azimuth_low_rad:.4g} to {scaling.azimuth_high_rad:.4g} rad, "
        + ("from map east" if scaling.azimuth_reference == "absolute" else "from the target"),
        f"trained   preset {contract.preset}, stage {contract.stage}, seed {contract.seed}, "
        f"revision {contract.git_revision[:12]}",
        f"          {contract.command}",
    ]
    for record in contract.evaluation:
        lines += [
            f"evaluated {record.map_name}: {100 * record.completion_rate:.1f} % of "
            f"{record.episodes} (95 %: {100 * record.completion_rate_low:.1f} to "
            f"{100 * record.completion_rate_high:.1f}), seed {record.seed}",
            f"          within 2 m {100 * record.completion_2m:.1f} %, "
            f"1 m {100 * record.completion_1m:.1f} %; "
            f"collided {100 * record.collision_rate:.1f} %, "
            f"timed out {100 * record.timeout_rate:.1f} %",
            f"          flying straight: {100 * record.straight_completion_rate:.1f} %",
            f"          {_evaluation_command(record.command, actor)}",
        ]
    if contract.seen is None:
        return "\n".join([*lines, describe_layout(contract.layout)])
    return "\n".join(
        [
            *lines,
            *_describe_seen(contract.seen),
            describe_layout(contract.layout, contract.seen.columns),
        ]
    )


def _evaluation_command(command: str, actor: Actor) -> str:
    """Return the command for the actor's file of today: it may have been called otherwise."""
    return re.sub(r"--actor +[^ ]+", lambda _: f"--actor {actor.asked_as}", command)


def _describe_seen(seen: SeenContract) -> list[str]:
    ranges = [
        f"{name} {low:.3g} to {high:.3g} {MEASURES.get(name, '')}".rstrip()
        for name, (low, high) in seen.measures.items()
    ]
    share = 100.0 * (1.0 - 2.0 * seen.tail)
    whole = f"{share:g} % of {seen.observations} observations of training"
    return [f"seen      {', '.join(ranges)};" if ranges else "seen", f"          {whole}"]


def _find(path_or_name: str | Path) -> Path:
    path = Path(path_or_name)
    if path.suffix == "" and path.parent == Path() and not path.exists():
        bundled = actors_folder() / f"{path.name}.onnx"
        if not bundled.is_file():
            names = ", ".join(bundled_actors()) or "none"
            raise ActorError(f"no actor {str(path_or_name)!r}: bundled are {names}")
        return bundled
    return path


def _open(content: bytes, *, file: str) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.log_severity_level = 4  # what is wrong comes as an exception, once
    try:
        return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's own errors share no base of their own
        reason = str(error).strip().splitlines()[0] if str(error).strip() else "no reason given"
        raise ActorError(
            f"actor {file}: not an ONNX model, or a truncated one: {reason}"
        ) from error


def _check_shapes(session: onnxruntime.InferenceSession, layout: Layout, *, file: str) -> None:
    inputs, outputs = session.get_inputs(), session.get_outputs()
    _check_tensor(inputs, len(layout.fields), "input", file=file)
    _check_tensor(outputs, ACTION_SIZE, "output", file=file)


def _check_tensor(
    tensors: Sequence[onnxruntime.NodeArg], width: int, role: str, *, file: str
) -> None:
    if len(tensors) != 1:
        raise ActorError(f"actor {file}: needs exactly one {role}, has {len(tensors)}")
    shape, kind = list(tensors[0].shape), tensors[0].type
    if kind != "tensor(float)":
        raise ActorError(f"actor {file}: {role} must be tensor(float), is {kind}")
    if len(shape) != 2 or shape[1] != width or isinstance(shape[0], int):
        raise ActorError(
            f"actor {file}: {role} must have shape (N, {width}) with N free, has {shape}"
        )


def _probe(actor: Actor, *, file: str) -> None:
    """Refuse an actor that answers legal observations with anything but legal actions."""
    low, high = actor.contract.layout.bounds()
    inside = np.random.default_rng(0).uniform(low, high, (_PROBES, len(low)))
    observation = np.concatenate((inside, [low], [high])).astype(np.float32)
    try:
        action = actor._session.run(actor._output, {actor._input: observation})[0]
    except Exception as error:  # onnxruntime's own errors share no base of their own
        reason = str(error).strip().splitlines()[0]
        raise ActorError(f"actor {file}: cannot be run: {reason}") from error
    if action.shape != (len(observation), ACTION_SIZE):
        raise ActorError(f"actor {file}: answers with shape {action.shape}")
    if not np.isfinite(action).all():
        raise ActorError(f"actor {file}: answers a probe with numbers that are not finite")
    if np.abs(action).max() > 1.0 + _TOLERANCE:
        raise ActorError(
            f"actor {file}: answers a probe with {np.abs(action).max():.3g}, outside [-1, 1]"
        )
