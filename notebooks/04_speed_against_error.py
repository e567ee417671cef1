# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Speed against error
#
# More taps cost more time. Which settings are worth their time? The picture below is small, and its
# times are those of the machine that ran the notebook, which may have been busy: read the shape of the
# curve, not the numbers. For reliable numbers see `jaxblur bench` and the experiments.

# %%
import time
from pathlib import Path

import jax
import numpy as np

import jaxblur
from jaxblur import exr, metrics, show
from jaxblur.filters import filter_info

# %matplotlib inline
# %config InlineBackend.figure_formats = ["jpeg"]

DATA = Path("../tests/data")
frame = jaxblur.read_frame(DATA / "cube_over_crates_frame_0011.exr", shutter=0.5)
truth = exr.read_image(DATA / "cube_over_crates_truth_0011.exr")

# %% [markdown]
# ## Measure
#
# Compilation is not counted: the first call compiles. The result is the shortest of several further
# calls, because other load on the machine only makes calls longer.

# %%
ROUNDS = 7
STARS = ("guertin2014", "mcguire2012")  # their defaults are the published values
PARAMETERS = jaxblur.GuertinParameters(depth_sharpness=10.0)


def milliseconds(function):
    jax.block_until_ready(function())
    times = []
    for _ in range(ROUNDS):
        started = time.perf_counter()
        jax.block_until_ready(function())
        times.append(1000 * (time.perf_counter() - started))
    return min(times)


def measure(name, parameters, label, published=False, **settings):
    chosen = filter_info(name).make_settings(**settings)

    def run():
        return jaxblur.FILTERS[name](frame, parameters, settings=chosen)

    error = metrics.compare(run(), truth).flip
    return show.Measurement(label, milliseconds(run), error, name, published)


points = [
    measure("guertin2014", PARAMETERS, f"{samples} taps", samples=samples, radius=20)
    for samples in (3, 7, 15, 35)
]
points += [
    measure("pixel_velocity", None, f"{samples} taps", samples=samples, radius=20)
    for samples in (5, 15)
]
points += [
    measure(
        info.name, info.make_parameters(), "defaults", info.name in STARS, **vars(info.settings)
    )
    for info in map(filter_info, jaxblur.FILTERS)
]
show.pareto(points, time_label="milliseconds, 160 x 112 pixels", labels="all")

# %% [markdown]
# The gray line is the Pareto front: no setting is both faster and better than a point on it. Two
# properties of such pictures matter. The error levels off: beyond some number of taps it has causes
# that more taps do not remove. And FLIP is a mean over the frame: `pixel_velocity` can score well and
# still cut off the blur at the outline of a moving object, which a viewer sees at once.

# %%
for point in show.pareto_front(points):
    print(f"{point.group:15} {point.label:14} {point.time:6.2f} ms  FLIP {point.error:.4f}")

# %% [markdown]
# ## Compare the pictures
#
# With three taps the blur is grainy. `pixel_velocity` looks smooth, but its cube ends where the sharp
# cube ends: a pixel of the wall has no velocity, so the cube never blurs over it.

# %%
images = {
    f"guertin2014, {samples} taps": jaxblur.guertin2014(
        frame, PARAMETERS, settings=jaxblur.Settings(samples=samples, radius=20)
    )
    for samples in (3, 35)
}
plain = jaxblur.pixel_velocity(frame, None, settings=jaxblur.Settings(samples=15, radius=20))
show.image_grid(images | {"pixel_velocity, 15 taps": plain, "truth": truth}, columns=4, width=12)

# %% [markdown]
# ## Let the frame choose
#
# `plan` reads the speeds, angles and depth layers of a frame, and chooses the fastest filter whose
# expected error is within a tolerance of that of `layered`. It prints its reason and the expected loss.

# %%
planned = jaxblur.plan(frame, tolerance_db=0.5)
print(planned.reason)
result = jaxblur.FILTERS[planned.filter](frame, planned.parameters, settings=planned.settings)
full = jaxblur.layered(frame, jaxblur.LayeredParameters())
for name, image in {"planned": result, "full filter": full}.items():
    print(f"{name:12} PSNR {metrics.compare(image, truth).psnr:.2f} dB")

# %% [markdown]
# A radius above the largest speed only makes tiles larger. `jaxblur blur --radius auto` takes the
# radius from the frame, and so does this cell:

# %%
print(jaxblur.vectors.speed_statistics(np.asarray(frame.velocity)).suggested_radius, "px")
