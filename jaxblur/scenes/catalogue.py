from . import materials, motion, primitives
from .scene import Body, Scene, daylight, make_scene


def uniform_pan() -> Scene:
    wall = Body("wall", primitives.sheet((20, 12)), materials.checker("#e0a060", "#305080", (1, 1)))
    ball = Body(
        "ball",
        primitives.sphere(1.0, 48).moved((0, 0, 1.5)),
        materials.noise("#c03020", "#f0e0d0", (2, 1)),
        motion.rigid((0, 0, 0), spin=(0, 0.05), velocity=(0.3, 0, 0)),
    )
    pot = Body(
        "pot", primitives.teapot().moved((-2, -2, 2)), materials.brick("#888888", "#4080c0", (1, 2))
    )
    tor = Body("tor", primitives.torus().moved((2, 1, 2)), materials.flat("#80c040"))
    g = Body(
        "gear",
        primitives.gear().moved((-2, 2, 2)),
        [materials.flat("#80c040"), materials.flat("#d08040")],
        motion.rigid(spin_axis=(0, 0, 1), spin=(0, 0.1)),
    )
    r = Body(
        "rotor",
        primitives.rotor(2.0).moved((1, -1.5, 2)),
        [materials.flat("#80c040"), materials.flat("#d08040")],
        motion.rigid(spin_axis=(0, 1, 0), spin=(0, 0.1)),
    )
    return make_scene(
        "uniform_pan",
        [wall, ball, pot, tor, g, r],
        motion.camera((1, 1, 10), (0, 0, 0)),
        daylight(),
    )


SCENES = {"uniform_pan": uniform_pan}
