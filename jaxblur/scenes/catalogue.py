"""The catalogue of scenes, one function each; most are modeled after a published figure."""

from collections.abc import Callable

from .catalogue_camera import (
    camera_dolly,
    camera_turn,
    flagpole,
    static,
    tracked_car,
    uniform_pan,
    zoom,
)
from .catalogue_passing import (
    acceleration_from_rest,
    crossing,
    cube_between_crates,
    cubes_on_teapot,
    opposed,
    random_cubes,
)
from .catalogue_turning import (
    gears,
    rolling_sphere,
    rotation_stress,
    rotor_over_city,
    wheels_at_three_depths,
)
from .scene import Scene

SCENES: dict[str, Callable[..., Scene]] = {
    builder.__name__: builder
    for builder in (
        cube_between_crates,
        gears,
        zoom,
        flagpole,
        wheels_at_three_depths,
        rotation_stress,
        rotor_over_city,
        cubes_on_teapot,
        camera_dolly,
        camera_turn,
        tracked_car,
        acceleration_from_rest,
        random_cubes,
        rolling_sphere,
        opposed,
        crossing,
        uniform_pan,
        static,
    )
}
