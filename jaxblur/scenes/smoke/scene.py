"""The data of a scene with smoke."""

import dataclasses

from ..motion import Camera
from ..scene import Scene
from .environment import Lights
from .lighting import Medium
from .puff import Puff


@dataclasses.dataclass(frozen=True)
class SmokeScene:
    """Smoke, a thing in the midst of it, and what is around both.

    Bodies neither shade the smoke nor are shaded by it, as they cast no shadows on each other. A
    body that passes through does not stir the smoke.

    Attributes:
        name: name of the scene.
        puff: the smoke.
        medium: what it does with light.
        lights: what lights it.
        surroundings: bodies behind the smoke, with the camera.
        thing: bodies that the smoke surrounds, with the same camera and light; or None. Next to
            it, smoke is divided into front and back at the depth of the first body's origin.
    """

    name: str
    puff: Puff
    medium: Medium
    lights: Lights
    surroundings: Scene
    thing: Scene | None = None

    @property
    def camera(self) -> Camera:
        """The camera."""
        return self.surroundings.world.camera
