"""Numbers of ColorVideoVDP: parameters calibrated by its authors, and the table of sensitivity.

They stand in ``model.json``, data of the package cvvdp 0.5.7 under the MIT license (``LICENSE``).
Parameters have the names of that package, and the symbols of the paper where it has one.

Channels are in the order achromatic sustained, red-green, yellow-violet, achromatic transient. A
single image has no transient channel.

Source: Mantiuk, Hanji, Ashraf, Asano, Chapiro 2024, "ColorVideoVDP: a visual difference predictor
for image, video and display distortions"; sensitivity: Ashraf, Mantiuk, Chapiro, Wuerger 2024,
"castleCSF - a contrast sensitivity function of color, area, spatiotemporal frequency, luminance and
eccentricity".
"""

import dataclasses
import functools
import json
import pathlib

import numpy as np


@dataclasses.dataclass(frozen=True, eq=False)
class Parameters:
    """Calibrated parameters.

    Attributes:
        mask_p: exponent p of the difference.
        mask_c: log10 of the weight of the masking contrast.
        mask_q: (4,) exponents q of the masking contrast by channel.
        pu_dilate: standard deviation of the blur of the masking contrast, pixels of a band.
        xcm_weights: (4, 4) log2 of how much channel ``row`` masks channel ``column``.
        d_max: log10 of the difference at which the soft clamp saturates.
        beta: exponent of the sum over pixels.
        beta_t: exponent of the sum over frames.
        beta_tch: exponent of the sum over channels.
        beta_sch: exponent of the sum over bands.
        sensitivity_correction: of the contrast sensitivity, dB.
        jod_a: factor from difference to JOD.
        jod_exp: exponent from difference to JOD.
        image_int: factor of the difference of single images.
        ch_chrom_w: weight of red-green and yellow-violet.
        ch_trans_w: weight of the transient channel.
        baseband_weight: (4,) weights of the coarsest band by channel.
        sigma_tf: (4,) widths of the temporal filters in the frequency domain.
        beta_tf: (4,) exponents of the temporal filters.
    """

    mask_p: float
    mask_c: float
    mask_q: np.ndarray
    pu_dilate: float
    xcm_weights: np.ndarray
    d_max: float
    beta: float
    beta_t: float
    beta_tch: float
    beta_sch: float
    sensitivity_correction: float
    jod_a: float
    jod_exp: float
    image_int: float
    ch_chrom_w: float
    ch_trans_w: float
    baseband_weight: np.ndarray
    sigma_tf: np.ndarray
    beta_tf: np.ndarray


@dataclasses.dataclass(frozen=True, eq=False)
class SensitivityTable:
    """Contrast sensitivity (castleCSF) of a patch of fixed size.

    Attributes:
        luminance: (L,) cd/m2, uniform in the logarithm.
        frequency: (R,) cycles per degree, uniform in the logarithm.
        log10_sensitivity: (4, L, R) by channel, luminance and frequency.
    """

    luminance: np.ndarray
    frequency: np.ndarray
    log10_sensitivity: np.ndarray


CHANNELS = ("achromatic_sustained", "red_green", "yellow_violet", "achromatic_transient")


@functools.cache
def parameters() -> Parameters:
    """Load the calibrated parameters."""
    values = _data()["parameters"]
    arrays = {name: np.array(v) for name, v in values.items() if isinstance(v, list)}
    arrays["xcm_weights"] = arrays["xcm_weights"].reshape(4, 4)
    return Parameters(**(values | arrays))


@functools.cache
def sensitivity_table() -> SensitivityTable:
    """Load the table of contrast sensitivity."""
    values = _data()["sensitivity"]
    return SensitivityTable(
        np.array(values["luminance"]),
        np.array(values["frequency"]),
        np.array([values[name] for name in CHANNELS]),
    )


def _data() -> dict:
    return json.loads(pathlib.Path(__file__).with_name("model.json").read_text(encoding="utf-8"))
