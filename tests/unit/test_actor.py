"""Actor files: what is refused and how it is said, what fits, what is answered."""

import dataclasses
import json

import msgspec
import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from companion.errors import ActorError
from companion.policy.action import TARGET_SCALING
from companion.policy.actor import Actor, bundled_actors, describe_actor
from companion.policy.contract import (
    CONTRACT_KEY,
    CONTRACT_VERSION,
    Contract,
    DynamicsContract,
    EvaluationRecord,
    MapContract,
    ObservationContract,
    SeenContract,
    encode_contract,
)
from companion.policy.observation import RAYS, RELATIVE
from companion.world.maps import load_map

FREE = load_map("free")
NUM_COLUMNS = len(RELATIVE.fields)
SEEN = SeenContract(
    observations=1000,
    tail=0.001,
    columns=((-0.25, 0.75),) * NUM_COLUMNS,
    measures={"speed": (0.0, 6.125), "gap": (6.25, 100.0)},
)


def make_contract(**changes):
    contract = Contract(
        observation=ObservationContract.of(RELATIVE),
        action=TARGET_SCALING,
        dynamics=DynamicsContract(edge_m=100.0, edge_low_m=50.0, edge_high_m=400.0),
        map=None,
        avoids_obstacles=False,
        preset="paper",
        stage="free",
        seed=7,
        git_revision="0123456789abcdef",
        command="training train --stage free",
    )
    return msgspec.structs.replace(contract, **changes)


def make_file(path, *, metadata=None, columns=NUM_COLUMNS, out=3, rows="N", gain=0.1, head="Tanh"):
    """Write an actor of one layer; ``metadata`` is a contract, text, or None for none."""
    weight = np.full((out, columns), gain, dtype=np.float32)
    nodes = [
        helper.make_node("Gemm", ["observation", "weight"], ["linear"], transB=1),
        helper.make_node(head, ["linear"], ["action"]),
    ]
    graph = helper.make_graph(
        nodes,
        "actor",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, [rows, columns])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, [rows, out])],
        initializer=[numpy_helper.from_array(weight, "weight")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    if metadata is not None:
        text = metadata if isinstance(metadata, str) else encode_contract(metadata)
        helper.set_model_props(model, {CONTRACT_KEY: text})
    onnx.save(model, path)
    return path


def contract_json(**changes):
    return json.dumps({**msgspec.to_builtins(make_contract()), **changes})


@pytest.fixture
def file(tmp_path):
    return make_file(tmp_path / "good.onnx", metadata=make_contract())


def refused(path):
    with pytest.raises(ActorError) as caught:
        Actor.load(path)
    message = str(caught.value)
    assert "\n" not in message
    assert path.name in message or str(path) in message
    return message


def test_a_good_file_answers_single_rows_and_batches(file):
    actor = Actor.load(file)
    assert actor.name == "good"
    assert len(actor.sha256) == 64
    assert actor.contract == make_contract()
    rows = np.random.default_rng(0).uniform(-1, 1, (2, 5, NUM_COLUMNS)).astype(np.float32)
    action = actor.act(rows)
    assert action.shape == (2, 5, 3)
    assert action.dtype == np.float32
    np.testing.assert_allclose(actor.act(rows[1, 2]), action[1, 2], atol=1e-6)
    np.testing.assert_allclose(action[..., 0], np.tanh(0.1 * rows.sum(axis=-1)), atol=1e-6)


def test_a_missing_file_is_refused(tmp_path):
    assert "No such file" in refused(tmp_path / "none.onnx")


def test_an_unknown_name_lists_the_bundled_ones():
    with pytest.raises(ActorError, match="no actor 'nobody': bundled are"):
        Actor.load("nobody")


@pytest.mark.parametrize("name", bundled_actors())
def test_every_bundled_actor_loads(name):
    assert Actor.load(name).name == name


def test_a_file_of_another_kind_is_refused(tmp_path):
    path = tmp_path / "letter.onnx"
    path.write_text("Dear vehicle, fly north.")
    assert "not an ONNX model" in refused(path)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9])
