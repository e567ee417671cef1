"""Vegetation: thin leaves and blades of grass before a bright sky, after Navarro 2012, chapter 3.

There depth has more edges than luma: leaves lie before leaves of the same green.
"""

import numpy as np

from jaxblur import scenes
from jaxblur.scenes import materials, primitives
from jaxblur.scenes.mesh import Mesh, join, make_mesh

BLADES, LEAVES, TWIGS = 3000, 4500, 150
JOINTS = 4
"""Places along a blade of grass, from the root to the tip."""


def vegetation() -> scenes.Scene:
    """A meadow, and leaves on hanging twigs above it, before a bright sky; nothing moves."""
    generator = np.random.default_rng(7)
    greens = [materials.flat(color) for color in ("#3d5c22", "#5b7f2e", "#86a04a")]
    bodies = [scenes.Body("ground", primitives.plane((60, 60), (4, 4)), materials.flat("#4c5a2c"))]
    bodies += [scenes.Body(f"grass {i}", grass(generator), green) for i, green in enumerate(greens)]
    bodies += [
        scenes.Body(f"leaves {i}", leaves(generator), green) for i, green in enumerate(greens)
    ]
    view = scenes.camera((0, 0.5, 6), (0, 1.15, 0), field_of_view=50)
    light = scenes.daylight((-0.4, 0.8, 0.5), zenith="#9cc4ec", horizon="#eef4f8", clouds=0.0)
    return scenes.make_scene("vegetation", bodies, view, light)


def grass(generator: np.random.Generator) -> Mesh:
    """Blades of grass in view of the camera: strips that bend over and end in a tip."""
    count = BLADES // 3
    z = generator.uniform(-8, 4.2, count)
    root = np.stack([generator.uniform(-0.75, 0.75, count) * (7 - z), 0 * z, z], -1)
    heading = generator.uniform(0, 2 * np.pi, count)
    lean = np.stack([np.cos(heading), np.zeros(count), np.sin(heading)], -1)
    height = generator.uniform(0.35, 1.25, count)
    along = np.linspace(0, 1, JOINTS)
    bend = generator.uniform(0.1, 0.7, count) * height
    spine = root[:, None] + along[:, None] ** 2 * (bend[:, None] * lean)[:, None]
    spine[..., 1] += height[:, None] * (along - 0.25 * along**2)
    side = np.stack([-lean[:, 2], 0 * z, lean[:, 0]], -1)
    return strips(spine, side, 0.016 * (1 - along))


def leaves(generator: np.random.Generator) -> Mesh:
    """Narrow leaves, and the twigs that they hang on, which come down from above the picture."""
    twigs = TWIGS // 3
    z = generator.uniform(-6, 3.2, twigs)
    top = np.stack([generator.uniform(-0.85, 0.85, twigs) * (6 - z), 0.4 * (6 - z) + 1.3, z], -1)
    hanging = np.stack([generator.uniform(-0.5, 0.5, twigs), -np.ones(twigs), 0 * z], -1)
    length = generator.uniform(0.15, 0.5, twigs) * (6 - z)
    tip = top + length[:, None] * hanging
    along = np.linspace(0, 1, JOINTS)
    twig_spine = top[:, None] + along[:, None] * (tip - top)[:, None]
    twig = strips(twig_spine, np.broadcast_to([1.0, 0, 0], top.shape), np.full(JOINTS, 0.008))

    count = LEAVES // 3
    owner = generator.integers(twigs, size=count)
    stem = top[owner] + generator.uniform(0, 1, (count, 1)) * (tip - top)[owner]
    pointing = generator.normal(size=(count, 3)) * (1, 0.5, 1) + (0, -0.6, 0)
    pointing /= np.linalg.norm(pointing, axis=-1, keepdims=True)
    side = np.cross(pointing, generator.normal(size=(count, 3)))
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    size = generator.uniform(0.12, 0.28, (count, 1, 1))
    spine = stem[:, None] + size * along[:, None] * pointing[:, None]
    leaf = strips(spine, side, 0.028 * np.sin(np.pi * along))
    return join([twig, leaf])


def strips(spine: np.ndarray, side: np.ndarray, half_width: np.ndarray) -> Mesh:
    """Flat strips along curves, seen from both sides.

    Args:
        spine: (N, JOINTS, 3) curves.
        side: (N, 3) unit vectors across each.
        half_width: (JOINTS,) of all strips; 0 is a tip.

    Returns:
        An open mesh.
    """
    count, joints = spine.shape[:2]
    across = half_width[:, None] * side[:, None]
    points = np.stack([spine - across, spine + across], axis=2)
    index = np.arange(count * joints * 2).reshape(count, joints, 2)
    a, b, c, d = (index[:, i : joints - 1 + i, j] for i in (0, 1) for j in (0, 1))
    triangles = np.concatenate(
        [np.stack(three, -1).reshape(-1, 3) for three in ((a, b, d), (a, d, c))]
    )
    points = points.reshape(-1, 3)
    return make_mesh(points, triangles, np.zeros((len(points), 2)), closed=False)
