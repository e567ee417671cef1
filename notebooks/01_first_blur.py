# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # A first blur
#
# This notebook shows a sharp frame, the meaning of its buffers, the blur, the truth, and the error
# of the blur.
#
# The frame is a crop of a Blender Cycles render: a cube flies past a crate at about 75 pixels per
# frame. The same shot was also rendered with true motion blur, for a shutter of 0.5; that image is the
# truth here. With another `SHUTTER` the blur changes and the truth does not. `falling_cubes` and
# `sky_car` in place of `cube_over_crates` are two more shots. Everything runs on the CPU.

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
# - **depth** is the distance along the view axis; the sky is at infinity. It determines which surface
#   hides which.
# - **velocity** is the *half-spread* in pixels, x to the right, y down: while the shutter is open
#   the point covers `p - velocity .. p + velocity`.

# %%
frame = jaxblur.read_frame(DATA / "cube_over_crates_frame_0011.exr", shutter=SHUTTER)
truth = exr.read_image(DATA / "cube_over_crates_truth_0011.exr")
show.frame_sheet(frame)

# %% [markdown]
# In the lower left picture, hue shows the direction and saturation the speed: the cube moves to the
# right and a little up; the wall and the crate do not move and are white. In the lower right picture,
# each arrow is as long as the streak that its pixel will leave.

# %%
row, column = 40, 80
x, y = np.asarray(frame.velocity)[row, column]
print(f"The point at row {row}, column {column} moves by x = {2 * x:.1f}, y = {2 * y:.1f} pixels")
print(f"during the exposure (y down), and is {float(frame.depth[row, column]):.1f} units away.")

# %% [markdown]
# ## The blur
#
# Parameters can be fitted and differentiated; settings are compiled in. Both default to the published
# values. With a `depth_sharpness` of 10 the filter separates surfaces whose depths differ by 10
# percent; with the published value of 1 they must differ by a factor of two.

# %%
parameters = jaxblur.GuertinParameters(depth_sharpness=10.0)
settings = jaxblur.Settings(samples=35, radius=40)
blurred = jaxblur.guertin2014(frame, parameters, settings=settings)
show.before_after(frame.color, blurred, truth, name="guertin2014", limit=0.6)

# %% [markdown]
# ## The error
#
# [FLIP](https://research.nvidia.com/publication/2020-07_flip) models how visible the difference is
# when a viewer alternates between two pictures; 0 means no difference. PSNR is the mean squared
# difference in decibels; higher is better. SSIM compares the local structure; 1 means equal. All are
# computed on display values (sRGB, clipped to 0..1).

# %%
for name, image in {"sharp": frame.color, "guertin2014": blurred}.items():
    scores = metrics.compare(image, truth)
    print(f"{name:12} PSNR {scores.psnr:5.2f} dB, SSIM {scores.ssim:.3f}, FLIP {scores.flip:.3f}")

# %% [markdown]
# The remaining error lies along the borders of the cube. Behind a moving border the filter must show
# background that the sharp frame hides, so it has to guess. Its weights also favor the middle of a
# streak, while the true blur is even along the streak. And at the lower border of the picture, what the
# truth blurs into it lies outside the sharp frame. More samples correct none of these.

# %%
show.error_map(blurred, truth, kind="display")

# %% [markdown]
# ## Next
#
# - `02_how_the_filter_sees` shows the steps inside the filter.
# - `05_your_own_exr` reads files of other renderers.
# - `jaxblur.scenes` makes more frames with truth, and needs no external renderer:
#   `scenes.render(scenes.SCENES["gears"]())`.
