"""Data windows: other files of a frame, put where its own pixels are."""

import pathlib
from typing import Any

from .arguments import CommandError


def in_window(
    image: Any,
    path: pathlib.Path,
    channel: str,
    frame: pathlib.Path,
    windows: Any,
    *,
    what: str,
    outside: float | None = None,
) -> Any:
    """An image in the data window of a frame.

    Only EXR files tell where their pixels are; of others the size must be that of the frame.

    Args:
        image: (H, W, ...) its pixels.
        path: its file.
        channel: one that it was read from.
        frame: file of the frame.
        windows: `jaxblur.exr.Windows` of the frame.
        what: the image, for the message.
        outside: value of pixels that its file does not hold; None if it must hold all.

    Returns:
        (height, width, ...) the pixels of the frame.

    Raises:
        CommandError: it is of another picture, or does not hold all pixels.
    """
    from jaxblur import exr

    own = exr.windows_of(exr.inspect(path), channel)
    told = path.suffix.lower() == frame.suffix.lower() == ".exr"
    if own.data == windows.data or (not told and own.data[2:] == windows.data[2:]):
        return image
    holds = outside is not None or exr.overlap(own.data, windows.data) == windows.data
    if told and own.display == windows.display and holds:
        return exr.put_into(image, own.data, windows.data, outside or 0)
    raise CommandError(
        f"{path}: {what} has the pixels {_in_full(own)}, but {frame} has {_in_full(windows)}; "
        "render both with the same windows."
    )


def _in_full(windows: Any) -> str:
    from jaxblur import exr

    data, display = map(exr.window_words, windows)
    return data if data == display else f"{data} of the display window {display}"
