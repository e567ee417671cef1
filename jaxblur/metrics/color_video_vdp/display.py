"""Displays: the light that a screen emits and reflects for the pixels of a picture.

    light = scale clip(pixel, lowest, highest) + added        per color, cd/m2

then light of the screen's primaries becomes responses of the cones (L, M, S by CIE 2006), and those
the three opponent channels of Derrington, Krauskopf and Lennie for a white point of D65. The first,
L + M, stands for luminance; for the white of a screen it is 1.05 times as large.
"""

import dataclasses
import math
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

REFLECTIVITY = 0.005
"""Share of the room's light that a matte screen reflects."""
DARKEST = 0.005
"""The darkest light of a picture in cd/m2, below which nothing is told apart."""
METERS_PER_INCH = 0.0254

Primaries = Literal["rec709", "rec2020"]

TO_XYZ: dict[str, np.ndarray] = {
    "rec709": np.array(
        [
            [0.4124564, 0.3575761, 0.1804375],
            [0.2126729, 0.7151522, 0.0721750],
            [0.0193339, 0.1191920, 0.9503041],
        ]
    ),
    "rec2020": np.array(
        [[0.6370, 0.1446, 0.1689], [0.2627, 0.6780, 0.0593], [0.0000, 0.0281, 1.0610]]
    ),
}
# CIE 1931 XYZ to cones.
XYZ_TO_CONES = np.array(
    [
        [0.187596268556126, 0.585168649077728, -0.026384263306304],
        [-0.133397430663221, 0.405505777260049, 0.034502127690364],
        [0.000244379021663, -0.000542995890619, 0.019406849066323],
    ]
)
# Both color channels are near 0 for D65.
CONES_TO_OPPONENT = np.array(
    [[1.0, 1.0, 0.0], [1.0, -2.311130179947035, 0.0], [-1.0, -1.0, 50.977571328718781]]
)


@dataclasses.dataclass(frozen=True)
class Display:
    """A screen and how it is looked at.

    Make one with `white_display`, whose pixels are relative to its white, or
    `nits_display`, whose pixels are light in cd/m2.

    Attributes:
        scale: cd/m2 for a pixel of 1.
        lowest: pixels are clipped to at least this.
        highest: pixels are clipped to at most this.
        added: cd/m2 that every pixel has besides: light that leaks, and that the screen reflects.
        primaries: of the pixels.
        pixels_per_degree: pixels per degree of visual angle.
    """

    scale: float
    lowest: float
    highest: float
    added: float
    primaries: Primaries
    pixels_per_degree: float


def white_display(
    peak: float,
    black: float,
    pixels_per_degree: float,
    *,
    ambient: float = 0.0,
    primaries: Primaries = "rec709",
) -> Display:
    """A screen whose pixels are linear light relative to its white, 0 to 1.

    Args:
        peak: luminance of white, cd/m2.
        black: luminance of black in a dark room, cd/m2.
        pixels_per_degree: see `pixels_per_degree`.
        ambient: light in the room, lux.
        primaries: of the pixels.

    Returns:
        The display.
    """
    added = black + reflected(ambient)
    return Display(peak - black, 0.0, 1.0, added, primaries, pixels_per_degree)


def nits_display(
    peak: float,
    black: float,
    pixels_per_degree: float,
    *,
    ambient: float = 0.0,
    primaries: Primaries = "rec709",
) -> Display:
    """A screen whose pixels are the light that it emits, cd/m2 per color (white has all equal).

    Args:
        peak: the brightest light, cd/m2; pixels are clipped to it.
        black: the darkest light, cd/m2.
        pixels_per_degree: see `pixels_per_degree`.
        ambient: light in the room, lux.
        primaries: of the pixels.

    Returns:
        The display.
    """
    lowest = max(DARKEST, black)
    return Display(1.0, lowest, peak, reflected(ambient), primaries, pixels_per_degree)


