"""Recorders of TorchRL, Gymnasium and PettingZoo's contract get the pictures that they expect."""

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.error import ResetNeeded
from torchrl.envs import check_env_specs
from torchrl.record import CSVLogger, PixelRenderTransform, VideoRecorder

pytest.importorskip("matplotlib", reason="needs the extra viz")

import bsk_torch
from bsk_torch.wrappers import GymEnv, GymJointEnv, GymVectorEnv
from bsk_torch.wrappers.pettingzoo import parallel_env
from tests.support.refusals import check_refusals, refusal

from .constellations import check_accepted, trio

pytestmark = pytest.mark.compiled

QUICK = {"time_limit": 360.0}


def scanner(num_envs):
    return bsk_torch.make("NadirScan-v1", num_envs=num_envs, seed=0, time_limit=900.0)


def film(env, folder, steps=3, **options):
    """Frames [T, C, H, W] that TorchRL records of a rollout in which everybody does the first legal thing, and the rollout."""
    logger = CSVLogger("film", log_dir=str(folder), video_format="pt")
    env = env.append_transform(PixelRenderTransform(height=120, **options))
    env = env.append_transform(VideoRecorder(logger, tag="flight"))
    assert "pixels" in env.observation_spec.keys()  # noqa: SIM118  - before the rollout: TorchRL resets to find this out
    action = env.action_key
    mask = (*action[:-1], "action_mask") if isinstance(action, tuple) else "action_mask"
    rollout = env.rollout(steps, lambda td: td.set(action, td[mask].byte().argmax(-1)), break_when_any_done=False)
    env.transform.dump()
    return torch.load(folder / "film" / "videos" / "flight_0.pt")[0], rollout


@pytest.mark.parametrize("make", [scanner, lambda n: trio(num_envs=n, time_limit=60.0)], ids=["one", "constellation"])
@pytest.mark.parametrize("n", [1, 2])
def test_torchrl_records_all_environments_side_by_side(make, n, tmp_path):
    env = make(n)
    frames, rollout = film(env, tmp_path)
    assert rollout["next", "pixels"].shape == (n, 3, 120, 160, 3)
    assert (frames.shape, frames.dtype) == ((4, 3, 120, n * 160), torch.uint8)
    last = torch.cat(list(env.render(height=120)), 1).permute(2, 0, 1)
    assert torch.equal(frames[-1], last)
    assert not torch.equal(frames[0], frames[-1])


def test_specs_and_frames_of_single_environments(tmp_path):
    env = scanner(20)
    frames, _ = film(env, tmp_path, rows=3)
    assert frames.shape == (4, 3, 120, 160)
    assert torch.equal(frames[-1], env.render(rows=3, height=120).permute(2, 0, 1))
    check_env_specs(scanner(2).append_transform(PixelRenderTransform(height=120)))


def test_gymnasium_makes_an_environment_that_draws():
    env = gymnasium.make("bsk_torch/NadirScan-v1", render_mode="rgb_array", **QUICK)
    env.reset(seed=0)
    frame = env.render()
    assert isinstance(frame, np.ndarray)
    assert (frame.shape, frame.dtype) == ((480, 640, 3), np.uint8)
    env.step(0)
    assert not np.array_equal(frame, env.render())
    assert np.array_equal(env.render(), env.unwrapped.core.render(rows=0).numpy())
    assert env.metadata["render_modes"] == ["rgb_array"]


def test_gymnasium_accepts_the_pictures():
    check_accepted(gymnasium.make("bsk_torch/NadirScan-v1", render_mode="rgb_array", **QUICK).unwrapped)


def test_gymnasium_vectors_give_a_picture_of_every_environment():
    env = gymnasium.make_vec("bsk_torch/NadirScan-v1", num_envs=2, render_mode="rgb_array", **QUICK)
    assert isinstance(env, GymVectorEnv)
    assert env.render_mode == "rgb_array"
    env.reset(seed=0)
    frames = env.render()
    assert isinstance(frames, tuple)
    assert [frame.shape for frame in frames] == [(480, 640, 3)] * 2
    assert not np.array_equal(*frames)


def test_constellations_draw_for_gymnasium_and_pettingzoo():
    joint = GymJointEnv(trio, joint=True, render_mode="rgb_array")
    parallel = parallel_env(trio, render_mode="rgb_array")
    for env in (joint, parallel):
        env.reset(seed=4)
    assert joint.render().shape == (480, 640, 3)
    assert np.array_equal(joint.render(), parallel.render())
    assert parallel.metadata["render_modes"] == ["rgb_array"]


def test_rejects_wrong_render_modes_and_pictures_before_the_first_episode():
    quick = QUICK | {"backend": "eager"}
    scans = [lambda view=view: view("NadirScan-v1", render_mode="human", **quick) for view in (GymEnv, GymVectorEnv)]
    crews = [lambda view=view: view("Constellation-v1", render_mode="ansi", **quick) for view in (GymJointEnv, parallel_env)]
    new = (GymEnv("NadirScan-v1", render_mode="rgb_array", **quick), parallel_env(trio, render_mode="rgb_array", backend="eager"))
    check_refusals(
        *(refusal(call, ValueError, "render_mode", "'human'", ["rgb_array"]) for call in scans),
        *(refusal(call, ValueError, "render_mode", "'ansi'", ["rgb_array"]) for call in crews),
        *(refusal(lambda env=env: env.render(), ResetNeeded, "render()", "reset()") for env in new),
    )


def test_without_a_render_mode_nothing_is_drawn_but_a_warning_given():
    env = GymEnv("NadirScan-v1", **QUICK)
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="render_mode='rgb_array'"):
        assert env.render() is None


def test_gymnasium_writes_a_video(tmp_path):
    moviepy = pytest.importorskip("moviepy.video.io.VideoFileClip", reason="needs the extra video")
    env = gymnasium.make("bsk_torch/NadirScan-v1", render_mode="rgb_array", **QUICK)
    env = gymnasium.wrappers.RecordVideo(env, str(tmp_path), name_prefix="flight")
    env.reset(seed=0)
    shown = [env.render()]
    over = False
    while not over:
        over = any(env.step(1)[2:4])
        shown.append(env.render())
    env.close()
    clip = moviepy.VideoFileClip(str(tmp_path / "flight-episode-0.mp4"))
    assert (clip.fps, list(clip.size), len(shown)) == (10, [640, 480], 4)
    assert clip.duration == pytest.approx(0.4, abs=0.05)
    # H.264 blurs: most pixels are within a few steps of 256
    assert np.abs(clip.get_frame(0.0).astype(int) - shown[0]).mean() < 4.0
    clip.close()
