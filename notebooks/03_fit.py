# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Fitting the parameters
#
# The published parameters were chosen by eye. If the true blur of some frames is known, gradient
# descent can choose them. Here two frames are fitted, and a third one is held out to see whether the
# fit improves it too.

# %%
from pathlib import Path

import numpy as np

import jaxblur
from jaxblur import exr, show

# %matplotlib inline
# %config InlineBackend.figure_formats = ["jpeg"]

DATA = Path("../tests/data")
NAMES = ("cube_over_crates", "falling_cubes", "sky_car")
HELD_OUT = 2


def pair(name):
    frame = jaxblur.read_frame(DATA / f"{name}_frame_0011.exr", shutter=0.5)
    return frame, exr.read_image(DATA / f"{name}_truth_0011.exr")


pairs = [pair(name) for name in NAMES]
settings = jaxblur.Settings(samples=11, radius=20)

# %% [markdown]
# ## The fit
#
# `fit` minimizes the error of the filter with exactly these settings. With the stochastic tile choice
# that is the expected error over all tiles that a pixel may read. `mask="moving"` counts only pixels
# that motion reaches; `pixel="display"` measures the error on display values, as a viewer sees them.
# Two parameters and 12 steps keep this notebook fast; the default is 100 steps.

# %%
result = jaxblur.fit(
    "guertin2014",
    pairs,
    free=("kappa", "depth_sharpness"),
    pixel="display",
    mask="moving",
    settings=settings,
    steps=12,
    holdout=(HELD_OUT,),
    names=NAMES,
)
print(result.minimized)
for name in result.free:
    print(
        f"{name:16} published {result.published[name]:6.2f}  fitted {result.parameters[name]:8.2f}"
    )

# %% [markdown]
# ## Curves
#
# The fit does not start at the published values: a coarse scan finds a good start first. Each step
# draws new noise, so the loss need not fall at every step; note the small range of its axis.

# %%
figure = show.new_figure(10, 3.2)
left, right = figure.subplots(1, 2)
history = {name: (range(result.steps), values) for name, values in result.history.items()}
show.curves({"": history["loss"]}, x="step", y="loss", axes=left)
relative = {
    name: (history[name][0], np.divide(history[name][1], result.published[name]))
    for name in result.free
}
show.curves(relative, x="step", y="value / published", log="y", axes=right)
figure

# %% [markdown]
# ## Held out
#
# The score that matters is that of the frame that was not fitted.

# %%
for part in ("train", "held-out"):
    for label in ("published", "fitted"):
        psnr, flip = (result.mean_score(f, part, label, "moving") for f in ("psnr", "flip"))
        print(f"{part:9} {label:10} PSNR {psnr:5.2f} dB, FLIP {flip:.4f}, where something moves")

# %% [markdown]
# A gain on the training frames without a gain on the held-out frame would be overfitting. Three frames
# prove nothing: experiment 006 leaves out each of six scenes in turn, and has confidence intervals.

# %% [markdown]
# ## Do the frames determine the parameters?
#
# The profile of a parameter is the loss as a function of it, with the others fixed. A flat profile
# means that the frames do not determine the value, however many digits the fit prints.

# %%
training = [p for index, p in enumerate(pairs) if index != HELD_OUT]
around = result.parameters["kappa"] * np.geomspace(1 / 8, 8, 7)
profile = jaxblur.fitting.profile(result, training, "kappa", values=around, mask="moving")
show.curves(
    {"": (profile.values, profile.losses)},
    x="kappa",
    y="loss",
    log="x",
    marks={"fitted": profile.fitted, "published": result.published["kappa"]},
)

# %% [markdown]
# The same question in numbers: standard errors, and a warning for each parameter that the frames do
# not determine.

# %%
sensitivity = result.sensitivity
for name, error in zip(sensitivity.names, sensitivity.relative_error, strict=True):
    print(f"{name:16} ± {100 * error:.0f} %")
print(*sensitivity.flags, sep="\n")

# %% [markdown]
# ## Before and after, on the held-out frame

# %%
frame, truth = pairs[HELD_OUT]
fitted = jaxblur.guertin2014(frame, result.filter_parameters, settings=settings)
show.before_after(frame.color, fitted, truth, name="fitted", limit=0.4)

# %% [markdown]
# `result.save("fitted.toml")` saves parameters, scores, settings and versions;
# `jaxblur blur beauty.exr -o blurred.exr --parameters fitted.toml` uses the file.