def pq_display(
    peak: float, black: float, pixels_per_degree: float, *, ambient: float = 0.0
) -> Display:
    """A screen fed with PQ: pixels are the light that the code stands for, Rec. 2020, cd/m2.

    Args:
        peak: the brightest light, cd/m2; pixels are clipped to it.
        black: light that leaks, cd/m2, which adds to that of the pixels.
        pixels_per_degree: see `pixels_per_degree`.
        ambient: light in the room, lux.

    Returns:
        The display.
    """
    added = black + reflected(ambient)
    return Display(1.0, DARKEST, peak, added, "rec2020", pixels_per_degree)


def reflected(ambient: float) -> float:
    """Light that a matte screen reflects, ``E k / pi`` in cd/m2, in a room of E lux."""
    return ambient * REFLECTIVITY / math.pi


def pixels_per_degree(
    resolution: tuple[int, int], diagonal_inches: float, distance_meters: float
) -> float:
    """Pixels per degree of visual angle in the middle of a screen.

    Args:
        resolution: (width, height) in pixels.
        diagonal_inches: of the screen.
        distance_meters: from eye to screen.

    Returns:
        Pixels per degree.

    Examples:
        >>> round(pixels_per_degree((3840, 2160), 30.0, 0.7472), 1)
        75.4
    """
    pixel = diagonal_inches * METERS_PER_INCH / math.hypot(*resolution)
    return 1 / math.degrees(2 * math.atan(pixel / 2 / distance_meters))


def _headset_pixels_per_degree(resolution: tuple[int, int], diagonal_degrees: float) -> float:
    distance = math.hypot(*resolution) / 2 / math.tan(math.radians(diagonal_degrees / 2))
    return 1 / math.degrees(2 * math.atan(0.5 / distance))


_UHD = pixels_per_degree((3840, 2160), 30.0, 0.7472)

DISPLAYS: dict[str, Display] = {
    "standard_4k": white_display(200.0, 0.2, _UHD, ambient=250.0),
    "standard_fhd": white_display(
        200.0, 0.2, pixels_per_degree((1920, 1080), 24.0, 0.6), ambient=250.0
    ),
    "standard_phone": white_display(
        500.0, 0.05, pixels_per_degree((2400, 1080), 6.0, 0.4), ambient=250.0
    ),
    "standard_hmd": white_display(100.0, 0.1, _headset_pixels_per_degree((1440, 1600), 110.0)),
    "standard_hdr_linear": nits_display(1500.0, 0.0015, _UHD, ambient=10.0),
    "standard_hdr_linear_dark": nits_display(1500.0, 0.0015, _UHD),
    "standard_hdr_linear_zoom": nits_display(
        10000.0, 0.01, pixels_per_degree((3840, 2160), 30.0, 0.25), ambient=10.0
    ),
    "standard_hdr_pq": pq_display(1500.0, 0.0015, _UHD, ambient=10.0),
}
"""Displays of the package cvvdp by its names (0.5.7; the figures are under its MIT license)."""


def find_display(display: str | Display) -> Display:
    """Look up a display by name.

    Args:
        display: a key of `DISPLAYS`, or a display.

    Returns:
        The display.

    Raises:
        ValueError: there is none of that name.
    """
    if isinstance(display, Display):
        return display
    if display not in DISPLAYS:
        raise ValueError(
            f"`display` must be one of {', '.join(DISPLAYS)}, or a metrics.Display, "
            f"got {display!r}."
        )
    return DISPLAYS[display]


def opponent_channels(
    pixels: Float[jax.Array, "*frames height width 3"], display: Display
) -> Float[jax.Array, "*frames 3 height width"]:
    """Convert pixels to what the screen shows, in opponent channels.

    Args:
        pixels: (..., H, W, 3), in the unit of the display.
        display: the screen.

    Returns:
        (..., 3, H, W): L + M, red-green, yellow-violet, in cd/m2. The derivative is 0 beyond
        the clip.
    """
    light = display.scale * jnp.clip(pixels, display.lowest, display.highest) + display.added
    matrix = CONES_TO_OPPONENT @ XYZ_TO_CONES @ TO_XYZ[display.primaries]
    return _combined(matrix, light)


def _combined(matrix: np.ndarray, light: jax.Array) -> Any:
    return jnp.einsum(
        "cr,...hwr->...chw", jnp.asarray(matrix, light.dtype), light, precision="highest"
    )
