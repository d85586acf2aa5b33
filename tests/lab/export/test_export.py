"""Exported files, their contract, and the command."""

import json
import math
import sys

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import step_mdp
from typer.testing import CliRunner

import bsk_torch
from bsk_torch.cli import app
from bsk_torch.env.rollout import decide
from bsk_torch.lab.export import export_policy
from bsk_torch.lab.export.contract import KEY, UNIT, described, weights_hash
from bsk_torch.lab.export.shield import conditions
from bsk_torch.rl.policies.files import build_policy, read_card
from bsk_torch.rl.policies.shared_policy import member_views
from bsk_torch.rl.rules.shield import RULES, shielded
from tests.lab.export.conftest import KINDS, compiled, situations
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled


@pytest.mark.parametrize("kind", KINDS)
def test_graphs_decide_as_the_package_does_bit_for_bit(exported, kind):
    policy = exported(kind)
    graphs = policy.graphs()
    assert set(graphs) == set(KINDS[kind][2])
    for group, graph in graphs.items():
        inputs = situations(graph, policy.contracts[group])
        package = decide(policy.policies()[group], TensorDict(dict(zip(graph.paths, inputs, strict=True)), [200]))
        with torch.no_grad():
            outputs = dict(zip(graph.outputs, graph(*inputs), strict=True))
        for name, value in outputs.items():
            assert torch.equal(value, package[tuple(name.split("."))]), (group, name)


