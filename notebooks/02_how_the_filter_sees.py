# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # How the filter sees a frame
#
# For each pixel, `guertin2014` chooses the lines along which it gathers color, and the weight of each
# color on them. It gathers by *taps*: a tap reads one pixel of the sharp frame, its *texel*, at a place
# on the line. This notebook draws the lines and the weights with the functions that the filter itself
# runs.
#
# Source: Guertin, McGuire, Nowrouzezahrai 2014, *A Fast and Stable Feature-Aware Motion Blur
# Filter*.

# %%
from pathlib import Path

import jax
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
# The cube must blur over pixels of the still wall, so these pixels need the velocity of the cube that
# flies by. The image is therefore divided into tiles as large as the longest blur. *TileMax* is the
# fastest velocity in a tile, *NeighborMax* the fastest in its 3 x 3 ring of tiles: the **dominant
# velocity** of all pixels of the tile.

# %%
figure = show.new_figure(10, 3.9)
left, right = figure.subplots(1, 2)
show.tile_overlay(frame, settings, stage="tile", axes=left)
show.tile_overlay(frame, settings, stage="neighbor", axes=right)
figure

# %% [markdown]
# ## Two directions, taps and weights
#
# Half of the taps lie along the dominant velocity, half along the **center direction**: the pixel's
# own velocity if it moves, the perpendicular of the dominant velocity if it does not. The area of a
# dot is the weight of the texel, the ring is the pixel itself, and a cross without a dot is a tap of
# weight 0.
#
# Left: a pixel of the cube, whose two directions agree. Right: a pixel of the still wall beside the
# cube. There the center direction is the perpendicular, and the taps on the cube have weight, as far
# as the cube's streaks reach.

# %%
speed = np.linalg.norm(np.asarray(frame.velocity), axis=-1)
fast = speed > speed.max() / 2
rows = np.flatnonzero(fast.any(axis=1))
row = int(rows[len(rows) // 2])
moving = np.flatnonzero(fast[row])
places = [(row, int(moving[len(moving) // 2])), (row, max(int(moving.min()) - 4, 0))]

figure = show.new_figure(11, 4.6)
for (row, column), axes in zip(places, figure.subplots(1, 2), strict=True):
    show.tap_diagram(frame, row, column, settings=settings, axes=axes)
figure

# %% [markdown]
# The weights do not need a second implementation: the output of the filter is linear in color, so the
# weights are the derivatives of the pixel with respect to the colors. They sum to 1.

# %%
weights = show.texel_weights("guertin2014", frame, *places[1], settings=settings)
print(
    f"{np.count_nonzero(weights)} texels make the pixel; their weights sum to {weights.sum():.4f}"
)


# %% [markdown]
# ## What each parameter does
#
# The pictures show the same part of the frame for three values of each parameter, with the others as
# published. Parameters are traced, so none of these pictures recompiles anything.
#
# - **kappa** divides the weight of the pixel's own color. If it is small, the sharp picture shows
#   through.
# - **gamma** is the range of speeds, in pixels, over which the center direction turns from the
#   perpendicular to the pixel's own velocity. It only affects slow pixels, of which this frame has few.
# - **tau** is the distance, in tiles, within which a pixel may use the velocity of another tile. With 0
#   tiles whose velocities differ are visible as blocks, with 1 noise hides them. Here neighboring tiles
#   move nearly alike, and little changes.
# - **phi** scales the jitter of the taps, a random shift along the line. With 0 there is no such noise,
#   but where taps are few each leaves a ghost (`samples=7` shows them); larger values turn ghosts into
#   noise.


# %%
blur = jax.jit(lambda chosen: jaxblur.guertin2014(frame, chosen, settings=settings))


def picture(**values):
    return blur(jaxblur.GuertinParameters(**values))


choices = {
    "kappa": (0.5, 40.0, 1000.0),
    "gamma": (0.1, 1.5, 15.0),
    "tau": (0.0, 0.5, 1.0),
    "phi": (0.0, 27.0, 80.0),
}
first = picture()
compiled = blur._cache_size()
images = {
    f"{name} = {value:g}": picture(**{name: value})[5:66, 70:]
    for name, values in choices.items()
    for value in values
}
assert blur._cache_size() == compiled, "a parameter recompiled the filter"
show.image_grid(images, columns=3, width=9)


# %% [markdown]
# ## Try values
#
# With a live kernel these are sliders; the picture changes when you release one.


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
