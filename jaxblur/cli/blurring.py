"""Blur one frame that was read, and run the posts that follow; for a sequence too."""

import argparse
import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

from jaxblur.filters.registry import filter_info
from jaxblur.settings import Settings, checked_settings

from . import posts, stack
from .arguments import CommandError
from .choice import PASSED_THROUGH, Choice
from .filtering import DEFAULT_FILTER, takes_neighbors
from .loading import Loaded


def blur(chosen: Choice, loaded: Loaded, seed: int | None = None) -> Any:
    """Run the filter; a frame that is passed through is filtered as if nothing moved.

    Neighbors are given to filters that take them.

    Args:
        chosen: what is to be run.
        loaded: the frame.
        seed: moves the noise; None leaves it where it is.

    Returns:
        (H, W, C) NumPy array.
    """
    import numpy as np

    buffers = loaded.buffers
    if chosen.name == PASSED_THROUGH:
        still = np.zeros_like(buffers.velocity)
        buffers = dataclasses.replace(buffers, velocity=still, path=None)
        if loaded.lens is None:
            return apply_filter("pixel_velocity", buffers, {}, chosen.settings)
        noise = noise_of(chosen.settings, seed, loaded)
        more = {"lens": loaded.lens}
        return apply_filter(DEFAULT_FILTER, buffers, {}, chosen.settings, noise, more)
    if loaded.layers:
        return _blur_layers(chosen, loaded, seed)
    noise = noise_of(chosen.settings, seed, loaded)
    more: dict[str, Any] = {}
    if loaded.neighbors and takes_neighbors(chosen.name):
        given = {side: source.buffers.frame() for side, source in loaded.neighbors.items()}
        more = {**given, "shutter": loaded.shutter}
    if loaded.exposure is not None:
        more["exposure"] = loaded.exposure.shutter()
    if loaded.lens is not None:
        more["lens"] = loaded.lens
    return apply_filter(chosen.name, buffers, chosen.parameters, chosen.settings, noise, more)


def _blur_layers(chosen: Choice, loaded: Loaded, seed: int | None) -> Any:
    """Blur layers together; see `blur`."""
    near = {side: source.layers for side, source in loaded.neighbors.items()}
    exposure = loaded.exposure
    return stack.blur(
        loaded.layers,
        near,
        filter_info(chosen.name).make_parameters(**chosen.parameters),
        loaded.buffers.pass_channels,
        settings=chosen.settings,
        noise=noise_of(chosen.settings, seed, loaded),
        shutter=loaded.shutter,
        exposure=None if exposure is None else exposure.shutter(),
    )


def apply_filter(
    name: str,
    buffers: Any,
    parameters: Mapping[str, float],
    settings: Settings,
    noise: Any = None,
    neighbors: Mapping[str, Any] | None = None,
    call: Callable[..., Any] | None = None,
) -> Any:
    """Run a filter.

    Args:
        name: of a registered filter.
        buffers: a `jaxblur.Frame`, or buffers as `read_buffers` gives them.
        parameters: by name; the others take their defaults.
        settings: how to run it; plain `Settings` will do for any filter.
        noise: a `jaxblur.Noise`; None for the built-in one.
        neighbors: further arguments of a filter that takes neighbors: ``before`` and ``after``,
            each a `jaxblur.Frame`, and ``shutter``; ``exposure`` of one that takes a shutter,
            ``lens`` of one that takes a lens.
        call: function with the filter's arguments to run instead of it, such as its hint.

    Returns:
        (H, W, C) NumPy array, or what `call` gives.

    Raises:
        ValueError: the filter gives something else.
    """
    import numpy as np

    from jaxblur.frame import Frame

    info = filter_info(name)
    frame = buffers if isinstance(buffers, Frame) else buffers.frame()
    settings = checked_settings(settings, info.kind, info.name)
    values = info.make_parameters(**parameters)
    function: Any = call or info.call
    image = function(frame, values, settings=settings, noise=noise, **(neighbors or {}))
    size, shape = frame.depth.shape, getattr(image, "shape", None)
    if call is None and (shape is None or len(shape) != 3 or shape[:2] != size):
        given = type(image).__name__ if shape is None else f"an array {shape}"
        raise ValueError(
            f"{info.name} must return an image, an array {(*size, 'channels')} of this frame, got "
            f"{given}; return what jaxblur.kernels.each_pixel gives."
        )
    return np.asarray(image)


def noise_of(settings: Settings, seed: int | None, loaded: Loaded) -> Any:
    """The built-in noise, moved by a seed or along with the surfaces; None where it is not moved.

    It starts at the corner of the display window: what is cropped keeps its grain.

    Args:
        settings: of the filter.
        seed: moves it over the frame; None leaves it where it is.
        loaded: the frame, whose disparity, if it has one, moves it to where the other eye sees it.
    """
    from jaxblur.noise import make_noise, shared_noise

    origin = loaded.buffers.windows.origin
    is_moved = seed is not None or loaded.disparity is not None or origin != (0, 0)
    if settings.noise == "none" or not is_moved:
        return None
    height, width = loaded.buffers.depth.shape
    noise = make_noise(settings.noise, height, width, seed or 0, origin=origin)
    return noise if loaded.disparity is None else shared_noise(noise, loaded.disparity)


def after_blur(
    arguments: argparse.Namespace, chosen: Choice, loaded: Loaded, image: Any, seed: int | None
) -> Any:
    """Run the posts that the arguments name on a blurred frame.

    Args:
        arguments: of the command.
        chosen: what has blurred it.
        loaded: the frame.
        image: (H, W, C) NumPy array, blurred.
        seed: as `blur` was given it.

    Returns:
        (H, W, C) NumPy array.

    Raises:
        CommandError: a post needs depth, and the frame has none; or the hint of another filter.
    """
    buffers = loaded.buffers
    depth = None if buffers.depth_channel is None else buffers.depth

    def hint() -> Any:
        if chosen.name == PASSED_THROUGH:
            # What is not blurred has the luma of its picture.
            return posts.linear_luma(image[..., : buffers.color.shape[2]])
        if chosen.name != posts.HINTING:
            raise CommandError(
                f"--then {posts.HINTED}: {chosen.name} gives no hint; pass --filter "
                f"{posts.HINTING}, or --then fxaa."
            )
        from jaxblur.filters.luma_hint import luma_hint

        noise = noise_of(chosen.settings, seed, loaded)
        return apply_filter(
            chosen.name, buffers, chosen.parameters, chosen.settings, noise, call=luma_hint
        )

    velocity = None if chosen.name == PASSED_THROUGH else buffers.velocity
    windows = buffers.windows
    return posts.apply(arguments, image, depth, buffers.color.shape[2], windows, hint, velocity)
