"""One loader for policies of all libraries: their actions, and errors before code in files is executed."""

import json
import pickle
import zipfile
from importlib.util import find_spec

import numpy as np
import pytest
import torch
from tensordict import TensorDict

import bsk_torch
from bsk_torch.rl.policies.loading import UntrustedError, read_policy
from bsk_torch.rl.policies.sb3_zip import pickled_parts
from bsk_torch.wrappers.policies import policy_of_one
from tests.support.evil import Evil
from tests.support.outside_policies import (
    ACTIONS,
    MODULE,
    OBSERVED,
    TEAM,
    MaskedNet,
    Net,
    exported,
    onnx_model,
    sb3_env,
    write_experiment,
    write_own,
    write_rllib,
    write_sb3,
)
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled

needs_onnx = pytest.mark.skipif(
    find_spec("onnxruntime") is None or find_spec("onnx") is None, reason="needs pip install 'bsk_torch[onnx]'"
)
needs_sb3 = pytest.mark.skipif(find_spec("sb3_contrib") is None, reason="needs pip install 'bsk_torch[sb3]'")
needs_benchmarl = pytest.mark.skipif(find_spec("benchmarl") is None, reason="needs pip install --no-deps benchmarl==1.5.2")


@pytest.fixture(scope="module")
def env():
    return bsk_torch.make("NadirScan-v1", num_envs=3, time_limit=900.0)


@pytest.fixture(scope="module")
def docking():
    return bsk_torch.make("CWDocking-v1", num_envs=3, time_limit=20.0)


def situations(rows=7):
    """Random observations, in which one of the actions is forbidden."""
    generator = torch.Generator().manual_seed(1)
    mask = torch.ones(rows, ACTIONS, dtype=torch.bool)
    mask[:, 1] = False
    return TensorDict({"observation": torch.randn(rows, OBSERVED, generator=generator), "action_mask": mask}, [rows])


def chosen(source, env, **options):
    return bsk_torch.load_policy(source, env, **options)(situations())["action"].tolist()


def best(scores, mask):
    return scores.masked_fill(~mask, -torch.inf).argmax(-1).tolist()


# -- each kind -------------------------------------------------------------------------------------------------------------------


@needs_sb3
@pytest.mark.parametrize("name", ["PPO", "A2C", "DQN", "MaskablePPO"])
def test_models_of_stable_baselines3_choose_as_the_library_predicts(env, tmp_path, name):
    import sb3_contrib
    import stable_baselines3

    path, td = write_sb3(tmp_path / "m.zip", name), situations()
    kind = getattr(stable_baselines3, name, None) or getattr(sb3_contrib, name)
    masks = {"action_masks": td["action_mask"].numpy()} if name == "MaskablePPO" else {}
    wanted, _ = kind.load(path).predict(td["observation"].numpy(), deterministic=True, **masks)
    assert chosen(path, env) == wanted.tolist()
    assert read_policy(path).library.startswith("stable-baselines3 2.")


@needs_sb3
@pytest.mark.parametrize("name", ["SAC", "PPO"])
def test_real_actions_of_stable_baselines3(docking, tmp_path, name):
    import stable_baselines3

    kwargs = {"policy_kwargs": {"net_arch": [8], "activation_fn": torch.nn.ELU}}
    path = write_sb3(tmp_path / "m.zip", name, sb3_env("CWDocking-v1"), **kwargs)
    td = docking.reset()
    wanted, _ = getattr(stable_baselines3, name).load(path).predict(td["observation"].numpy(), deterministic=True)
    np.testing.assert_allclose(bsk_torch.load_policy(path, docking)(td)["action"].numpy(), wanted, atol=1e-6)


@needs_sb3
def test_named_observations_of_stable_baselines3(tmp_path):
    from stable_baselines3 import PPO

    options = dict(n_targets=100, as_set=True)
    path = write_sb3(tmp_path / "m.zip", "PPO", sb3_env("AEOS-v1", **options), "MultiInputPolicy")
    aeos = bsk_torch.make("AEOS-v1", num_envs=2, time_limit=300.0, **options)
    td = aeos.reset()
    wanted = policy_of_one(PPO.load(path), aeos.satellite)(td.clone())["action"]
    assert bsk_torch.load_policy(path, aeos)(td)["action"].tolist() == wanted.tolist()
    vector = bsk_torch.make("AEOS-v1", num_envs=2, time_limit=300.0, n_targets=100)
    with pytest.raises(ValueError, match=r"sat_props/c_hat_H.* has no 'sat_props/c_hat_H', but observation, action_mask"):
        bsk_torch.load_policy(path, vector)