@pytest.mark.parametrize("kind", KINDS)
def test_files_of_onnx_and_torch_decide_alike_and_hold_the_contract(exported, kind, tmp_path):
    onnx, onnxruntime = (pytest.importorskip(name) for name in ("onnx", "onnxruntime"))
    policy = exported(kind)
    contracts = export_policy(policy.file, tmp_path, ["onnx", "torch"])
    graphs = policy.graphs()
    assert set(graphs) == set(KINDS[kind][2])
    for group, graph in graphs.items():
        folder = tmp_path / ("" if len(contracts) == 1 else group)
        content, contract = (folder / "policy.onnx").read_bytes(), contracts[group]
        assert {node.domain for node in onnx.load_from_string(content).graph.node} <= {"", "ai.onnx"}
        session, extra = onnxruntime.InferenceSession(content), {KEY: ""}
        module = torch.export.load(folder / "policy.pt2", extra_files=extra).module()
        assert contract == json.loads((folder / "contract.json").read_text())
        assert contract == json.loads(extra[KEY])
        assert contract == json.loads(session.get_modelmeta().custom_metadata_map[KEY])
        assert [part.name for part in session.get_inputs()] == [row["name"] for row in contract["inputs"]]
        assert {part.shape[0] for part in (*session.get_inputs(), *session.get_outputs())} == {"N"}
        for n in (1, 200):
            inputs = situations(graph, contract, n)
            with torch.no_grad():
                expected = graph(*inputs)
            of_torch = module(*inputs)
            of_onnx = session.run(list(graph.outputs), {k: x.numpy() for k, x in zip(graph.names, inputs, strict=True)})
            for values in (of_torch, of_onnx):
                for value, wanted in zip(map(torch.as_tensor, values), expected, strict=True):
                    assert value.dtype == wanted.dtype
                    assert torch.allclose(value.double(), wanted.double(), rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("kind", ["mlp", "gru", "real", "attention"])
@pytest.mark.parametrize("file", ["policy.onnx", "policy.pt2"])
def test_any_command_takes_exported_files_again(exported, kind, file, tmp_path):
    pytest.importorskip("onnxruntime")
    policy = exported(kind)
    export_policy(policy.file, tmp_path, [{".onnx": "onnx", ".pt2": "torch"}[file[6:]]])
    env = bsk_torch.make(policy.preset, num_envs=8, **policy.options)
    td = env.reset()
    loaded, package = bsk_torch.load_policy(tmp_path / file, env), build_policy(read_card(policy.file))
    for _ in range(3):
        decided, wanted = decide(loaded, td.clone()), decide(package, td)
        for key in ("action", *([("next", "memory")] if kind == "gru" else [])):
            assert torch.allclose(decided[key].double(), wanted[key].double(), atol=1e-5)
        td = step_mdp(env.step(decided), keep_other=False)


def test_the_contract_tells_what_each_number_is(exported):
    contract = exported("attention").contracts["agents"]
    quantities = {row["name"]: row for row in contract["observation"]}
    position = quantities["target.rows.r_LB_H_normd"]
    assert (position["unit"], position["divisor"], position["rows"], position["row_stride"]) == ("m", 800000.0, 32, 8)
    assert position["frame"].startswith("H")
    assert quantities["sat_props.v_BN_P_normd"]["unit"] == "m/s"
    vectors = [torch.tensor(contract["record"]["inputs"][row["name"]]) for row in contract["inputs"][:-1]]
    whole = torch.cat([part.reshape(len(part), -1) for part in vectors], 1)
    env = bsk_torch.make("AEOSPower-v1", num_envs=1, n_targets=300)
    assert whole.shape[1] == len(env.satellite.observation_description) + 32  # the mask of rows
    for row in contract["observation"]:
        places = [row["vector"] + k * row["row_stride"] + j for k in range(row["rows"]) for j in range(row["width"])]
        assert row["recorded"] == pytest.approx([float(whole[:, places].min()), float(whole[:, places].max())])
    assert [row["seconds"] for row in contract["actions"][:4]] == [60.0, 60.0, 60.0, None]
    assert "shield of the environment" in contract["not_included"][0]
    assert contract["decisions"]["recorded_seconds"][0] > 0.0
    assert contract["environment"]["options"] == KINDS["attention"][1]


@pytest.mark.parametrize(
    ("preset", "name", "unit", "divisor"),
    [
        ("Services-v1", "rso_targets.rows.target_elevation_angle", "degrees", 90.0),
        ("Services-v1", "rso_targets.rows.rel_vel_vector_v_BR_H", "m/s", 16000.0),
        ("Services-v1", "eclipse", None, 5700.0),
        ("RSOInspection-v1", "rel_props.r_DC_Hc_normd", "m", 500.0),
        ("RSOInspection-v1", "rel_props.h_Hs_normd", "m^2/s", 5e10),
        ("RSOInspection-v1", "sat_props.dv_available_normd", "m/s", 10.0),
        ("NadirScan-v1", "sat_props.solar_pointing_error_normd", "rad", math.pi),
        ("NadirScan-v1", "ground_station.ground_station_0.opportunity_open_normd", "s", 5700.0),
    ],
)
def test_units_come_from_the_documentation_of_observations(preset, name, unit, divisor):
    env = bsk_torch.make(preset, num_envs=1)
    view = next(view for view in member_views(env).values() if len(view.satellite.observation_description) > 1)
    meaning, divided = described(view.satellite, name)
    assert divided == divisor
    assert (UNIT.search(meaning) or [None, None])[1] == unit


def test_the_hash_is_of_the_weights(exported):
    policy = exported("mlp")
    card = read_card(policy.file)
    assert policy.contracts["agents"]["weights_sha256"] == weights_hash(card)
    card["actor"] = {name: value + 1e-3 for name, value in card["actor"].items()}
    assert policy.contracts["agents"]["weights_sha256"] != weights_hash(card)


def test_real_actions_have_bounds_and_their_assurance_is_said_to_be_missing(exported):
    contract = exported("real").contracts["agents"]
    assert [row["range"] for row in contract["actions"]] == [[-1.0, 1.0]] * 3
    assert contract["not_included"] == []
    env = bsk_torch.make("CWDocking-v1", num_envs=1, assurance="asif")
    from bsk_torch.lab.export.contract import not_included

    assert "run-time assurance" in not_included(env.satellite, None)[0]


@pytest.mark.parametrize("name", RULES)
def test_a_shield_is_part_of_the_graph_and_of_the_c_code(exported, name, tmp_path):
    kind = {"safe": "mlp", "imager": "attention"}[name]
    policy = exported(kind)
    (contract,) = export_policy(policy.file, tmp_path, ["c"], shield=name).values()
    assert f"shield '{name}'" in contract["included"]
    assert not any("--shield" in text for text in contract["not_included"])
    act, replay = compiled(tmp_path)
    assert replay.startswith("64 of 64") or kind == "attention"
    graph = policy.graphs()["agents"]
    inputs = situations(graph, contract)
    env = bsk_torch.make(policy.preset, num_envs=1, **policy.options)
    rule = shielded(build_policy(read_card(policy.file)), RULES[name], env)
    package = decide(rule, TensorDict(dict(zip(graph.paths, inputs, strict=True)), [200]))
    graph.only = conditions(RULES[name], name, contract["observation"], env.satellite.action_description)
    assert torch.equal(graph(*inputs)[0], package["action"])
    chosen, _ = act(torch.cat([part.reshape(200, -1) for part in inputs[:-1]], 1), inputs[-1], inputs[-1].shape[1])
    apart = package["logits"].gather(1, chosen[:, None]) - package["logits"].gather(1, package["action"][:, None])
    assert float(apart.abs().max()) < 1e-4
    plain = decide(policy.policies()["agents"], TensorDict(dict(zip(graph.paths, inputs, strict=True)), [200]))
    assert 20 < int((plain["action"] != package["action"]).sum()) < 180


def test_what_cannot_be_exported_is_named(exported, tmp_path, monkeypatch):
    file, out = exported("mlp").file, tmp_path / "out"
    relay = exported("groups").file
    (tmp_path / "a.zip").touch()
    rows = [
        refusal(lambda: export_policy("rule", out), ValueError, "'rule'", "a rule", "run folder", "'pretrained'"),
        refusal(lambda: export_policy("plan:rollout", out), ValueError, "'plan:rollout'", "planner"),
        refusal(lambda: export_policy("mine:policy", out), ValueError, "'mine:policy'", "function of Python"),
        refusal(lambda: export_policy("pretrained", out), ValueError, "preset"),
        refusal(lambda: export_policy(tmp_path / "a.zip", out), ValueError, "a.zip", "Stable-Baselines3", "policy file"),
        refusal(lambda: export_policy("nowhere.pt", out), FileNotFoundError, "nowhere.pt"),
        refusal(lambda: export_policy(file, out, ["onxn"]), ValueError, "'onxn'", "'onnx'"),
        refusal(lambda: export_policy(file, out, ["c"], preset="NadirScience-v1"), ValueError, "NadirScience-v1", "n_observed"),
        refusal(lambda: export_policy(file, out, ["c"], shield="imagre"), ValueError, "'imagre'", "'imager'"),
        refusal(lambda: export_policy(file, out, ["c"], shield="os.path:join"), ValueError, "'os.path:join'", "'safe'"),
        refusal(lambda: export_policy(relay, out, ["c"], shield="safe"), ValueError, "'safe'", "wheel_speeds_fraction"),
    ]
    check_refusals(rows)
    monkeypatch.setitem(sys.modules, "onnxscript", None)
    check_refusals(refusal(lambda: export_policy(file, out), ModuleNotFoundError, "onnxscript", "bsk_torch[onnx]"))
    assert not out.exists()


def test_the_command_writes_the_files_and_ends_with_what_they_lack(exported, tmp_path):
    policy = exported("groups")
    run = lambda *arguments: CliRunner().invoke(app, ["export-policy", *map(str, arguments)])
    result = run(policy.file, "--c", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert result.output.strip().splitlines()[-1].startswith("not in the exported files: the computation of action_mask")
    files = {path.relative_to(tmp_path / "out").as_posix() for path in (tmp_path / "out").rglob("*.*")}
    names = ("policy.c", "policy.h", "recorded.h", "replay.c", "contract.json", "contract.md")
    assert files == {f"{group}/{name}" for group in policy.contracts for name in names}
    assert "| unit |" in (tmp_path / "out" / "relay" / "contract.md").read_text()
    for arguments, message in (
        ((policy.file, "--out", tmp_path / "x"), "--onnx, --torch and --c"),
        (("rule", "--c", "--out", tmp_path / "x"), "exports its own networks"),
        ((policy.file, "--c", "--out", tmp_path / "no" / "x"), "there is no folder"),
    ):
        result = run(*arguments)
        assert result.exit_code == 1
        assert message in " ".join(result.output.split())
