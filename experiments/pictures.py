"""Pictures for viewing: 8-bit PNG, error images, contact sheets.

Images here are linear light, as in the whole package; the sRGB curve is applied once, when a file
is written.
"""

import os
import pathlib
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxblur import exr, metrics, srgb
from jaxblur.metrics import Image

SEPARATOR = 4
SEPARATOR_DISPLAY_VALUE = 0.5


def write_png(path: str | os.PathLike[str], image: Image, exposure: float = 0.0) -> None:
    """Write linear light as 8-bit sRGB PNG, atomically, clipped to [0, 1].

    Args:
        path: a file ending in .png.
        image: (H, W, C) linear light; if there are more than three channels, the first three are
            written, which for premultiplied RGBA is the image over black.
        exposure: photographic stops; the light is first multiplied by 2^exposure.

    Raises:
        ValueError: the name does not end in .png, or the channels are neither 1 nor at least 3.
        JaxblurIOError: values are not finite, or the file cannot be written.
    """
    if pathlib.Path(path).suffix.lower() != ".png":
        raise ValueError(f"`path` must end in .png, got {os.fspath(path)}.")
    exr.write_image(path, np.asarray(metrics.rgb(image)) * np.float32(2.0**exposure))


def error_image(
    image: Image, truth: Image, gain: float = 4.0
) -> Float[np.ndarray, "height width 3"]:
    """Compute the absolute error on a display: gain * |display(image) - display(truth)|.

    Args:
        image: (H, W, C) linear light.
        truth: (H, W, C) linear light.
        gain: factor on the error in display values.

    Returns:
        (H, W, 3) linear light; its sRGB encoding is the error, clipped to [0, 1].
    """
    error = np.abs(np.asarray(metrics.display(image)) - np.asarray(metrics.display(truth)))
    return srgb.decode(np.clip(gain * error, 0.0, 1.0))


def worst_window(image: Image, truth: Image, size: tuple[int, int]) -> tuple[slice, slice]:
    """The window where the display values of two images differ most.

    Args:
        image: (H, W, C) linear light.
        truth: (H, W, C) linear light.
        size: height and width of the window in pixels; those of the image, where it is smaller.

    Returns:
        Rows and columns.
    """
    error = np.square(np.asarray(metrics.display(image)) - np.asarray(metrics.display(truth)))
    summed = np.pad(error.sum(-1).cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    height, width = (min(side, limit) for side, limit in zip(size, error.shape, strict=False))
    total = (
        summed[height:, width:]
        - summed[:-height, width:]
        - summed[height:, :-width]
        + summed[:-height, :-width]
    )
    top, left = np.unravel_index(np.argmax(total), total.shape)
    return slice(top, top + height), slice(left, left + width)


def enlarged(image: Image, times: int) -> np.ndarray:
    """The image with each pixel repeated.

    Args:
        image: (H, W, C).
        times: copies of a pixel in a row, and in a column.

    Returns:
        (times H, times W, C).
    """
    return np.asarray(image).repeat(times, axis=0).repeat(times, axis=1)


def contact_sheet(rows: Sequence[Sequence[Image]]) -> Float[np.ndarray, "rows columns 3"]:
    """Arrange images of one size in rows, with thin gray lines between them.

    Args:
        rows: images from left to right, rows from top to bottom; short rows are filled with gray.
            Each is (H, W, C) linear light.

    Returns:
        (rows, columns, 3) linear light.

    Raises:
        ValueError: there is no image, or sizes differ.
    """
    cells = [[np.asarray(metrics.rgb(image)) for image in row] for row in rows]
    sizes = {cell.shape for row in cells for cell in row}
    if len(sizes) != 1:
        raise ValueError(f"`rows` must hold images of one size, got {sorted(sizes)}.")
    ((height, width, _),) = sizes
    columns = max(len(row) for row in cells)
    shape = (_extent(len(cells), height), _extent(columns, width), 3)
    sheet = np.full(shape, srgb.decode(np.array(SEPARATOR_DISPLAY_VALUE)), np.float32)
    for row, images in enumerate(cells):
        for column, cell in enumerate(images):
            top, left = row * (height + SEPARATOR), column * (width + SEPARATOR)
            sheet[top : top + height, left : left + width] = cell
    return sheet


def _extent(count: int, size: int) -> int:
    return count * (size + SEPARATOR) - SEPARATOR