def test_a_truncated_file_is_refused(file, share):
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])
    refused(file)


def test_a_file_without_contract_is_refused(tmp_path):
    assert "carries no contract" in refused(make_file(tmp_path / "bare.onnx"))


@pytest.mark.parametrize(
    ("metadata", "reason"),
    [
        pytest.param("{", "contract is wrong", id="not JSON"),
        pytest.param("[]", "contract is wrong", id="not an object"),
        pytest.param("{}", "contract is wrong", id="empty"),
        pytest.param(
            contract_json(contract_version=CONTRACT_VERSION + 1), "newer than", id="newer"
        ),
        pytest.param(
            json.dumps({"contract_version": 99, "shape": "unheard of"}), "newer than", id="future"
        ),
        pytest.param(contract_json(contract_version=0), "never existed", id="version 0"),
        pytest.param(contract_json(surprise=1), "surprise", id="unknown field"),
        pytest.param(contract_json(seed="seven"), r"\$.seed", id="wrong type"),
        pytest.param(
            contract_json(action={"rho_min": 0.3, "rho_max": 0.2}), "rho_min", id="bad scaling"
        ),
        pytest.param(
            contract_json(observation={"layout": "lidar", "version": 1, "columns": []}),
            "unknown observation layout 'lidar', known are paper, relative",
            id="unknown layout",
        ),
        pytest.param(
            contract_json(
                observation={"layout": "relative", "version": 99, "columns": RELATIVE.columns}
            ),
            "version 99",
            id="layout version",
        ),
        pytest.param(
            contract_json(
                observation={
                    "layout": "relative",
                    "version": RELATIVE.version,
                    "columns": ["position_west", *RELATIVE.columns[1:]],
                }
            ),
            "'position_west' instead of 'position_east'",
            id="column renamed",
        ),
        pytest.param(
            contract_json(
                observation={
                    "layout": "relative",
                    "version": RELATIVE.version,
                    "columns": RELATIVE.columns[:-1],
                }
            ),
            f"{NUM_COLUMNS - 1} instead of {NUM_COLUMNS}",
            id="column missing",
        ),
        pytest.param(
            contract_json(seen={**msgspec.to_builtins(SEEN), "columns": [[0.0, 1.0]]}),
            f"1 ranges seen in training, {NUM_COLUMNS} columns",
            id="ranges missing",
        ),
        pytest.param(
            contract_json(seen={**msgspec.to_builtins(SEEN), "measures": {"gap": [9.0, 6.0]}}),
            "range 9.0 to 6.0 does not ascend",
            id="range upside down",
        ),
    ],
)
def test_contracts_that_cannot_be_honoured_are_refused(tmp_path, metadata, reason):
    message = refused(make_file(tmp_path / "odd.onnx", metadata=metadata))
    assert reason.replace("\\", "") in message


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        pytest.param({"columns": 4}, f"input must have shape (N, {NUM_COLUMNS})", id="input"),
        pytest.param({"out": 4}, "output must have shape (N, 3)", id="output"),
        pytest.param({"rows": 1}, "with N free", id="fixed batch"),
        pytest.param({"gain": float("nan")}, "not finite", id="NaN weights"),
        pytest.param({"head": "Identity", "gain": 5.0}, "outside [-1, 1]", id="unbounded"),
    ],
)
def test_graphs_that_do_not_answer_with_an_action_are_refused(tmp_path, changes, reason):
    path = make_file(tmp_path / "odd.onnx", metadata=make_contract(), **changes)
    assert reason in refused(path)


def test_an_actor_free_of_maps_fits_edges_within_its_range(tmp_path):
    actor = Actor.load(make_file(tmp_path / "a.onnx", metadata=make_contract()))
    actor.check_fits(FREE, 5.0)
    for edge_m in (50.0, 400.0):
        actor.check_fits(dataclasses.replace(FREE, edge_m=edge_m), 5.0)
    for edge_m in (49.9, 400.1):
        with pytest.raises(ActorError, match="map edges of 50 to 400 m"):
            actor.check_fits(dataclasses.replace(FREE, edge_m=edge_m), 5.0)


