"""The luma plane that tells FXAA which pixels `guertin2014` blurs [Guertin et al. 2014, 3.4.5]."""

import functools

import jax
import jax.numpy as jnp

from ..frame import Frame
from ..kernels import At, Outcome, each_pixel
from ..noise import Noise
from ..safe_math import safe_norm
from ..settings import GuertinSettings, Settings, checked_settings
from ._arguments import checked_inputs, takes
from ._weights import SPEED_FLOOR
from .guertin2014 import Images, Scalars, prepare_images, read_tile
from .parameters import GuertinParameters
from .tiles import chances_of_tiles

REC709_LUMA = (0.2126, 0.7152, 0.0722)


def hint_pixel(at: At, images: Images, scalars: Scalars, settings: GuertinSettings) -> Outcome:
    """Pass 11: ``(x + y) & 1`` where the pixel may be blurred, its luma elsewhere."""
    choices = [scalars.choice]
    if settings.tile_choice == "expected":
        choices = [jnp.float32(k) for k in range(3)]
        chances = chances_of_tiles(at, scalars.tau, settings.radius, images.dominant)
    else:
        chances = [jnp.float32(1)]
    blurred = jnp.zeros((), bool)
    for choice, chance in zip(choices, chances, strict=True):
        tile = read_tile(at, images, scalars._replace(choice=choice), settings)
        moves = safe_norm(*images.dominant.read_inside(*tile)) > SPEED_FLOOR
        blurred = blurred | (moves & (chance > 0))
    color = images.color.here()
    weights = REC709_LUMA if len(color) >= 3 else (1.0,)
    luma = sum(w * c for w, c in zip(weights, color[: len(weights)], strict=True))
    checker = ((at.row + at.column) % 2).astype(images.color.here()[0].dtype)
    return Outcome((jnp.where(blurred, checker, luma),))


@takes(GuertinParameters, GuertinSettings)
def luma_hint(
    frame: Frame,
    parameters: GuertinParameters,
    *,
    settings: Settings = GuertinSettings(),
    noise: Noise | None = None,
) -> jax.Array:
    """Luma plane for FXAA that marks every blurred pixel as an edge (pass 11).

    ``(x + y) & 1`` where `guertin2014` blurs, the luma of the color elsewhere: the antialiasing
    then smooths the noise that the samples left, and nothing else.

    Source: Guertin et al. 2014, section 3.4.5; luma is that of Rec. 709, or the first channel of
    an image with fewer than three.

    Args:
        frame: as `guertin2014`.
        parameters: as `guertin2014`.
        settings: as `guertin2014`.
        noise: as `guertin2014`.

    Returns:
        (H, W): 0 or 1 at blurred pixels, linear luma elsewhere.

    Raises:
        ValueError: as `guertin2014`.
    """
    return _hint(
        frame,
        parameters,
        noise,
        settings=checked_settings(settings, GuertinSettings, "guertin2014"),
    )


@functools.partial(jax.jit, static_argnames=("settings",))
def _hint(
    frame: Frame,
    parameters: GuertinParameters,
    noise: Noise | None,
    settings: GuertinSettings,
) -> jax.Array:
    frame, parameters = checked_inputs(frame, parameters, GuertinParameters)
    height, width = frame.depth.shape
    images, scalars = prepare_images(frame, settings, noise), Scalars.of(parameters, settings)
    hint = each_pixel(
        hint_pixel, (height, width), images, scalars, settings, backend=settings.backend
    )
    return hint[..., 0]
