# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # A photograph, with painted depth and velocity
#
# The filters need no renderer. Depth tells who is in front, velocity what moves; for a photograph both can be
# painted, coarsely, as McGuire et al. did for the pool balls of their figure 12. The picture here is the official
# portrait of Commodore Grace Hopper (US Navy, public domain), which comes with matplotlib.

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from matplotlib import cbook, path

import jaxblur
from jaxblur import srgb

# %matplotlib inline
# %config InlineBackend.figure_formats = ["jpeg"]

with cbook.get_sample_data("grace_hopper.jpg") as file:
    photograph = plt.imread(file, format="jpg")
color = srgb.decode(photograph.astype(np.float32) / 255)
height, width = color.shape[:2]


def look(*images, titles=()):
    _, axes = plt.subplots(1, len(images), figsize=(3.6 * len(images), 4.2), squeeze=False)
    for axis, image, title in zip(axes[0], images, [*titles, *[""] * len(images)], strict=False):
        axis.imshow(np.clip(image, 0, 1))
        axis.set_title(title)
        axis.axis("off")
    plt.tight_layout()
    plt.show()


# %% [markdown]
# ## Depth: an outline
#
# Thirty points around the figure are enough. She is at a distance of 2, the flag at 4. Only the order counts, and
# that they differ by more than a few percent.

# %%
outline = [
    *((148, 150), (148, 105), (152, 90), (175, 82), (178, 60), (202, 42), (235, 25), (272, 25)),
    *((303, 40), (342, 64), (353, 88), (368, 94), (371, 125), (366, 165), (376, 195), (372, 228)),
    *((360, 265), (349, 300), (333, 310), (333, 320), (352, 336), (382, 346), (490, 388)),
    *((513, 440), (513, 601), (8, 601), (30, 450), (50, 385), (112, 367), (180, 345)),
    *((204, 315), (195, 298), (170, 288), (153, 215), (158, 172)),
]
row, column = np.mgrid[:height, :width] + 0.5
points = np.stack([column.ravel(), row.ravel()], axis=-1)
figure = path.Path(outline).contains_points(points).reshape(height, width)
depth = np.where(figure, 2.0, 4.0).astype(np.float32)
still = jaxblur.Frame(color, depth, np.zeros((height, width, 2), np.float32))
shown = np.repeat(1 / depth[..., None] / 0.6, 3, axis=-1)
look(srgb.encode(color), shown, titles=("photograph", "painted depth, near is bright"))

# %% [markdown]
# ## Velocity: who moves
#
# `add_velocity` puts a velocity where a mask is. If the camera follows the commodore, what is behind her moves; if she
# walks past, she does. In both cases nothing of one side smears into the other.


# %%
def blurred(frame):
    return srgb.encode(np.asarray(jaxblur.layered(frame, jaxblur.LayeredParameters())))


followed = jaxblur.add_velocity(still, (18.0, 0.0), ~figure)
passing = jaxblur.add_velocity(still, (12.0, 2.0), figure)
look(blurred(followed), blurred(passing), titles=("followed by the camera", "walking past"))

# %% [markdown]
# ## A brush
#
# A stroke has places, a width and a velocity along it. Strokes add up, so that a flag can be set waving, and a hat be
# tipped.


# %%
def stroke(frame, places, radius, speed, mask=1.0):
    """Paint velocity along a line through some places, fading out at its sides."""
    for k in range(len(places) - 1):
        (x0, y0), (x1, y1) = places[k : k + 2]
        along = np.array([x1 - x0, y1 - y0], float)
        length = np.hypot(*along)
        share = np.clip(((column - x0) * along[0] + (row - y0) * along[1]) / length**2, 0, 1)
        away = np.hypot(column - x0 - share * along[0], row - y0 - share * along[1])
        frame = jaxblur.add_velocity(
            frame, speed * along / length, mask * np.exp(-((away / radius) ** 4))
        )
    return frame


waving = stroke(still, [(10, 40), (110, 170)], 70, 16.0, ~figure)
waving = stroke(waving, [(40, 300), (110, 420)], 70, 12.0, ~figure)
hat = figure & (row < 165)
tipped = stroke(still, [(160, 130), (260, 70), (360, 130)], 60, 13.0, hat)
look(blurred(waving), blurred(tipped), titles=("the flag waves", "the hat is tipped"))

# %% [markdown]
# ## Strength
#
# The painted motion is a motion like any other: it can be scaled, limited to what Valve recommends (15 % of the
# frame's time, 4 % of the width), and differentiated, here in the strength of the stroke.

# %%
weaker = jaxblur.scale_motion(waving, 0.4)
limited = jaxblur.within_limits(waving, "valve", shutter=0.5)
for name, frame in (("as painted", waving), ("scaled by 0.4", weaker), ("valve", limited)):
    print(f"{name:14} longest half-spread {float(jnp.abs(frame.velocity).max()):5.1f} px")
look(blurred(weaker), blurred(limited), titles=("scaled by 0.4", "within Valve's limits"))


# %%
def sharpness(strength):
    image = jaxblur.layered(jaxblur.scale_motion(waving, strength), jaxblur.LayeredParameters())
    return jnp.mean(jnp.abs(jnp.diff(image, axis=1)))


value, slope = jax.value_and_grad(sharpness)(0.5)
print(f"sharpness at half strength {float(value):.4f}, its derivative {float(slope):+.5f}")
