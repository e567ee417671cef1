"""Names of the files in the folder of a scene, beside those of render_reference."""

from pathlib import Path

FRAME = 11
SUBFRAMES = 4
LAYERS = ("Background", "Foreground")


def subframe_times(frame: float, shutter: float, count: int) -> list[float]:
    """Middles of the equal parts of a centered shutter, in frames.

    >>> subframe_times(11, 0.5, 4)
    [10.8125, 10.9375, 11.0625, 11.1875]
    """
    return [frame + shutter * ((index + 0.5) / count - 0.5) for index in range(count)]


def subframe_file(folder: Path, frame: int, index: int, count: int = SUBFRAMES) -> Path:
    """The sharp render in the middle of one part of the shutter; ``index`` from 1."""
    return folder / f"subframe_{frame:04d}_{index}of{count}.exr"


def layer_file(folder: Path, frame: int, layer: str, truth: bool = False) -> Path:
    """The sharp render of one view layer, or its motion-blurred truth."""
    return folder / f"{layer.lower()}{'_truth' if truth else ''}_{frame:04d}.exr"
