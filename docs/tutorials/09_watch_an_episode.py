"""
.. _tutorial-film:

Watch an episode
================

Films of episodes: frames of the globe with the satellites, their targets and what they do.

A frame shows the present moment of one episode. Nothing needs a display.
"""

# %%
# The result
# ----------
#
# A satellite that images targets, with the policy of the package and one frame per decision:
import torch
from PIL import Image
from torchrl.envs.utils import step_mdp

import bsk_torch
from bsk_torch.rl.policies import pretrained

FRAMES = 60
MEMBERS = 6

torch.set_num_threads(1)


def film(env, policy, path, seed, frames):
    """Play the first episode of ``seed`` in row 0, and write a film with a picture after each decision."""
    env.set_seed(seed)
    td = env.reset()
    pictures = [env.render(rows=0)]
    while len(pictures) < frames and not td["done"][0].all():
        td = step_mdp(env.step(policy(td)))
        pictures.append(env.render(rows=0))
    first, *others = (Image.fromarray(picture.numpy()) for picture in pictures)
    first.save(path, save_all=True, append_images=others, duration=150, loop=0, quality=70, method=2)
    print(f"{len(pictures)} pictures of {float(env.fleet.sim_time[0]) / 60:.0f} minutes of flight")


env = bsk_torch.make("AEOS-v1", num_envs=1, as_set=True, n_targets=1000)
film(env, pretrained("AEOS-v1"), "imaging.webp", seed=5, frames=FRAMES)

# %%
# Dark dots are targets, and green ones have been imaged. The strong line is where the satellite has flown, the faint one the rest
# of its orbit. Pillow writes GIF files in the same way, larger and with 256 colours.
#
# ``env.render()`` returns pictures ``[480, 640, 3]`` of unsigned bytes: of the row that is named, or of all up to sixteen.
print(env.render(rows=0).shape, env.render(rows=0).dtype)

# %%
# A constellation
# ---------------
#
# The same function films a constellation. A step ends with the first task of any satellite, so there are many short ones.
from bsk_torch.rl.marl import shared

env = bsk_torch.make("Constellation-v1", num_envs=1, n_satellites=MEMBERS, n_targets=2000, as_set=True)
film(env, shared(pretrained("Constellation-v1"), env), "constellation.webp", seed=1, frames=FRAMES)

# %%
# The scanning satellite
# ----------------------
#
# The panel at the right has the levels of battery, store and wheels. A frame here is one to three minutes of flight.
env = bsk_torch.make("NadirScan-v1", num_envs=1)
film(env, pretrained("NadirScan-v1"), "scanning.webp", seed=7, frames=FRAMES)

# %%
# Through Gymnasium
# -----------------
#
# The Gymnasium view has ``render_mode="rgb_array"``, so that ``gymnasium.wrappers.RecordVideo`` writes MP4 files (extra
# ``video``):
#
# .. code-block:: python
#
#     import gymnasium
#     from gymnasium.wrappers import RecordVideo
#
#     env = gymnasium.make("bsk_torch/NadirScan-v1", render_mode="rgb_array")
#     env = RecordVideo(env, "videos", episode_trigger=lambda episode: episode == 0)
#
# Pictures of a whole episode, instead of a film, are what ``record`` and ``draw`` make: see :ref:`tutorial-scanning`.
#
# Next
# ----
#
# - :ref:`tutorial-evaluating`: numbers beside the pictures.
# - :ref:`examples`: programs to copy.
#
# sphinx_gallery_thumbnail_number = 1