@needs_sb3
def test_normalized_observations_and_unusual_networks_are_unpickled_with_trust_only(env, tmp_path):
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize

    td, inner = situations(), sb3_env()
    unusual = write_sb3(tmp_path / "unusual" / "m.zip", policy_kwargs={"net_arch": [8], "activation_fn": torch.nn.Hardtanh})
    with pytest.raises(UntrustedError, match=r"unusual/m.zip.*unpickles.*Hardtanh.*--trust"):
        bsk_torch.load_policy(unusual, env)
    wanted, _ = PPO.load(unusual).predict(td["observation"].numpy(), deterministic=True)
    assert chosen(unusual, env, trust=True) == wanted.tolist()
    plain = write_sb3(tmp_path / "m.zip")
    normalizer = VecNormalize(inner)
    normalizer.obs_rms.mean += 2.0
    normalizer.save(str(tmp_path / "vecnormalize.pkl"))
    with pytest.raises(UntrustedError, match=r"vecnormalize.pkl' next to it is a pickle"):
        bsk_torch.load_policy(plain, env)
    seen = normalizer.normalize_obs(td["observation"].numpy())
    assert chosen(plain, env, trust=True) == PPO.load(plain).predict(seen, deterministic=True)[0].tolist()


@needs_onnx
@pytest.mark.parametrize("batch", ["N", 1, 4])
def test_onnx_files_score_legal_actions_whatever_their_batch_is(env, tmp_path, batch):
    td, weight = situations(), torch.randn(OBSERVED, ACTIONS, generator=torch.Generator().manual_seed(2))
    (tmp_path / "net.onnx").write_bytes(onnx_model(weight, batch=batch, name="x"))
    assert chosen(tmp_path / "net.onnx", env) == best(td["observation"] @ weight, td["action_mask"])
    assert read_policy(tmp_path / "net.onnx").library.startswith("test, ONNX Runtime ")


@pytest.mark.parametrize(("module", "batch"), [(MaskedNet(), None), (MaskedNet(), 2), (Net(), None)])
def test_exported_programs_choose_as_their_modules(env, tmp_path, module, batch):
    td = situations()
    (tmp_path / "net.pt2").write_bytes(exported(module, batch=batch))
    assert chosen(tmp_path / "net.pt2", env) == best(module.layer(td["observation"]), td["action_mask"])


