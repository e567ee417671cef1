# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Your own EXR files
#
# Before you trust a blur, check which channels were read, which convention the motion vectors follow,
# and whether their sign is right. This notebook shows these checks, and then blurs a sequence. Set
# `NOW` and `NEXT` to files of your own and run it again.

# %%
import tempfile
from pathlib import Path

import numpy as np

import jaxblur
from jaxblur import exr, show, vectors

# %matplotlib inline
# %config InlineBackend.figure_formats = ["jpeg"]

DATA = Path("../tests/data")
NOW = DATA / "cube_over_crates_frame_0011.exr"
NEXT = DATA / "cube_over_crates_frame_0012.exr"
SHUTTER = 0.5

# %% [markdown]
# ## What is in the file

# %%
info = exr.inspect(NOW)
for part in info.parts:
    names = ", ".join(channel.name for channel in part.channels)
    print(f"part {part.name!r}: {names}")

# %% [markdown]
# ## How it was read
#
# Renderers write vectors in different conventions: in pixels or as shares of the width, with y up or
# down, per frame or per shutter, to the next frame or from the last. A preset describes one
# convention. `auto` recognizes the preset by the names of the channels, and reports the rule that
# decided.

# %%
buffers = exr.read_buffers(NOW, "auto", SHUTTER)
print("color:  ", ", ".join(buffers.color_channels))
print("vectors:", buffers.guess.reason)
print("depth:  ", buffers.depth_channel, "read as", buffers.depth_kind)

# %% [markdown]
# All presets, and which of them were verified on files of that renderer:

# %%
for preset in vectors.PRESETS.values():
    mark = "verified  " if preset.verified else "unverified"
    print(f"{preset.name:12} {mark} {preset.source[:84]}")

# %% [markdown]
# ## The sign check
#
# With a wrong sign or unit the blur is wrong but looks plausible, so do not judge it by eye. If the
# vectors of a frame are right, the next frame, warped back along them, looks like the frame. This cell
# tries all conventions and ranks them by the difference that remains.

# %%
now, following = exr.read_image(NOW), exr.read_image(NEXT)
names = list(buffers.guess.channels)
ranking = vectors.rank_conventions(
    now, following, exr.read_channels(NOW, names), names, shutter=SHUTTER
)
print(f"error if nothing moved: {ranking.still_error:.4f}")
for candidate in ranking.candidates[:4]:
    known = ", ".join(candidate.presets) or "no preset"
    print(
        f"error {candidate.error:.4f}: {candidate.channels}, x {candidate.sign_x:+d}, "
        f"y {candidate.sign_y:+d}, {candidate.unit}, {known}"
    )

# %% [markdown]
# The error of the best candidate should be far below the error without motion, and its convention
# should be the one that was read. On the command line: `jaxblur vectors NOW --next NEXT`.
#
# ## The vectors as a picture

# %%
frame = jaxblur.Frame(buffers.color, buffers.depth, buffers.velocity)
show.frame_sheet(frame)

# %% [markdown]
# ## A sequence
#
# Every frame is blurred independently, so frames may run in any order and on any machine. Equal
# settings and sizes compile once. `write_image(..., like=...)` keeps windows, metadata and all other
# channels of the source, and a file appears under its name only when it is complete.

# %%
statistics = vectors.speed_statistics(buffers.velocity)
settings = jaxblur.Settings(samples=35, radius=statistics.suggested_radius)
parameters = jaxblur.GuertinParameters(depth_sharpness=10.0)
images = {}
with tempfile.TemporaryDirectory() as folder:
    for source in (NOW, NEXT):
        sharp = jaxblur.read_frame(source, shutter=SHUTTER)
        blurred = np.asarray(jaxblur.guertin2014(sharp, parameters, settings=settings))
        target = Path(folder) / source.name.replace("frame", "blurred")
        exr.write_image(target, blurred, like=source)
        images[target.name] = exr.read_image(target)
        kept = len(exr.inspect(target).parts)
        print(f"{target.name}: radius {settings.radius} px, {kept} parts kept")

show.image_grid(images)

# %% [markdown]
# On the command line, `jaxblur blur beauty.0011.exr -o blurred.0011.exr --radius auto` blurs one
# frame; `jaxblur blur --help` lists the presets and the options for files that no preset describes.
#
# ## Problems that these checks do not find
#
# - Vectors that a renderer averaged over a pixel's samples are mixed at silhouettes. If you can, render
#   unfiltered vectors.
# - Shadows, reflections and objects behind glass do not move with the vector of their pixel.
# - Some renderers write empty vectors if motion blur was on during rendering. `jaxblur info` shows the
#   speeds: zero everywhere is a sign of this.
