"""
.. _tutorial-film:

Watch an episode
================

Make films of episodes, and open them in the viewer: the globe with satellites, targets and activities.

A frame shows the current moment of one episode. No display is needed.
"""

# %%
# Result
# ------
#
# This film shows an imaging satellite with the pretrained policy, with one frame per decision:
import torch
from PIL import Image
from torchrl.envs.utils import step_mdp

import bsk_torch
from bsk_torch.rl.policies import pretrained

# sphinx_gallery_thumbnail_path = "_static/readme/CloudyAEOS-v1.png"
FRAMES = 60
MEMBERS = 6
UNTIL = 5700.0

torch.set_num_threads(1)


def film(env, policy, path, seed, frames):
    """Film the first episode of ``seed`` in row 0, with one frame per decision."""
    env.set_seed(seed)
    td = env.reset()
    pictures = [env.render(rows=0)]
    while len(pictures) < frames and not td["done"][0].all():
        td = step_mdp(env.step(policy(td)))
        pictures.append(env.render(rows=0))
    first, *others = (Image.fromarray(picture.numpy()) for picture in pictures)
    first.save(
        path,
        save_all=True,
        append_images=others,
        duration=150,
        loop=0,
        quality=70,
        method=2,
    )
    print(
        f"{len(pictures)} frames, {float(env.fleet.sim_time[0]) / 60:.0f} minutes of flight"
    )


env = bsk_torch.make("AEOS-v1", num_envs=1, as_set=True, n_targets=1000)
film(env, pretrained("AEOS-v1"), "imaging.webp", seed=5, frames=FRAMES)

# %%
# Dark dots are targets; green dots are imaged targets. The strong line is the path that the satellite has flown, and the faint
# line is the rest of its orbit. Pillow also writes GIF files, which are larger and limited to 256 colors.
#
# ``env.render()`` returns images of unsigned bytes, ``[480, 640, 3]`` each, of the selected environment or of up to sixteen
# environments.
print(env.render(rows=0).shape, env.render(rows=0).dtype)

# %%
# Film a constellation
# --------------------
#
# The same function films a constellation. A step ends when the first satellite finishes its task, so there are many short steps.
from bsk_torch.rl.marl import shared

env = bsk_torch.make(
    "Constellation-v1", num_envs=1, n_satellites=MEMBERS, n_targets=2000, as_set=True
)
film(
    env,
    shared(pretrained("Constellation-v1"), env),
    "constellation.webp",
    seed=1,
    frames=FRAMES,
)

# %%
# Film the scanning satellite
# ---------------------------
#
# The panel on the right shows the levels of battery, data buffer and wheels. Each frame covers one to three minutes of flight.
env = bsk_torch.make("NadirScan-v1", num_envs=1)
film(env, pretrained("NadirScan-v1"), "scanning.webp", seed=7, frames=FRAMES)

# %%
# Open an episode in the viewer
# -----------------------------
#
# A film shows only the views that were drawn. The viewer shows a whole flight from any side and at any time, together with the
# observations and legal actions of each satellite. ``record`` plays an episode for the viewer, and ``html`` makes one file that
# plays in a browser without a network:
from pathlib import Path

from bsk_torch.recording import record

flight = record(
    env,
    pretrained("NadirScan-v1"),
    seed=7,
    until=UNTIL,
    preset="NadirScan-v1",
    label="pretrained",
)
page = Path("scanning.html")
page.write_text(flight.html(), encoding="utf-8")
print(f"{page}: {page.stat().st_size / 1e6:.1f} MB")

# %%
# .. image:: /_static/viewer/globe.webp
#    :alt: The viewer with twelve satellites over the Earth, the timeline of their decisions, and the panel of one of them
#
# ``bsk-torch view NadirScan-v1`` does the same and can fly other actions from any decision; see :doc:`/how_to/view`.
#
# Record with Gymnasium
# ---------------------
#
# The Gymnasium view supports ``render_mode="rgb_array"``, for use with ``gymnasium.wrappers.RecordVideo``, which writes MP4 files
# (extra ``video``):
#
# .. code-block:: python
#
#     import gymnasium
#     from gymnasium.wrappers import RecordVideo
#
#     env = gymnasium.make("bsk_torch/NadirScan-v1", render_mode="rgb_array")
#     env = RecordVideo(env, "videos", episode_trigger=lambda episode: episode == 0)
#
# For figures of a whole episode instead of a film, use ``record`` and ``draw``; see :ref:`tutorial-scanning`.
#
# Next steps
# ----------
#
# - :ref:`tutorial-evaluating`: evaluate a policy.
# - :ref:`examples`: programs to copy.