def test_modules_and_functions(env, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_policies_56.py").write_text(MODULE)
    torch.save(Net(), tmp_path / "net.pt")
    td = situations()
    assert chosen("net.pt", env, trust=True) == best(Net()(td["observation"]), td["action_mask"])
    assert chosen("my_policies_56:best_legal", env) == [0] * 7
    assert chosen("my_policies_56:network", env) == chosen("my_policies_56.py:network", env)
    assert set(chosen("random", env)) <= {0, 2, 3}
    assert bsk_torch.load_policy("plan:rollout,base=rule,horizon=120", env).horizon == 120
    write_own(tmp_path / "policy.pt")
    assert chosen(tmp_path, env) == chosen(tmp_path / "policy.pt", env)


@needs_benchmarl
@pytest.mark.filterwarnings("ignore")
def test_experiments_of_benchmarl(env, tmp_path):
    folder = write_experiment(tmp_path)
    team = bsk_torch.make("Constellation-v1", num_envs=2, time_limit=300.0, **TEAM)
    td = team.reset()
    action = bsk_torch.load_policy(folder, team, trust=True)(td.clone())["agents", "action"]
    assert td["agents", "action_mask"].gather(-1, action.unsqueeze(-1)).all()
    (file,) = (folder / "checkpoints").iterdir()
    assert torch.equal(action, bsk_torch.load_policy(file, team, trust=True)(td.clone())["agents", "action"])
    weights = torch.load(file, weights_only=False)["loss_agents"]  # whose centralized critic fits three satellites only
    larger = bsk_torch.make("Constellation-v1", num_envs=2, time_limit=300.0, **TEAM | {"n_satellites": 4})
    for env_of_any_size in (team, larger):
        policy, td = bsk_torch.load_policy(folder, env_of_any_size, trust=True), env_of_any_size.reset()
        assert sorted(float(part.sum()) for part in policy.parameters()) == sorted(
            float(part.sum()) for name, part in weights.items() if name.startswith("actor")
        )
        action = policy(td.clone())["agents", "action"]
        assert action.shape == td["agents", "action_mask"].shape[:2]
    (tmp_path / "own").mkdir()
    own = write_experiment(tmp_path / "own", share_policy_params=False)
    assert bsk_torch.load_policy(own, team, trust=True)(team.reset())["agents", "action"].shape == (2, 3)
    others = bsk_torch.make("AEOSConstellation-v1", num_envs=1, n_satellites=2, n_targets=100, time_limit=300.0)
    relays = bsk_torch.make("RelayConstellation-v1", num_envs=1, n_imagers=2, n_targets=100, time_limit=300.0)
    load = lambda where, trust=True: lambda: bsk_torch.load_policy(folder, where, trust=trust)
    check_refusals(
        refusal(load(team, False), UntrustedError, "experiment of BenchMARL", "config.pkl", "--trust"),
        refusal(load(env), ValueError, "groups agents", "one satellite"),
        refusal(load(relays), ValueError, "groups agents", "broadcasting_imager"),
        refusal(
            lambda: bsk_torch.load_policy(own, larger, trust=True),
            ValueError,
            "share_policy_params",
            "4 agents",
            "[3, 8, ",
            "[4, 8, ",
        ),
        refusal(load(others), ValueError, "has other observations or actions", "2 agents", "[8, 141]", "[8, 269]"),
    )


@pytest.mark.rllib
def test_checkpoints_of_rllib(env, docking, tmp_path):
    from ray.rllib.core.columns import Columns
    from ray.rllib.core.rl_module.rl_module import RLModule

    path, td = write_rllib(tmp_path / "a"), situations()
    scores = RLModule.from_checkpoint(path).forward_inference({Columns.OBS: td["observation"]})[Columns.ACTION_DIST_INPUTS]
    assert chosen(path, env, trust=True) == scores.argmax(-1).tolist()
    real = write_rllib(tmp_path / "b", "CWDocking-v1")
    assert bsk_torch.load_policy(real, docking, trust=True)(docking.reset())["action"].shape == (3, 3)
    check_refusals(
        refusal(lambda: bsk_torch.load_policy(path, env), UntrustedError, "checkpoint of RLlib", "--trust"),
        refusal(lambda: bsk_torch.load_policy(path, docking, trust=True), ValueError, "chooses one", "real numbers"),
    )


# -- errors ----------------------------------------------------------------------------------------------------------------------


@needs_onnx
def test_other_observations_and_actions_are_named(env, docking, tmp_path):
    names = list(env.satellite.observation_description)
    actions = list(env.satellite.action_description)

    def onnx(title, observed=OBSERVED, count=ACTIONS, **options):
        path = tmp_path / f"{title}.onnx"
        path.write_bytes(onnx_model(torch.zeros(observed, count), **options))
        return lambda where=env: bsk_torch.load_policy(path, where)

    swapped = [names[1], names[0], *names[2:]]
    load = onnx("right", contract={"observation": names, "actions": actions})
    assert load()(situations())["action"].tolist() == [0] * 7
    grouped = [{"name": names[0], "width": 12}]
    check_refusals(
        refusal(onnx("long", 14), ValueError, "long.onnx", "14 numbers", "'observation'", "gives 12", names[0]),
        refusal(onnx("many", count=5), ValueError, "many.onnx", "[3, 5]", "[3, 4]"),
        refusal(onnx("order", contract={"observation": swapped}), ValueError, "number 0", names[0], names[1]),
        refusal(onnx("width", contract={"observation": grouped}), ValueError, "number 1", names[0], names[1]),
        refusal(onnx("acts", contract={"actions": ["a", "b"]}), ValueError, "action 0", "'a'", actions[0]),
        refusal(onnx("odd", contract={"actions": 3}), ValueError, "odd.onnx", "contract", "actions"),
        refusal(onnx("operator", operator="Divine"), ValueError, "operator.onnx", "Divine"),
        refusal(lambda: load(docking), ValueError, "12 numbers", "gives 8"),
    )
    torch.nn.init.constant_((net := Net()).layer.weight, torch.nan)
    torch.save(net, tmp_path / "nan.pt")
    (tmp_path / "nan.pt2").write_bytes(exported(net))
    (tmp_path / "masked.pt2").write_bytes(exported(MaskedNet(8, 3)))
    check_refusals(
        refusal(lambda: bsk_torch.load_policy(tmp_path / "nan.pt2", env), ValueError, "nan.pt2", "NaN", names[0]),
        refusal(lambda: bsk_torch.load_policy(tmp_path / "nan.pt", env, trust=True)(situations()), ValueError, "NaN", names[0]),
        refusal(lambda: bsk_torch.load_policy(tmp_path / "masked.pt2", docking), ValueError, "masked.pt2", "'action_mask'", "no"),
    )


@needs_sb3
def test_models_of_other_environments_are_named(env, docking, tmp_path):
    from stable_baselines3 import PPO

    scan, real = write_sb3(tmp_path / "scan.zip"), write_sb3(tmp_path / "real.zip", "SAC", sb3_env("CWDocking-v1"))
    recurrent = write_sb3(tmp_path / "memory.zip", "RecurrentPPO", policy="MlpLstmPolicy")
    science = bsk_torch.make("AEOS-v1", num_envs=2, n_targets=100, time_limit=300.0)
    team = bsk_torch.make("RelayConstellation-v1", num_envs=1, n_imagers=2, n_targets=100, time_limit=300.0)
    broken = tmp_path / "nan.zip"
    model = PPO("MlpPolicy", sb3_env(), device="cpu")
    torch.nn.init.constant_(model.policy.action_net.weight, torch.nan)
    model.save(broken)
    load = lambda path, where=env, **options: lambda: bsk_torch.load_policy(path, where, **options)
    check_refusals(
        refusal(load(scan, docking), ValueError, "scan.zip", "chooses one", "real numbers"),
        refusal(load(real), ValueError, "real.zip", "returns real numbers", "a choice of 4", "action_charge"),
        refusal(load(scan, science), ValueError, "scan.zip", "4 actions", "has 32"),
        refusal(load(scan, team), ValueError, "alike", "relay"),
        refusal(load(recurrent, trust=True), ValueError, "memory.zip", "recurrent", "module:function"),
        refusal(load(broken), UntrustedError, "nan.zip", "not finite"),
    )
    assert pickled_parts(scan) == ""


def test_damaged_files_are_named(env, tmp_path):
    files = {
        "empty.zip": b"",
        "noise.zip": b"PK\x03\x04 nothing",
        "noise.onnx": b"\x08\x07nothing",
        "noise.pt2": b"PK\x03\x04 nothing",
        "noise.pt": b"nothing",
    }
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    with zipfile.ZipFile(tmp_path / "other.zip", "w") as archive:
        archive.writestr("data", "{}")
    torch.save(Net().state_dict(), tmp_path / "weights.pt")
    have = find_spec("onnxruntime") is not None
    load = lambda name, **options: lambda: bsk_torch.load_policy(tmp_path / name, env, **options)
    rows = [refusal(load(name), ValueError, name) for name in files if have or name != "noise.onnx"]
    check_refusals(
        rows,
        refusal(load("noise.pt2", trust=True), ValueError, "noise.pt2", "torch.export"),
        refusal(load("other.zip"), ValueError, "other.zip", "policy.pth"),
        refusal(load("weights.pt"), ValueError, "weights.pt", "module:function"),
        refusal(load("nowhere.zip"), FileNotFoundError, "nowhere.zip"),
        refusal(lambda: bsk_torch.load_policy("plan:rolout", env), ValueError, "rolout", "plan:rollout"),
        refusal(lambda: bsk_torch.load_policy("rull", env), ValueError, "'rull'", "'rule'"),
    )


def test_nothing_is_executed_without_trust(env, tmp_path, monkeypatch):
    made = tmp_path / "made"
    torch.save(Evil(made), tmp_path / "evil.pt")
    (tmp_path / "evil.py").write_text(f"import os; os.mkdir({str(made)!r})\nraise RuntimeError('lost')")
    (tmp_path / "rllib").mkdir()
    for name in ("metadata.json", "class_and_ctor_args.pkl"):
        (tmp_path / "rllib" / name).write_bytes(pickle.dumps(Evil(made)))
    (tmp_path / "marl" / "checkpoints").mkdir(parents=True)
    for name in ("config.pkl", "checkpoints/checkpoint_9.pt"):
        (tmp_path / "marl" / name).write_bytes(pickle.dumps(Evil(made)))
    load = lambda name, **options: lambda: bsk_torch.load_policy(name, env, **options)
    check_refusals(
        refusal(load(tmp_path / "evil.pt"), UntrustedError, "evil.pt", "posix.mkdir", "--trust"),
        refusal(load(tmp_path / "rllib"), UntrustedError, "rllib", "--trust"),
        refusal(load(tmp_path / "marl"), UntrustedError, "marl", "--trust"),
    )
    assert not made.exists()
    check_refusals(refusal(load(f"{tmp_path}/evil.py:policy"), ValueError, "evil.py", "RuntimeError: lost"))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"target": "torch.ops.aten.linear.default"', '"target": "torch.os.system"'),
        ('"target": "torch.ops.aten.linear.default"', '"target": "torch.ops.aten.from_file.default"'),
        ('"target": "torch.ops.aten.linear.default"', '"target": "torch.ops.aten._unsafe_index_put.default"'),
        ('"expr_str": "Symbol(', "\"expr_str\": \"__import__('os').mkdir('made') or Symbol("),
        ('"expr_str": "Symbol(', '"expr_str": "2**2**2**2**9 + Symbol('),
        ('"name": "observation"', "\"name\": \"observation=__import__('os').mkdir('made')\""),
        ("builtins.tuple", "collections.defaultdict"),
        ('"guards_code": []', "\"guards_code\": [\"__import__('os').mkdir('made')\"]"),
    ],
)
def test_programs_that_could_execute_code_are_not_loaded(env, tmp_path, monkeypatch, old, new):
    """As torch.export.load evaluates sizes, names and guards, and finds functions of torch by their names."""
    monkeypatch.chdir(tmp_path)
    _changed_program(tmp_path / "net.pt2", "models/model.json", lambda text: text.replace(old, new))
    if "guards" in old:  # which are left out
        assert len(chosen("net.pt2", env)) == 7
    else:
        with pytest.raises(UntrustedError, match=r"net.pt2.*could execute code.*--trust"):
            bsk_torch.load_policy("net.pt2", env)
    assert not (tmp_path / "made").exists()


