"""Claims about motion paths [Hong and Oh 2017] and about shutters [Navarro 2012]."""

import jax.numpy as jnp
import numpy as np

import jaxblur
from jaxblur import scenes
from jaxblur.shutter import curve_of

from . import claim
from .claim import AGREES, DIFFERS, NOT_COMPARABLE, Extent, Row, blur, example

CUBES = (130, 2000)
"""With 130 cubes our scene has about the intervals per pixel that theirs has with 1000."""


def intervals(extent: Extent) -> Row:
    """Hong 4.1: 90 intervals per pixel give plausible images."""
    found = {}
    for cubes in CUBES:
        scene = scenes.SCENES["random_cubes"](n=cubes)
        _, counted = scenes.motion_paths(scene, 0.0, 0.5, extent.small, with_statistics=True)
        found[cubes] = {
            "per pixel": counted.intervals_per_pixel,
            "longest list": counted.longest_list,
            "cut": counted.overflowing,
        }
    cut = sum(values["cut"] for values in found.values())
    ours = "; ".join(
        f"{cubes} cubes: {values['per pixel']:.1f} a pixel, longest list {values['longest list']}"
        for cubes, values in found.items()
    )
    return Row(
        claim="90 intervals per pixel are enough in practice",
        source="Hong and Oh 2017, 4.1, figure 15",
        tested=f"`random_cubes`, shutter 1/2, {extent.small[1]}x{extent.small[0]}: mean and "
        "longest list of intervals, at their density and at their largest number of cubes",
        theirs="plausible images; 1.67 a pixel with 1000 cubes, 3.39 with 2000",
        ours=f"{ours}; {cut} lists cut",
        verdict=AGREES if cut == 0 else DIFFERS,
        measured={str(cubes): values for cubes, values in found.items()},
    )


def texture_reads(extent: Extent) -> Row:
    """Hong 4.4: 16 texture samples are enough."""
    truth = example("uniform_pan", extent.size, 1.0, 4 * extent.truth_samples)
    scene = scenes.SCENES["uniform_pan"]()
    found = {}
    for reads in (4, 16, 64):
        image = scenes.motion_paths(scene, 0.0, 1.0, extent.size, texture_samples=reads)
        found[reads] = claim.psnr(image, truth)
    gain = found[64] - found[16]
    return Row(
        claim="16 texture reads are enough against too much blur",
        source="Hong and Oh 2017, 4.4",
        tested="`uniform_pan`, PSNR of `motion_paths` where it moves, by texture reads",
        theirs="sufficient",
        ours=f"{claim.listed(found)} dB",
        verdict=AGREES if gain < 0.5 else DIFFERS,
        measured=found,
    )


def followed(extent: Extent, curve: np.ndarray) -> dict[str, float]:
    """PSNR of `layered` on `gears` under a curve of the shutter, with a box and with the curve."""
    scene = scenes.SCENES["gears"]()
    truth = scenes.accumulate(
        scene, 0.0, 1.0, extent.truth_samples, extent.size, shutter_function=curve
    )
    frame = scenes.render(scene, 0.0, 1.0, extent.size)
    one = claim.Example("gears", "turning", frame, truth)
    shutter = jaxblur.Shutter(curve=jnp.asarray(curve))
    info = jaxblur.filters.filter_info("layered")
    image = jaxblur.layered(frame, info.make_parameters(), settings=info.settings, exposure=shutter)
    return {"box": claim.psnr(blur("layered", frame), one), "the curve": claim.psnr(image, one)}


def late_weights(extent: Extent) -> Row:
    """Navarro 4.3.2, figure 4.2: Korein and Badler's filter that emphasizes later movement."""
    # The weight rises from 0 at opening to its largest at closing.
    found = followed(extent, np.linspace(0.0, 1.0, 9))
    gain = found["the curve"] - found["box"]
    return Row(
        claim="a filter over time that emphasizes later movement (Korein and Badler)",
        source="Navarro 2012, 4.3.2, figure 4.2",
        tested="`gears`, weights that rise over the exposure, in the truth and in `layered`: PSNR "
        "where it moves, with a box and with the curve",
        theirs="a picture, no number",
        ours=f"{found['box']:.1f} dB with a box, {found['the curve']:.1f} dB with the curve",
        verdict=f"{NOT_COMPARABLE}: no number; `layered` follows the curve, {gain:+.1f} dB",
        measured=found,
    )


def shutter_efficiency(extent: Extent) -> Row:
    """Navarro 4.1, 4.3.8: a shutter takes time to open, so that it is less than fully efficient."""
    found = {}
    for name in ("trapezoid", "triangle", "gaussian"):
        curve = curve_of(name)
        # The mean of a curve between its points, over its largest value.
        mean = float(np.trapezoid(curve) / (len(curve) - 1))
        found[name] = followed(extent, curve) | {"efficiency": mean / float(curve.max())}
    loss = max(values["the curve"] - values["box"] for values in found.values())
    ours = "; ".join(
        f"{name}: {100 * values['efficiency']:.0f} %, {values['box']:.1f} dB with a box, "
        f"{values['the curve']:.1f} with the curve"
        for name, values in found.items()
    )
    return Row(
        claim="a shutter that takes time to open and close has an efficiency and an uneven blur",
        source="Navarro 2012, 4.1 and 4.3.8",
        tested="`gears`, three curves: the light that comes in as a share of that of a shutter "
        "which is open all the time; PSNR of `layered` where it moves",
        theirs="no number",
        ours=ours,
        verdict=f"{NOT_COMPARABLE}: no number; a box in place of the curve loses up to {loss:.1f} "
        "dB",
        measured=found,
    )


CLAIMS = (
    intervals,
    texture_reads,
    late_weights,
    shutter_efficiency,
)
