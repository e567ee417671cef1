# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Gradients: motion from a blurred picture
#
# Every filter of jaxblur is a differentiable function of color, depth, motion and its parameters. So a
# descent can find the motion that explains a blurred picture: the path of a camera, or the velocity of
# an object. The blurred pictures here are true ones, not made by the filter.
# [Experiment 014](../experiments/014_inverse/README.md) does the same at full size, and compares.

# %%
import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optax

import jaxblur
from jaxblur import exr, metrics, scenes, show

# %matplotlib inline
# %config InlineBackend.figure_formats = ["jpeg"]

DATA = Path("../tests/data")
frame = jaxblur.read_frame(DATA / "cube_over_crates_frame_0011.exr", shutter=0.5)
color, depth = frame.color[..., :3], frame.depth
truth = jnp.asarray(exr.read_image(DATA / "cube_over_crates_truth_0011.exr"))[..., :3]
settings = jaxblur.Settings(samples=15, radius=40, fetch="bilinear")


def blur(color, depth, path):
    frame = jaxblur.Frame.from_motion(color, depth, path=path)
    return jaxblur.layered(frame, jaxblur.LayeredParameters(), settings=settings)


def error(image, truth):
    """Close to the mean absolute difference: what no motion explains counts little."""
    return jnp.mean(jnp.sqrt((image - truth) ** 2 + 1e-6))


# %% [markdown]
# `Frame.from_motion` takes one source of motion: a path (the displacement at shutter opening and at
# closing), a velocity, or the twist of a camera (its rotation and its translation during the exposure),
# and its derivative reaches every filter.
#
# ## Gradient images
#
# How would the error against the truth change if the motion or the depth of one pixel changed? Only
# the cube moves. At its silhouette the derivative includes what happens when it covers more or less of
# the crates. In the left picture hue shows the direction in which the velocity of the pixel should
# change, and saturation how much it matters; a single pixel says little, their sum moves the cube.

# %%
path = jnp.stack([-frame.velocity, frame.velocity], axis=2)
by_path, by_depth = jax.jit(jax.grad(lambda p, d: error(blur(color, d, p), truth), (0, 1)))(
    path, depth
)
by_velocity = np.asarray(by_path[..., 1, :] - by_path[..., 0, :])
print("finite:", bool(np.isfinite(by_velocity).all() & jnp.isfinite(by_depth).all()))

figure = show.new_figure(11, 3.7)
left, right = figure.subplots(1, 2)
strength = float(np.percentile(np.linalg.norm(by_velocity, axis=-1), 99))
left.imshow(show.velocity_colors(-by_velocity, strength))
left.set_title("downhill direction of each velocity")
largest = float(np.percentile(np.abs(by_depth), 99))
picture = right.imshow(by_depth, cmap="RdBu", vmin=-largest, vmax=largest)
right.set_title("derivative with respect to depth")
figure.colorbar(picture, ax=right)
figure

# %% [markdown]
# ## An object: two numbers
#
# The cube's velocity is unknown; where the cube is, we take from the file. The descent begins with one
# component 40 % too large and the other 40 % too small. The curve shows the error of the flow (the motion
# of each pixel), against the 0.3 pixels that experiment 014 asks for. One velocity for the whole cube is
# a simplification: it turns a little while it flies, so the descent passes the median velocity and ends
# where the picture fits best.


# %%
def descend(color, depth, truth, path_of, start, rate, steps=50):
    """Adam; the unknowns before each step and at the end, and the losses."""
    optimizer = optax.adam(optax.cosine_decay_schedule(rate, steps))

    @jax.jit
    def step(unknowns, state):
        loss, gradient = jax.value_and_grad(
            lambda unknowns: error(blur(color, depth, path_of(unknowns)), truth)
        )(unknowns)
        change, state = optimizer.update(gradient, state)
        return optax.apply_updates(unknowns, change), state, loss

    track, losses, state = [start], [], optimizer.init(start)
    for _ in range(steps):
        unknowns, state, loss = step(track[-1], state)
        track.append(unknowns)
        losses.append(float(loss))
    return track, losses


def flow_errors(track, path_of, velocity, where):
    """Mean distance of half-spreads from the known ones at each step, pixels."""

    @jax.jit
    def distance(unknowns):
        path = path_of(unknowns)
        apart = jnp.linalg.norm((path[..., 1, :] - path[..., 0, :]) / 2 - velocity, axis=-1)
        return jnp.sum(apart * where) / jnp.sum(where)

    return [float(distance(unknowns)) for unknowns in track]


