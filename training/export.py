"""From a torch actor to the ONNX file that flies, contract attached, agreement checked."""

import shlex
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper

from companion.errors import ActorError
from companion.policy.actor import Actor
from companion.policy.contract import CONTRACT_KEY, Contract, encode_contract
from training.networks import ACTION_SIZE, ActorNetwork

OPSET = 17
IR_VERSION = 8
"""Old enough for every onnxruntime that the package allows, and then some."""
AGREEMENT = 1e-5
"""Largest difference allowed between torch and onnxruntime."""
_CASES = 2_000


def export_actor(network: ActorNetwork, contract: Contract, path: Path) -> Actor:
    """Write ``path``, load it the way flight does and compare it with torch.

    Args:
        network: The actor.
        contract: What it was made for.
        path: Where to; replaced in one move, and only if the file passes.

    Returns:
        The actor as loaded from the file.

    Raises:
        ActorError: If the file does not pass its own checks or differs from torch by more than
            ``AGREEMENT`` over random observations.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f"{path.stem}.unfinished.onnx")
    unfinished.write_bytes(build_model(network, contract).SerializeToString())
    try:
        difference = largest_difference(network, Actor.load(unfinished))
        if not difference <= AGREEMENT:
            raise ActorError(f"{path}: torch and ONNX differ by {difference:.1e}")
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)
    return Actor.load(path)


def build_model(network: ActorNetwork, contract: Contract) -> onnx.ModelProto:
    """Return the actor as ONNX: Gemm and Relu a layer, Gemm and Tanh at the end."""
    linears = [*network.layers, network.head]
    nodes, weights, value = [], [], "observation"
    for index, linear in enumerate(linears):
        last = index == len(linears) - 1
        for name in ("weight", "bias"):
            array = getattr(linear, name).detach().numpy()
            weights.append(numpy_helper.from_array(array, f"{name}_{index}"))
        inputs = [value, f"weight_{index}", f"bias_{index}"]
        value = "action" if last else f"hidden_{index}"
        nodes.append(helper.make_node("Gemm", inputs, [f"linear_{index}"], transB=1))
        nodes.append(helper.make_node("Tanh" if last else "Relu", [f"linear_{index}"], [value]))
    columns = len(contract.observation.columns)
    graph = helper.make_graph(
        nodes,
        "actor",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["N", columns])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["N", ACTION_SIZE])],
        initializer=weights,
    )
    model = helper.make_model(
        graph,
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="mavlink-companion",
    )
    helper.set_model_props(model, {CONTRACT_KEY: encode_contract(contract)})
    onnx.checker.check_model(model)
    return model


@torch.inference_mode()
def largest_difference(network: ActorNetwork, actor: Actor) -> float:
    """Return the largest difference of any action column over random legal observations."""
    low, high = actor.contract.layout.bounds()
    observation = np.random.default_rng(0).uniform(low, high, (_CASES, len(low)))
    rows = observation.astype(np.float32)
    expected = network(torch.from_numpy(rows)).numpy()
    return float(np.abs(expected - actor.act(rows)).max())


def git_revision() -> str:
    """Return the checkout's revision, ``-dirty`` if code that makes actors differs from it.

    Returns ``unknown`` outside a checkout.
    """
    root = Path(__file__).parents[1]
    sources = ["companion/policy", "companion/world", "sim", "training", "maps"]
    sources += [":!sim/mock", ":!training/report"]
    try:
        head = _git(root, "rev-parse", "--short=12", "HEAD")
        changes = _git(root, "status", "--porcelain", "--untracked-files=no", "--", *sources)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return f"{head}-dirty" if changes else head


def _git(folder: Path, *arguments: str) -> str:
    command = ["git", "-C", str(folder), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def command_line(program: str, arguments: Sequence[str]) -> str:
    """Return the command as it would be typed again."""
    return shlex.join([program, *arguments])
