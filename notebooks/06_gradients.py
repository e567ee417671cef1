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
# # Gradients, and the inverse problem
#
# Every filter of jaxblur is a differentiable function of color, depth, velocity and its parameters.
# This notebook first shows gradient images, then uses gradients to find the motion that explains a
# blurred picture. That problem has more than one solution, and the last section shows where.

# %%
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optax

import jaxblur
from jaxblur import exr, show

# %matplotlib inline
# %config InlineBackend.figure_formats = ["jpeg"]

DATA = Path("../tests/data")
frame = jaxblur.read_frame(DATA / "cube_over_crates_frame_0011.exr", shutter=0.5)
truth = jnp.asarray(exr.read_image(DATA / "cube_over_crates_truth_0011.exr"))
parameters = jaxblur.GuertinParameters(depth_sharpness=10.0)

# %% [markdown]
# ## Gradient images
#
# How would the squared error against the truth change if the velocity or the depth of one pixel
# changed? This needs bilinear fetch: with nearest fetch, a small shift of a tap does not change the
# color that it reads, so that derivative is 0.

# %%
color, truth = frame.color[..., :3], truth[..., :3]
settings = jaxblur.GuertinSettings(
    samples=15, radius=20, fetch="bilinear", tile_choice="own", noise="none"
)


@jax.jit
def blur(velocity, depth):
    return jaxblur.guertin2014(jaxblur.Frame(color, depth, velocity), parameters, settings=settings)


@jax.jit
def error_and_gradients(velocity, depth, wanted):
    def error(velocity, depth):
        return jnp.mean((blur(velocity, depth) - wanted) ** 2)

    return jax.value_and_grad(error, (0, 1))(velocity, depth)


_, (by_velocity, by_depth) = error_and_gradients(frame.velocity, frame.depth, truth)
print("finite:", bool(jnp.isfinite(by_velocity).all() & jnp.isfinite(by_depth).all()))

figure = show.new_figure(11, 3.7)
left, right = figure.subplots(1, 2)
strength = float(np.percentile(np.linalg.norm(np.asarray(by_velocity), axis=-1), 99))
left.imshow(show.velocity_colors(-np.asarray(by_velocity), strength))
left.set_title("downhill direction of each velocity")
largest = float(np.percentile(np.abs(by_depth), 99))
picture = right.imshow(by_depth, cmap="RdBu", vmin=-largest, vmax=largest)
right.set_title("derivative with respect to depth")
figure.colorbar(picture, ax=right)
figure

# %% [markdown]
# Read these images with care. Depth matters only where two surfaces meet within reach of a blur. A few
# pixels of the velocity image stand out: they are the fastest of their tiles. All pixels around them
# use their velocity, and they get the whole derivative of that maximum. Neither image includes the
# effect of a tap that crosses a silhouette: velocity and depth are read at the nearest texel, and
# these jumps have no derivative.

# %% [markdown]
# ## The inverse problem
#
# Given the sharp picture and a blurred one, find the velocities. We make the blurred picture with a
# known field, a pan with some zoom and shear over a flat depth, so that we can measure how well it is
# recovered. The unknown is a grid of 3 x 4 velocities, interpolated over the image: with a free vector
# for every pixel, almost any picture could be explained.

# %%
height, width = frame.depth.shape
flat = jnp.full((height, width), 10.0)
row, column = np.mgrid[:height, :width].astype(np.float32)
known = jnp.stack([4 + 0.05 * (column - width / 2), 0.06 * (column - width / 2)], axis=-1)
target = blur(known, flat)


def spread(grid):
    return jax.image.resize(grid, (height, width, 2), "linear")


def recover(start, steps=80):
    grid = jnp.zeros((3, 4, 2)) + jnp.asarray(start)
    optimizer = optax.adam(optax.cosine_decay_schedule(0.4, steps))
    state, losses = optimizer.init(grid), []
    for _ in range(steps):
        velocity, to_grid = jax.vjp(spread, grid)
        loss, (by_velocity, _) = error_and_gradients(velocity, flat, target)
        losses.append(float(loss))
        change, state = optimizer.update(to_grid(by_velocity)[0], state)
        grid = optax.apply_updates(grid, change)
    return spread(grid), losses


starts = {"start (2, 1)": (2.0, 1.0), "start (-2, -1)": (-2.0, -1.0), "start (0, 0)": (0.0, 0.0)}
found = {name: recover(start) for name, start in starts.items()}
lines = {name: (range(len(losses)), losses) for name, (_, losses) in found.items()}
show.curves(lines, x="step", y="mean squared error", log="y")

# %%
figure = show.new_figure(12, 2.6)
fields = {"known": known} | {name: velocity for name, (velocity, _) in found.items()}
for (name, velocity), axes in zip(fields.items(), figure.subplots(1, 4), strict=True):
    axes.imshow(show.velocity_colors(velocity, 9.0))
    axes.set_title(name)
    axes.set(xticks=[], yticks=[])
    difference, opposed = (
        float(jnp.median(jnp.linalg.norm(velocity - sign * known, axis=-1))) for sign in (1, -1)
    )
    print(f"{name:15} median distance: {difference:5.2f} px to the known field, {opposed:5.2f} px")
    print(f"{'':15} to its negative")
figure

# %% [markdown]
# ## Where it is ambiguous
#
# - **The sign.** `v` and `-v` leave the same streak. From a start with the opposite sign, the descent
#   finds the negative field with the same loss. One picture cannot distinguish the two.
# - **The start.** From zero velocity nothing is found: pixels whose neighborhood moves by half a pixel
#   or less are returned unchanged, so the derivative there is exactly 0. Start with some motion.
# - **Flat color.** Where the picture does not change along the motion, blur does not change it, and the
#   loss does not depend on the velocity. In such places the grid interpolates from their surroundings.
#   The left map below shows how much the picture depends on the velocity at each place.

# %%
velocity = found["start (2, 1)"][0]
seen = jnp.sum((blur(1.05 * velocity, flat) - blur(0.95 * velocity, flat)) ** 2, axis=-1)
figure = show.new_figure(10, 3.4)
left, right = figure.subplots(1, 2)
left.imshow(np.log10(np.asarray(seen) + 1e-9), cmap="magma")
left.set_title("change of the picture by 10 % of the blur (log)")
distance = jnp.linalg.norm(velocity - known, axis=-1)
right.imshow(distance, cmap="magma")
right.set_title(f"error of the recovered field, up to {float(distance.max()):.1f} px")
figure

# %% [markdown]
# All of this used the right model: the target was made by the same filter over one flat depth. On a
# photograph, the error of the filter itself is larger than the last digits of such a fit, occlusion
# makes the loss jump, and where several layers overlap, no single velocity explains a pixel.