def test_an_actor_that_sees_obstacles_flies_on_any_edge(tmp_path):
    contract = make_contract(observation=ObservationContract.of(RAYS))
    path = make_file(tmp_path / "a.onnx", metadata=contract, columns=len(RAYS.fields))
    actor = Actor.load(path)
    for edge_m in (10.0, 10_000.0):
        actor.check_fits(dataclasses.replace(FREE, edge_m=edge_m), 5.0)
    assert "flies on any" in describe_actor(actor)
    bound = make_file(
        tmp_path / "b.onnx",
        metadata=msgspec.structs.replace(
            contract, map=MapContract(FREE.name, FREE.content_hash), avoids_obstacles=True
        ),
        columns=len(RAYS.fields),
    )
    with pytest.raises(ActorError, match="map edges of 50 to 400 m"):
        Actor.load(bound).check_fits(dataclasses.replace(FREE, edge_m=401.0), 5.0)


def test_a_bound_actor_refuses_every_other_map_and_names_both(tmp_path):
    bound = make_contract(map=MapContract("yard", "ab" * 32))
    actor = Actor.load(make_file(tmp_path / "a.onnx", metadata=bound))
    with pytest.raises(ActorError) as caught:
        actor.check_fits(FREE, 5.0)
    assert "bound to map yard (abababababab)" in str(caught.value)
    assert f"free ({FREE.content_hash[:12]})" in str(caught.value)
    actor.check_fits(dataclasses.replace(FREE, content_hash="ab" * 32), 5.0)


def test_a_speed_above_training_is_refused(tmp_path):
    dynamics = DynamicsContract(100.0, 100.0, 100.0, step_s=0.5, v_max_mps=8.0)
    path = make_file(tmp_path / "a.onnx", metadata=make_contract(dynamics=dynamics))
    actor = Actor.load(path)
    actor.check_fits(FREE, 8.0)
    with pytest.raises(ActorError, match=r"trained for up to 8 m/s, asked for 8\.1 m/s"):
        actor.check_fits(FREE, 8.1)


def test_a_contract_of_before_ranges_were_noted_is_still_good(tmp_path):
    old = json.loads(contract_json(contract_version=1))
    del old["seen"]
    actor = Actor.load(make_file(tmp_path / "a.onnx", metadata=json.dumps(old)))
    assert actor.contract.seen is None
    assert "seen" not in describe_actor(actor)


def test_what_training_has_seen_is_kept_and_shown(tmp_path):
    path = make_file(tmp_path / "a.onnx", metadata=make_contract(seen=SEEN))
    actor = Actor.load(path)
    assert actor.contract.seen == SEEN
    text = describe_actor(actor)
    assert "speed 0 to 6.12 m/s, gap 6.25 to 100 m;" in text
    assert "99.8 % of 1000 observations of training" in text
    assert text.count("seen -0.25 ..  0.75") == NUM_COLUMNS


def test_the_description_names_what_matters(tmp_path):
    record = EvaluationRecord(
        map_name="yard",
        episodes=1000,
        seed=3,
        completion_rate=0.875,
        completion_rate_low=0.85,
        completion_rate_high=0.9,
        completion_2m=0.5,
        completion_1m=0.25,
        collision_rate=0.1,
        timeout_rate=0.025,
        straight_completion_rate=0.47,
        command="training evaluate --actor a --map yard",
    )
    contract = make_contract(map=MapContract("yard", "ab" * 32), evaluation=(record,))
    path = make_file(tmp_path / "b.onnx", metadata=contract)
    text = describe_actor(Actor.load(path))
    assert f"training evaluate --actor {path} --map yard" in text
    for word in ("yard only (abababababab)", "87.5 %", "47.0 %", "training train", "relative"):
        assert word in text
