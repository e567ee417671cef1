"""Metrics of images and clips with explicit conventions: PSNR, SSIM, FLIP, ColorVideoVDP, ...

Imports nothing of jaxblur but `frame` and `srgb`.

All numbers that this project reports use one display transform, `display`: keep RGB, apply
the exact sRGB curve, clip to [0, 1]; the peak is 1. `compare` applies it to linear images.
`cvvdp` takes linear light and has its own displays. The other functions take images as they
are, so that they can also be used as losses. All except `flip` are differentiable JAX
functions whose derivatives stay finite where two images agree.

``mask`` is an (H, W) array of booleans that limits a mean to some pixels. An empty mask gives NaN,
except in `compare`, which raises an error.
"""

from .color_video_vdp import (
    DISPLAYS as DISPLAYS,
    Display as Display,
    cvvdp as cvvdp,
    find_display as find_display,
    nits_display as nits_display,
    pixels_per_degree as pixels_per_degree,
    pq_display as pq_display,
    white_display as white_display,
)
from .comparison import Scores as Scores, compare as compare
from .errors import (
    RELATIVE_FLOOR as RELATIVE_FLOOR,
    mse as mse,
    psnr as psnr,
    relative_mse as relative_mse,
    smape as smape,
    temporal_difference_error as temporal_difference_error,
)
from .footprint import motion_footprint as motion_footprint
from .images import Image as Image, Mask as Mask, display as display, rgb as rgb
from .structure import SSIM_SIGMA as SSIM_SIGMA, SSIM_WINDOW as SSIM_WINDOW, ssim as ssim
from .visibility import flip as flip, flip_map as flip_map
