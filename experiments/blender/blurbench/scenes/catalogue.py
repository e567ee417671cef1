"""Builders of all scenes by name."""

from . import machines, people, places, things

BUILDERS = {
    builder.__name__: builder
    for builder in (
        machines.car_behind_fence,
        people.crowd,
        places.defocused_orbit,
        machines.drone_rotors,
        places.forward_city,
        things.furry_ball,
        machines.gears,
        things.glass_spheres,
        places.ground_pan,
        places.handheld_street,
        people.mirror_dance,
        places.rain_street,
        people.running_figure,
        things.spiked_balls,
        machines.spoked_wheels,
        things.waving_curtain,
    )
}
