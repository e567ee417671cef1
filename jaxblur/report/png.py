"""PNG in memory, without color tags, so that browsers return the stored values unchanged."""

import base64
import struct
import zlib

import numpy as np
from jaxtyping import Float, UInt8

SIGNATURE = b"\x89PNG\r\n\x1a\n"
GRAY, RGB = 0, 2
UP = 2
"""PNG filter: the difference from the row above."""

LARGEST_EXPONENT = 255 - 128


def png_bytes(pixels: UInt8[np.ndarray, "height width *channels"]) -> bytes:
    """Encode 8-bit pixels.

    Args:
        pixels: (H, W) gray, or (H, W, 3).

    Returns:
        The file.
    """
    height, width = pixels.shape[:2]
    rows = pixels.reshape(height, -1)
    above = np.vstack([np.zeros_like(rows[:1]), rows[:-1]])
    filtered = np.hstack([np.full((height, 1), UP, np.uint8), rows - above])
    kind = GRAY if pixels.ndim == 2 else RGB
    header = struct.pack(">IIBBBBB", width, height, 8, kind, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(filtered.tobytes(), 9)), (b"IEND", b""))
    return SIGNATURE + b"".join(_chunk(name, content) for name, content in chunks)


def _chunk(name: bytes, content: bytes) -> bytes:
    checksum = struct.pack(">I", zlib.crc32(name + content))
    return struct.pack(">I", len(content)) + name + content + checksum


def data_uri(pixels: UInt8[np.ndarray, "height width *channels"]) -> str:
    """Encode 8-bit pixels for an ``img`` element.

    Args:
        pixels: (H, W) gray, or (H, W, 3).

    Returns:
        ``data:image/png;base64,...``
    """
    return "data:image/png;base64," + base64.b64encode(png_bytes(pixels)).decode("ascii")


def shared_exponent(
    image: Float[np.ndarray, "height width 3"],
) -> tuple[UInt8[np.ndarray, "height width 3"], UInt8[np.ndarray, "height width"]]:
    """Encode linear light as 8-bit mantissas with one exponent per pixel (RGBE).

    ``value = mantissa * 2^(exponent - 136)``, within 1/2 step, which is at most 0.4 % of the
    largest of the three values. Negative values become 0.

    Source: Ward 1991, "Real pixels", Graphics Gems II.

    Args:
        image: (H, W, 3) linear light, finite.

    Returns:
        Mantissas and exponents.
    """
    light = np.maximum(np.asarray(image, np.float64), 0.0)
    largest = light.max(axis=-1)
    # 255.5 instead of 256, because a mantissa that rounds up to 256 needs the next exponent.
    exponent = np.ceil(np.log2(np.maximum(largest, 1e-38) * 256 / 255.5))
    exponent = np.clip(exponent, -128, LARGEST_EXPONENT)
    mantissa = np.floor(light * np.exp2(8 - exponent)[..., None] + 0.5)
    stored = np.where(largest > 0, exponent + 128, 0)
    return np.minimum(mantissa, 255).astype(np.uint8), stored.astype(np.uint8)