def test_pickled_weights_of_programs_are_not_loaded(env, tmp_path):
    path = tmp_path / "net.pt2"
    _changed_program(path, "model_weights_config.json", lambda text: text.replace('"use_pickle": false', '"use_pickle": true'))
    with pytest.raises(UntrustedError, match="use_pickle"):
        bsk_torch.load_policy(path, env)


def _changed_program(path, entry, change):
    """Write a program with a changed text."""
    path.write_bytes(exported(Net()))
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    (name,) = (name for name in parts if name.endswith(entry))
    text = json.dumps(json.loads(parts[name]))
    changed = change(text)
    assert changed != text
    with zipfile.ZipFile(path, "w") as archive:
        for other, content in (parts | {name: changed.encode()}).items():
            archive.writestr(other, content)


def test_a_checkpoint_of_a_gpu_is_read_on_a_machine_without(env, tmp_path):
    """Its storages name their device, to which torch would move them."""
    torch.save(Net(), tmp_path / "cpu.pt")
    with zipfile.ZipFile(tmp_path / "cpu.pt") as archive, zipfile.ZipFile(tmp_path / "gpu.pt", "w") as copy:
        for name in archive.namelist():
            content = archive.read(name)
            copy.writestr(name, content.replace(b"X\x03\x00\x00\x00cpu", b"X\x06\x00\x00\x00cuda:0"))
    assert b"cuda:0" in (tmp_path / "gpu.pt").read_bytes()
    assert chosen(tmp_path / "gpu.pt", env, trust=True) == chosen(tmp_path / "cpu.pt", env, trust=True)
