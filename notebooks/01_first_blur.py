# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#       format_version: '1.3'
#       jupytext_version: 1.19.6
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # A first blur
#
# A sharp frame, what its buffers mean, the blur, the truth, and how wrong the blur is.
#
# The frame is a crop of one that Blender Cycles rendered: a cube that flies past a crate at about
# 75 pixels per frame. The same shot was rendered once more with true motion blur, and that is the
# truth here. Everything runs on the CPU.

# %%
from pathlib import Path

import numpy as np

import jaxblur
from jaxblur import exr, metrics, show

# %matplotlib inline
# %config InlineBackend.figure_formats = ["jpeg"]

DATA = Path("../tests/data")
SHUTTER = 0.5  # the camera is open for half of a frame

# %% [markdown]
# ## What a frame holds
#
# `read_frame` recognizes the channels by their names and converts them to the conventions of
# `jaxblur.frame`. The filters need three buffers:
#
# - **color** is linear light: twice the number is twice the light. Blur averages light, so it must
#   not be done on sRGB values.
# - **depth** is the distance along the view axis, sky is infinite. It says what hides what.
# - **velocity** is the *half-spread* in pixels, x to the right, y down: while the shutter is open
#   the point covers `p - velocity .. p + velocity`.

# %%
frame = jaxblur.read_frame(DATA / "cube_over_crates_frame_0011.exr", shutter=SHUTTER)
truth = exr.read_image(DATA / "cube_over_crates_truth_0011.exr")
show.frame_sheet(frame)

# %% [markdown]
# In the lower left picture hue says where to and saturation how fast: the cube moves to the right
# and a little up, the wall and the crate stand still and are white. In the lower right one an arrow is as long
# as the streak that its pixel will leave.

# %%
row, column = 40, 80
x, y = np.asarray(frame.velocity)[row, column]
print(f"The point at row {row}, column {column} moves by x = {2 * x:.1f}, y = {2 * y:.1f} pixels")
print(f"during the exposure (y down), and is {float(frame.depth[row, column]):.1f} units away.")

# %% [markdown]
# ## The blur
#
# Parameters are what can be fitted and differentiated; settings are what is compiled in. Both have
# the published values unless you say otherwise. A `depth_sharpness` of 10 tells surfaces apart
# whose depths differ by 10 percent; the published 1 needs a factor of two.

# %%
parameters = jaxblur.GuertinParameters(depth_sharpness=10.0)
settings = jaxblur.Settings(samples=35, radius=40)
blurred = jaxblur.guertin2014(frame, parameters, settings=settings)
show.before_after(frame.color, blurred, truth, name="guertin2014", limit=0.6)

# %% [markdown]
# ## How wrong it is
#
# [FLIP](https://research.nvidia.com/publication/2020-07_flip) models how visible the difference is
# when one alternates between two pictures: 0 is none. PSNR is in decibels, more is better. Both are
# taken on display values (sRGB, clipped to 0..1).

# %%
for name, image in {"sharp": frame.color, "guertin2014": blurred}.items():
    scores = metrics.compare(image, truth)
    print(f"{name:12} PSNR {scores.psnr:5.2f} dB, SSIM {scores.ssim:.3f}, FLIP {scores.flip:.3f}")

# %% [markdown]
# The error that is left sits along the borders of the cube. Behind a moving border the filter must
# show what the sharp frame hides, and it has to guess; its weights also favor the middle of a
# streak, where the true blur is even. More samples do not mend either.

# %%
show.error_map(blurred, truth, kind="display")

# %% [markdown]
# ## Where to go on
#
# - `02_how_the_filter_sees` opens the filter up.
# - `05_your_own_exr` reads files of other renderers.
# - `jaxblur.scenes` renders more frames with truth, without any renderer:
#   `scenes.render(scenes.SCENES["gears"]())`.
