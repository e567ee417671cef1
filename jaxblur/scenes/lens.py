"""A thin lens, as truth is rendered through: points of a disc [Cook, Porter and Carpenter 1984]."""

import dataclasses
import math

import numpy as np
from jaxtyping import Float


@dataclasses.dataclass(frozen=True)
class ThinLens:
    """A thin lens in the place of the pinhole; the angle of view stays that of the camera.

    A point at depth z spreads over a disc of ``radius f |1 / focus - 1 / z|`` pixels, where f is
    the focal length in pixels of the pinhole image.

    Attributes:
        radius: of the aperture, scene units.
        focus: depth of the plane in focus, scene units.

    Raises:
        ValueError: the radius is negative, or the focus is not positive and finite.
    """

    radius: float
    focus: float

    def __post_init__(self) -> None:
        if not 0 <= self.radius < math.inf:
            raise ValueError(f"`radius` must be scene units >= 0, got {self.radius}.")
        if not 0 < self.focus < math.inf:
            raise ValueError(f"`focus` must be scene units above 0, got {self.focus}.")

    def points(self, count: int) -> Float[np.ndarray, "samples 2"]:
        """Spread points evenly over the aperture.

        The radii and angles are those of two further dimensions of the additive sequence that the
        positions in a pixel come from, so that neither follows those or the time.

        Args:
            count: number of points.

        Returns:
            (count, 2) x and y, scene units, with mean zero.

        Source: Roberts 2018, the R4 sequence.
        """
        golden = 1.16730397826141868426
        share = (0.5 + np.outer(np.arange(count), [1 / golden, 1 / golden**2])) % 1.0
        distance, angle = self.radius * np.sqrt(share[:, 0]), 2 * np.pi * share[:, 1]
        points = np.stack([distance * np.cos(angle), distance * np.sin(angle)], axis=1)
        # A mean of another place would move what is out of focus.
        return points - points.mean(axis=0)
