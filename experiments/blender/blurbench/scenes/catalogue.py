"""Builders of all scenes by name."""

from . import machines, people

BUILDERS = {
    builder.__name__: builder
    for builder in (
        machines.car_behind_fence,
        people.crowd,
        machines.drone_rotors,
        machines.gears,
        people.mirror_dance,
        people.running_figure,
        machines.spoked_wheels,
    )
}