def show_descent(errors, truth, start, end):
    figure = show.new_figure(12, 5.2)
    upper, lower = figure.subfigures(2, 1)
    show.curves(
        {"": (range(len(errors)), errors)},
        x="step",
        y="error of the flow, px",
        log="y",
        levels={"0.3 px": 0.3},
        axes=upper.subplots(),
    )
    images = {
        "blurred": truth,
        "reblurred, start": start,
        "reblurred, end": end,
        "4 x difference, start": 4 * jnp.abs(start - truth),
        "4 x difference, end": 4 * jnp.abs(end - truth),
    }
    for axes, (name, image) in zip(lower.subplots(1, 5), images.items(), strict=True):
        show.show_pixels(axes, metrics.display(image), name)
    return figure


cube = jnp.linalg.norm(frame.velocity, axis=-1) > 0.5 * jnp.abs(frame.velocity).max()
known = jnp.median(frame.velocity[cube], axis=0)


def cube_path(velocity):
    half = jnp.where(cube[..., None], velocity, 0)
    return jnp.stack([-half, half], axis=2)


start = known * jnp.array([1.4, 0.6])
track, _ = descend(color, depth, truth, cube_path, start, rate=1.0)
errors = flow_errors(track, cube_path, known, cube)
print(f"known {known}, start {start}, found {track[-1]}: {errors[0]:.2f} px to {errors[-1]:.2f} px")
reblurred = jax.jit(lambda v: blur(color, depth, cube_path(v)))
show_descent(errors, truth, reblurred(start), reblurred(track[-1]))

# %% [markdown]
# ## A camera: six numbers
#
# A court of columns, through which a camera turns, rolls and flies while the shutter is open. The truth
# is the mean of 64 images of the scene along the way. `jaxblur.camera_path` gives the motion of a
# static scene for a twist of the camera: three rotations and three translations, in its own axes.

# %%
size = color.shape[:2]
twist = np.array([0.02, -0.035, 0.05, 0.35, -0.12, 0.5], np.float32)
scene = scenes.SCENES["camera_dolly"]()
moving = scenes.twisting(scene.world.camera, twist)
scene = dataclasses.replace(scene, world=dataclasses.replace(scene.world, camera=moving))
court = scenes.render(scene, 0.0, 1.0, size)
court_truth = scenes.accumulate(scene, 0.0, 1.0, 64, size)
camera = jaxblur.Intrinsics.from_field_of_view(62, size)
exact = jaxblur.camera_velocity(court.depth, twist, camera)
print(
    f"vectors of the scene and of the twist: {jnp.abs(exact - court.velocity).max():.4f} px apart"
)

# One unit of each unknown moves the picture by about a pixel.
by_twist = jax.jacfwd(lambda t: jaxblur.camera_velocity(court.depth, t, camera))(twist)
unit = 1 / jnp.sqrt(jnp.mean(jnp.sum(by_twist**2, axis=2), axis=(0, 1)))


def camera_path(unknowns):
    return jaxblur.camera_path(court.depth, unknowns * unit, camera)


start = twist * (1 + 0.4 * jnp.array([1, -1, 1, 1, -1, -1])) / unit
track, losses = descend(court.color, court.depth, court_truth, camera_path, start, rate=0.3)
errors = flow_errors(track, camera_path, exact, jnp.ones(size))
print("found / known:", np.round(track[-1] * unit / twist, 2))
print(f"error of the flow: {errors[0]:.2f} px to {errors[-1]:.2f} px")
reblurred = jax.jit(lambda unknowns: blur(court.color, court.depth, camera_path(unknowns)))
show_descent(errors, court_truth, reblurred(start), reblurred(track[-1]))

# %% [markdown]
# ## Where it is ambiguous
#
# - **The sign.** `v` and `-v` leave the same streak, so a descent from the other side finds the
#   negative motion with the same loss. One picture cannot distinguish the two.
# - **The start.** Pixels whose neighborhood moves by half a pixel or less are returned unchanged, and the
#   derivative there is exactly 0. Start with some motion.
# - **Flat color.** Where the picture does not change along the motion, blur does not change it. And a
#   turn to the side and a step to the side look alike where depths differ little: the single numbers are
#   less certain than the flow.
#
# Left: the loss for multiples of the known twist, the same for both signs. Right: the loss along each
# number alone; the least is within a quarter of a pixel of the known value.

# %%
loss_of = jax.jit(lambda unknowns: error(reblurred(unknowns), court_truth))
shares = np.linspace(-1.4, 1.4, 29)
line = [float(loss_of(share * twist / unit)) for share in shares]
offsets = np.linspace(-1.5, 1.5, 13)
names = ["tilt", "turn", "roll", "right", "down", "forward"]
each = {
    name: (offsets, [float(loss_of(twist / unit + o * np.eye(6)[k])) for o in offsets])
    for k, name in enumerate(names)
}
figure = show.new_figure(11, 3.4)
left, right = figure.subplots(1, 2)
show.curves({"": (shares, line)}, x="share of the known twist", y="loss", axes=left)
show.curves(each, x="change of one number, pixels of flow", y="loss", axes=right)
figure
