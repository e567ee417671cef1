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
# # How the filter sees a frame
#
# `guertin2014` decides for each pixel along which lines to look for color, and how much of what it
# finds there counts. This notebook draws both, with the functions that the filter itself runs.
#
# Source: Guertin, McGuire, Nowrouzezahrai 2014, *A Fast and Stable Feature-Aware Motion Blur
# Filter*.

# %%
from pathlib import Path

import numpy as np

import jaxblur
from jaxblur import exr, show

# %matplotlib inline
# %config InlineBackend.figure_formats = ["jpeg"]

DATA = Path("../tests/data")
frame = jaxblur.read_frame(DATA / "cube_over_crates_frame_0011.exr", shutter=0.5)
truth = exr.read_image(DATA / "cube_over_crates_truth_0011.exr")
settings = jaxblur.Settings(samples=25, radius=20)

# %% [markdown]
# ## Tiles
#
# A pixel of the still wall must know that a cube flies by, or nothing would blur over it. So the
# image is cut into tiles as large as the longest blur. *TileMax* is the fastest velocity in a tile,
# *NeighborMax* the fastest in its 3 x 3 ring: the **dominant velocity** of all pixels of the tile.

# %%
figure = show.new_figure(10, 3.9)
left, right = figure.subplots(1, 2)
show.tile_overlay(frame, settings, stage="tile", axes=left)
show.tile_overlay(frame, settings, stage="neighbor", axes=right)
figure

# %% [markdown]
# ## Two directions, taps and weights
#
# Half of the taps go along the dominant velocity, half along the **center direction**: the pixel's
# own velocity where it moves, the perpendicular of the dominant one where it stands. A dot's area is
# the weight of the texel, the ring is the pixel itself, and a cross without a dot is a tap that does
# not count.
#
# Left: a pixel of the cube, whose two directions agree. Right: a pixel of the still wall beside
# the cube. There the center direction is the perpendicular, and of the taps those on the cube count,
# as far as the cube's streaks reach.

# %%
speed = np.linalg.norm(np.asarray(frame.velocity), axis=-1)
row = 56
moving = np.flatnonzero(speed[row] > 10)
places = [(row, int(moving[len(moving) // 2])), (row, int(moving.min()) - 4)]

figure = show.new_figure(11, 4.6)
for (row, column), axes in zip(places, figure.subplots(1, 2), strict=True):
    show.tap_diagram(frame, row, column, settings=settings, axes=axes)
figure

# %% [markdown]
# The weights are no second implementation: a filter's output is linear in color, so they are the
# derivative of the pixel with respect to the color. They sum to 1.

# %%
weights = show.texel_weights("guertin2014", frame, *places[1], settings=settings)
print(
    f"{np.count_nonzero(weights)} texels make the pixel; their weights sum to {weights.sum():.4f}"
)


# %% [markdown]
# ## What each parameter does
#
# A part of the picture for each value, the other parameters as published. Parameters are traced: none of
# these pictures recompiles anything.
#
# - **kappa** divides the weight of the pixel's own color. Small: the sharp picture shines through.
# - **gamma** is the speed in pixels over which the center direction turns from the perpendicular to
#   the pixel's own velocity. It matters for slow pixels only, of which this frame has few.
# - **tau** is how far, in tiles, a pixel may look for another tile's velocity. 0 shows the tiles,
#   1 hides them in noise.
# - **phi** scales the jitter of the taps: 0 shows each tap as a ghost, more turns that into noise.


# %%
def picture(**values):
    chosen = jaxblur.GuertinParameters(**values)
    return jaxblur.guertin2014(frame, chosen, settings=settings)


choices = {
    "kappa": (0.5, 40.0, 1000.0),
    "gamma": (0.1, 1.5, 15.0),
    "tau": (0.0, 0.5, 1.0),
    "phi": (0.0, 27.0, 80.0),
}
first = picture()
compiled = jaxblur.guertin2014._cache_size()
images = {
    f"{name} = {value:g}": picture(**{name: value})[5:66, 70:]
    for name, values in choices.items()
    for value in values
}
assert jaxblur.guertin2014._cache_size() == compiled, "a parameter recompiled the filter"
show.image_grid(images, columns=3, width=9)


# %% [markdown]
# ## Play
#
# With a live kernel these are sliders; the picture follows when you let go.


# %%
def draw(kappa, gamma, tau, phi, depth_sharpness):
    blurred = picture(kappa=kappa, gamma=gamma, tau=tau, phi=phi, depth_sharpness=depth_sharpness)
    return show.before_after(frame.color, blurred, truth, name="guertin2014", limit=0.6)


show.sliders(
    draw,
    kappa=(0.1, 1000.0, 40.0),
    gamma=(0.1, 20.0, 1.5),
    tau=(0.0, 1.0, 1.0),
    phi=(0.0, 80.0, 27.0),
    depth_sharpness=(0.1, 50.0, 1.0),
)
