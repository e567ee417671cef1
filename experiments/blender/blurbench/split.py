"""The scenes of BlurBench, and which of them a method may be fitted to.

The rule: a scene is for training if the CRC-32 of its name is odd, else for the test. It was chosen
before any frame was rendered, and a new scene moves no other scene to the other half.
"""

import zlib
from typing import Literal

Half = Literal["training", "test"]
HALVES: tuple[Half, ...] = ("training", "test")
SCENES = (
    "car_behind_fence",
    "crowd",
    "defocused_orbit",
    "drone_rotors",
    "forward_city",
    "furry_ball",
    "gears",
    "glass_spheres",
    "ground_pan",
    "handheld_street",
    "mirror_dance",
    "rain_street",
    "running_figure",
    "spiked_balls",
    "spoked_wheels",
    "waving_curtain",
)


def half_of(scene: str) -> Half:
    """The half that a scene belongs to, from its name alone.

    >>> half_of("running_figure"), half_of("crowd")
    ('training', 'test')
    """
    return "training" if zlib.crc32(scene.encode()) % 2 else "test"
