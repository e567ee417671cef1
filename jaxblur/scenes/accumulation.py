"""Ground truth: the mean of sharp renders over the exposure [Korein and Badler 1983]."""

import numpy as np
from jaxtyping import Array, Float

from .exposure import integrate, make_exposure
from .lens import ThinLens
from .rendering import check_exposure
from .scene import Scene
from .shutter import ShutterFunction, exposure_center, exposure_positions, shutter_curve


def accumulate(
    scene: Scene,
    time: float = 0.0,
    shutter: float = 0.5,
    samples: int = 256,
    size: tuple[int, int] = (180, 320),
    shutter_function: ShutterFunction = "box",
    *,
    placement: str = "centered",
    readout: float = 0.0,
    lens: ThinLens | None = None,
) -> Float[Array, "height width 3"]:
    """Render the true motion-blurred image.

    The mean of `samples` sharp images with one ray per pixel. The light that the shutter lets
    through is divided into one equal share per sample; sample i is taken in the middle of share i,
    and its ray passes through point i of the R2 sequence in the pixel, which antialiases the
    result. Samples are accumulated one at a time, so memory does not depend on their number.

    A rolling shutter exposes the rows one after the other: the row at height y (0 top, 1 bottom) is
    exposed ``readout (y - 1/2)`` frames later. All rows share the sharp images, weighted by each
    row's own shutter curve, so ``1 + |readout|/shutter`` times as many are rendered.

    Args:
        scene: scene to render.
        time: frames.
        shutter: exposure time in frames; 0 gives the sharp image.
        samples: number of sharp images averaged in each row.
        size: (height, width) in pixels.
        shutter_function: "box", "trapezoid", "triangle", "gaussian" or a sampled curve; see
            `shutter_curve`.
        placement: "centered" (the exposure is centered on `time`, as for frames), "leading" (the
            shutter opens at `time`) or "trailing" (it closes at `time`).
        readout: frames from the exposure of the top edge of the image to that of the bottom edge;
            negative rolls upward, 0 is a global shutter.
        lens: a lens, or None for a pinhole. Sample i passes through point i of the lens, so that
            the mean is over time, pixel and lens at once.

    Returns:
        (H, W, 3) linear light, float32.

    Raises:
        ValueError: an argument is out of range, or a rolling shutter has no exposure time.

    Source: Korein and Badler 1983; shutter models after Navarro 2012, section 4.3.8.
    """
    check_exposure(shutter, size)
    if samples < 1:
        raise ValueError(f"`samples` must be at least 1, got {samples}.")
    if lens is not None and not isinstance(lens, ThinLens):
        raise ValueError(
            f"`lens` must be a jaxblur.scenes.ThinLens, got {type(lens).__name__}; pass "
            "jaxblur.scenes.ThinLens(...)."
        )
    if readout and not shutter:
        raise ValueError("`shutter` must be positive where `readout` is not 0, got 0.")
    center = exposure_center(time, shutter, placement)
    curve = shutter_curve(shutter_function)
    if readout:
        count = int(np.ceil(samples * (1 + abs(readout) / shutter)))
        position = (np.arange(count) + 0.5) / count - 0.5
        times = center + (shutter + abs(readout)) * position
    else:
        times = center + shutter * exposure_positions(curve, samples)
    exposure = make_exposure(
        times, curve=curve, center=center, shutter=shutter, readout=readout, lens=lens
    )
    return integrate(scene, exposure, size)
