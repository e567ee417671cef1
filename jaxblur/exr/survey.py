"""Look through files by blocks of rows, so that a large picture needs little memory."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from jaxblur import vectors
from jaxblur._util.errors import JaxblurIOError, PathLike
from jaxblur.nonfinite import not_finite

from .channels import read_blocks
from .checks import warn_lossy
from .choose import choose_color, is_depth
from .convert import half_spread
from .listing import FileInfo, describe
from .opening import open_input

if TYPE_CHECKING:
    from jaxtyping import Float


def count_not_finite(path: PathLike) -> dict[str, int]:
    """Count the pixels with NaN or infinity; infinite depth is sky and does not count.

    Deep parts and integer channels are left out.

    Args:
        path: an image file.

    Returns:
        The number of such pixels by full channel name, 0 included.

    Raises:
        JaxblurIOError: the file is missing or damaged.
    """
    counts: dict[str, int] = {}
    with open_input(path) as source:
        info = describe(source, path)
        for part in info.parts:
            floats = [c for c in part.channels if c.type in ("half", "float")]
            if part.deep or not floats:
                continue
            counts |= dict.fromkeys((channel.name for channel in floats), 0)
            for rows in read_blocks(source, info, floats):
                for position, channel in enumerate(floats):
                    values = rows[..., position]
                    bad = not_finite(values)
                    if is_depth(channel.name):
                        bad &= ~np.isposinf(values)
                    counts[channel.name] += int(np.count_nonzero(bad))
    return counts


def measure_speeds(
    path: PathLike,
    guess: vectors.Guess,
    shutter: float = 0.5,
    radius: float = 40.0,
    *,
    file_shutter: float | None = None,
    max_displace: float | None = None,
    layer: str | None = None,
) -> vectors.SpeedStatistics:
    """Measure the half-spreads of a file as they are; damaged vectors are counted, not rejected.

    Args:
        path: file with the vectors.
        guess: convention and channels of the vectors, as `choose_vectors` finds them.
        shutter: exposure to blur for, frames.
        radius: largest speed that the filter keeps, pixels.
        file_shutter: as in `read_buffers`.
        max_displace: as in `read_buffers`.
        layer: view layer, view or part to search for the alpha of vectors that need one.

    Returns:
        The statistics.

    Raises:
        JaxblurIOError: the file is damaged, a channel is missing, or the convention needs an
            argument that was not given.
    """
    scale = {"max_displace": max_displace, "file_shutter": file_shutter}
    alpha = None
    with open_input(path) as source:
        info = describe(source, path)
        channels = [info.channel(name) for name in guess.channels]
        warn_lossy([(info, name) for name in guess.channels])
        if guess.preset.premultiplied:
            alpha = _alpha(info, layer)
            channels += [info.channel(alpha)] if alpha else []

        def blocks() -> Iterator[Float[np.ndarray, "rows width 2"]]:
            for rows in read_blocks(source, info, channels):
                raw = rows[..., : len(guess.channels)]
                still = np.zeros(rows.shape[:2], bool)
                covered = rows[..., -1] if alpha else None
                yield half_spread(info, guess, raw, still, covered, shutter, scale)[0]

        *_, width, height = info.parts[channels[0].part].data_window
        return vectors.speed_statistics_of_blocks(blocks(), (height, width), radius)


def _alpha(info: FileInfo, layer: str | None) -> str | None:
    try:
        return choose_color(info, layer).alpha
    except JaxblurIOError:
        return None
