"""A thin lens and its presets; loads no jax."""

import dataclasses
import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import jax

MILLIMETERS = 1000.0
"""In a meter."""


@dataclasses.dataclass(frozen=True)
class Lens:
    """A thin lens in front of a sensor, as a camera's settings say it.

    A pytree of scalars, all differentiable. A point at depth z spreads over a disc of the radius

        ``c(z) = w / s * A / 2 * f / (F - f) * (1 - F / z)``, ``A = f / N``

    in pixels, where w is the width of the frame; it is negative before the focus and positive
    behind it (of lengths in one unit).

    Attributes:
        focus: F, depth of the plane in focus, scene units.
        f_number: N, focal length by the diameter of the aperture.
        focal_length: f, millimeters.
        sensor_width: s, millimeters of the sensor that the frame's width shows. Of an EXR file the
            display window is what the sensor shows: for a frame of another data window multiply by
            the width of that and divide by the width of the display window.
        unit: meters of a scene unit.
    """

    focus: "float | jax.Array"
    f_number: "float | jax.Array" = 2.8
    focal_length: "float | jax.Array" = 35.0
    sensor_width: "float | jax.Array" = 36.0
    unit: "float | jax.Array" = 1.0

    @classmethod
    def preset(cls, name: str, focus: "float | jax.Array", unit: float = 1.0) -> "Lens":
        """A lens by name, such as ``50mm f/1.8``.

        Args:
            name: a key of `PRESETS`.
            focus: depth of the plane in focus, scene units.
            unit: meters of a scene unit.

        Returns:
            The lens.

        Raises:
            ValueError: there is no such preset.
        """
        if name not in PRESETS:
            raise ValueError(f"`name` must be one of {', '.join(PRESETS)}, got {name!r}.")
        f_number, focal_length, sensor_width = PRESETS[name]
        return cls(focus, f_number, focal_length, sensor_width, unit)

    @classmethod
    def of_aperture(
        cls, radius: "float | jax.Array", focus: "float | jax.Array", focal: "float | jax.Array"
    ) -> "Lens":
        """The lens of an aperture and an angle of view, in a scene whose unit is a meter.

        Args:
            radius: of the aperture, scene units; above 0.
            focus: depth of the plane in focus, scene units.
            focal: focal length of the pinhole image as a share of its width, ``1 / (2 tan(angle /
                2))`` of the horizontal angle of view.

        Returns:
            A lens with the sensor of a full frame.
        """
        sensor = 36.0
        image = focal * sensor
        length = image * focus / (focus + image / MILLIMETERS)
        return cls(focus, length / (2 * MILLIMETERS * radius), length, sensor)

    @property
    def aperture_radius(self) -> "float | jax.Array":
        """Of the aperture, scene units: what `jaxblur.scenes.ThinLens` takes."""
        return self.focal_length / (2 * MILLIMETERS * self.f_number * self.unit)

    def radius_at_infinity(self, width: int) -> "float | jax.Array":
        """Radius of the disc of a point at infinity, ``w / s A / 2 f / (F - f)``.

        Args:
            width: of the frame, pixels.

        Returns:
            Pixels.
        """
        focus = self.focus * self.unit * MILLIMETERS
        aperture = self.focal_length / (2 * self.f_number)
        return (
            width / self.sensor_width * aperture * self.focal_length / (focus - self.focal_length)
        )

    def check(self) -> None:
        """Check the values, as far as they are numbers and not traced.

        Raises:
            ValueError: one is not a positive number, or the focus is nearer than the focal length.
        """
        values = {}
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if getattr(value, "shape", ()) != ():
                raise ValueError(f"`lens.{field.name}` must be a scalar, got shape {value.shape}.")
            try:
                values[field.name] = float(value)
            except TypeError:
                # A traced value has none yet.
                return
        for name, value in values.items():
            if not 0 < value < math.inf:
                raise ValueError(f"`lens.{name}` must be a finite number above 0, got {value:g}.")
        meters = values["focus"] * values["unit"]
        if meters * MILLIMETERS <= values["focal_length"]:
            raise ValueError(
                f"`lens.focus` must be beyond the focal length of {values['focal_length']:g} mm, "
                f"got {meters * MILLIMETERS:g} mm; check `unit`, the meters of a scene unit."
            )


PRESETS = {
    "phone": (1.8, 5.6, 7.6),
    "24mm f/2.8": (2.8, 24.0, 36.0),
    "35mm f/1.4": (1.4, 35.0, 36.0),
    "50mm f/1.8": (1.8, 50.0, 36.0),
    "85mm f/1.4": (1.4, 85.0, 36.0),
    "super35 32mm T2": (2.0, 32.0, 24.9),
}
"""f-number, focal length and sensor width in millimeters, by name."""
