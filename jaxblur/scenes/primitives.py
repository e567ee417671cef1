"""Analytic primitives and the small mesh library of the catalogue.

Texture coordinates are in scene units on boxes, planes and extrusions, and in turns (0 to 1) around
spheres, tori and cylinders. Every primitive except `plane` and `sheet` is closed and has outward
normals.
"""

from collections.abc import Sequence

import numpy as np

from .mesh import Mesh, join, make_mesh, smooth_normals

Quads = np.ndarray


def _split(quads: Quads) -> np.ndarray:
    """Cut (Q, 4) quads into (2 Q, 3) triangles."""
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def _corners(values: np.ndarray) -> np.ndarray:
    """Cut (Q, 4, ...) values at quad corners as `_split` cuts the quads."""
    return np.concatenate([values[:, [0, 1, 2]], values[:, [0, 2, 3]]])


def box(size: Sequence[float] = (1.0, 1.0, 1.0)) -> Mesh:
    """Make a box around the origin.

    Args:
        size: (3,) full lengths along x, y, z.

    Returns:
        12 triangles; texture coordinates run from the lower left of each face, in scene units.
    """
    half = np.asarray(size, float) / 2
    signs = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)]) * 2 - 1
    points = signs * half
    quads = np.array(
        [[4, 5, 7, 6], [1, 0, 2, 3], [5, 1, 3, 7], [0, 4, 6, 2], [6, 7, 3, 2], [0, 1, 5, 4]]
    )
    across, up = (
        points[quads[:, 1]] - points[quads[:, 0]],
        points[quads[:, 3]] - points[quads[:, 0]],
    )
    width, height = np.linalg.norm(across, axis=1), np.linalg.norm(up, axis=1)
    zero = np.zeros(6)
    texture = np.stack([zero, zero, width, zero, width, height, zero, height], 1).reshape(6, 4, 2)
    return make_mesh(points, _split(quads), _corners(texture))


def plane(size: Sequence[float] = (1.0, 1.0), cells: Sequence[int] = (1, 1)) -> Mesh:
    """Make a horizontal grid plane that faces up.

    Args:
        size: full lengths along x and z.
        cells: number of quads along x and z.

    Returns:
        An open mesh around the origin; texture coordinates ``(x, -z)`` in scene units.
    """
    mesh = sheet(size, cells)
    lay_down = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    return mesh.moved(rotation=lay_down)


def sheet(size: Sequence[float] = (1.0, 1.0), cells: Sequence[int] = (1, 1)) -> Mesh:
    """Make an upright grid plane that faces +z.

    Args:
        size: full lengths along x and y.
        cells: number of quads along x and y.

    Returns:
        An open mesh around the origin; texture coordinates ``(x, y)`` in scene units.
    """
    columns, rows = cells
    x, y = (np.linspace(-0.5, 0.5, n + 1) * length for n, length in zip(cells, size, strict=True))
    grid = np.stack([*np.meshgrid(x, y), np.zeros((rows + 1, columns + 1))], -1).reshape(-1, 3)
    index = np.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)
    quads = np.stack([index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]], -1)
    return make_mesh(grid, _split(quads.reshape(-1, 4)), grid[:, :2], closed=False)


def _tube(points: np.ndarray, normals: np.ndarray, wrap_rows: bool) -> Mesh:
    """Mesh a (rows, columns, 3) grid that closes along columns and, on request, along rows."""
    rows, columns = points.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    last = rows if wrap_rows else rows - 1
    row, column = np.meshgrid(np.arange(last), np.arange(columns), indexing="ij")
    steps = [(0, 0), (0, 1), (1, 1), (1, 0)]
    quads = np.stack([index[(row + a) % rows, (column + b) % columns] for a, b in steps], -1)
    # Texture coordinates continue past the seam, where the index wraps.
    texture = np.stack(
        [np.stack([(column + b) / columns, (row + a) / last], -1) for a, b in steps], -2
    )
    return make_mesh(
        points.reshape(-1, 3),
        _split(quads.reshape(-1, 4)),
        _corners(texture.reshape(-1, 4, 2)),
        normals=normals.reshape(-1, 3),
    )


def sphere(radius: float = 1.0, segments: int = 32) -> Mesh:
    """Make a sphere of rings of longitude and latitude.

    Args:
        radius: scene units; the points lie on the sphere.
        segments: quads around the equator, at least 4; half as many from pole to pole.

    Returns:
        A closed mesh with exact smooth normals.
    """
    rings = segments // 2
    latitude = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)[:, None]
    longitude = 2 * np.pi * np.arange(segments) / segments
    circle = np.cos(latitude)
    normals = np.stack(
        [circle * np.sin(longitude), np.sin(latitude) + 0 * longitude, circle * np.cos(longitude)],
        -1,
    )
    return _weld_poles(_tube(radius * normals, normals, wrap_rows=False), segments)


def _weld_poles(mesh: Mesh, segments: int) -> Mesh:
    """Merge the ring of points at each pole into one, and drop degenerate triangles."""
    rename = np.arange(len(mesh.points))
    rename[:segments], rename[-segments:] = 0, len(mesh.points) - segments
    kept_points, compact = np.unique(rename, return_inverse=True)
    triangles = compact[mesh.triangles]
    keep = np.all(triangles != np.roll(triangles, 1, axis=1), axis=1)
    return Mesh(
        mesh.points[kept_points],
        triangles[keep],
        mesh.normals[keep],
        mesh.texture[keep],
        mesh.slots[keep],
        mesh.closed[keep],
    )


def torus(radius: float = 1.0, tube: float = 0.3, segments: int = 48, sides: int = 16) -> Mesh:
    """Make a torus around the z axis.

    Args:
        radius: distance from the center to the middle of the tube.
        tube: radius of the tube.
        segments: quads around the axis.
        sides: quads around the tube.

    Returns:
        A closed mesh with exact smooth normals.
    """
    around = 2 * np.pi * np.arange(segments) / segments
    across = 2 * np.pi * np.arange(sides)[:, None] / sides
    out = np.stack([np.cos(around), np.sin(around), 0 * around], -1)
    normals = np.cos(across)[..., None] * out + np.sin(across)[..., None] * np.array([0, 0, 1.0])
    return _tube(radius * out + tube * normals, normals, wrap_rows=True)


def extruded_ring(outer: np.ndarray, inner: np.ndarray, thickness: float) -> Mesh:
    """Extrude the region between two outlines along z.

    Args:
        outer: (N, 2) outline, counter-clockwise.
        inner: (N, 2) hole with as many points, counter-clockwise.
        thickness: full length along z.

    Returns:
        A closed, flat-shaded mesh.
    """
    count, half = len(outer), thickness / 2
    layers = [(outer, half), (inner, half), (inner, -half), (outer, -half)]
    points = np.concatenate([np.pad(o, ((0, 0), (0, 1)), constant_values=z) for o, z in layers])
    this, following = np.arange(count), np.roll(np.arange(count), -1)
    quads = np.concatenate(
        [
            np.stack([a * count + this, a * count + following, b * count + following], -1)
            for a, b in ((0, 1), (1, 2), (2, 3), (3, 0))
        ]
    )
    last = np.concatenate([b * count + this for b in (1, 2, 3, 0)])
    quads = np.concatenate([quads, last[:, None]], axis=1)
    edge = np.linalg.norm(outer - np.roll(outer, 1, axis=0), axis=1)
    texture = points[:, :2] + np.where(points[:, 2:] > 0, 0.0, 1.0) * edge.mean()
    return make_mesh(points, _split(quads), texture)


def cylinder(radius: float = 0.5, height: float = 1.0, segments: int = 24) -> Mesh:
    """Make an upright cylinder around the y axis; a thin one is a pole.

    Args:
        radius: scene units.
        height: full length along y.
        segments: sides.

    Returns:
        A closed mesh, smooth around and flat at the ends.
    """
    angle = 2 * np.pi * np.arange(segments) / segments
    ring = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], -1)
    ends = np.array([[0, -height / 2, 0], [0, height / 2, 0]])
    wall = _tube(ends[:, None] + radius * ring, np.stack([ring, ring]), wrap_rows=False)
    points = np.concatenate([wall.points, ends])
    this, following = np.arange(segments), np.roll(np.arange(segments), -1)
    low = np.stack([following, this, np.full(segments, 2 * segments)], -1)
    high = np.stack(
        [segments + this, segments + following, np.full(segments, 2 * segments + 1)], -1
    )
    caps = make_mesh(points, np.concatenate([low, high]), points[:, [0, 2]])
    return Mesh(
        points,
        *(
            np.concatenate([getattr(wall, name), getattr(caps, name)])
            for name in ("triangles", "normals", "texture", "slots", "closed")
        ),
    )


def gear(
    radius: float = 1.0,
    teeth: int = 16,
    spokes: int = 5,
    thickness: float = 0.3,
    tooth: float = 0.12,
) -> Mesh:
    """Make a gear around the z axis: a toothed rim (slot 0), spokes and a hub (slot 1).

    Args:
        radius: radius at the middle of the teeth.
        teeth: number of teeth.
        spokes: number of spokes.
        thickness: thickness of the rim along z; the spokes are thinner.
        tooth: height of a tooth as a share of the radius.

    Returns:
        Closed parts in one mesh.
    """
    steps = np.arange(4 * teeth)
    angle = 2 * np.pi * (steps + np.array([0.15, 0.0, 0.0, -0.15])[steps % 4]) / (4 * teeth)
    height = radius * (1 + tooth / 2 * np.array([1, 1, -1, -1])[(steps + 3) % 4])
    around = np.stack([np.cos(angle), np.sin(angle)], -1)
    rim_inside = radius * (1 - tooth - 0.14)
    rim = extruded_ring(height[:, None] * around, rim_inside * around, thickness)
    circle = around[::2]
    hub = extruded_ring(0.24 * radius * circle, 0.1 * radius * circle, 1.3 * thickness).painted(1)
    length = rim_inside - 0.16 * radius
    spoke = box((length, 0.16 * radius, 0.6 * thickness)).painted(1)
    middle = 0.2 * radius + length / 2
    return join([rim, hub, *_around_z(spoke.moved((middle, 0, 0)), spokes)])


def rotor(radius: float = 1.0, blades: int = 4, width: float = 0.12) -> Mesh:
    """Make a rotor about the y axis: blades (slot 0) with painted tips (slot 1) on a hub (1).

    Args:
        radius: radius at the tips of the blades.
        blades: number of blades.
        width: width of a blade.

    Returns:
        Closed parts in one mesh.
    """
    thickness, tip = 0.02 * radius, 0.12 * radius
    blade = box((radius - tip, width, thickness)).moved(((radius - tip) / 2, 0, 0))
    end = box((tip, width, thickness)).painted(1).moved((radius - tip / 2, 0, 0))
    hub = cylinder(0.08 * radius, 0.12 * radius, 16).painted(1)
    upright = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    parts = [part.moved(rotation=upright) for part in _around_z(join([blade, end]), blades)]
    return join([hub, *parts])


def _around_z(part: Mesh, count: int) -> list[Mesh]:
    angles = 2 * np.pi * np.arange(count) / count
    return [
        part.moved(rotation=np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]))
        for c, s in zip(np.cos(angles), np.sin(angles), strict=True)
    ]


def disc(radius: float = 1.0, thickness: float = 0.1, segments: int = 64) -> Mesh:
    """Make a round plate that faces +z.

    Args:
        radius: scene units.
        thickness: full length along z.
        segments: sides.

    Returns:
        A closed mesh; texture coordinates ``(x, -y)`` in scene units on the faces.
    """
    stand_up = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    return cylinder(radius, thickness, segments).moved(rotation=stand_up)


def wheel(radius: float = 1.0, spokes: int = 6, width: float = 0.3) -> Mesh:
    """Make a wheel around the z axis: a tire (slot 0), a rim, spokes and a hub (slot 1).

    Args:
        radius: radius at the tread.
        spokes: number of spokes.
        width: width of the tire along z.

    Returns:
        Closed parts in one mesh.
    """
    circle = 2 * np.pi * np.arange(40) / 40
    around = radius * np.stack([np.cos(circle), np.sin(circle)], -1)
    tire = torus(0.86 * radius, 0.14 * radius, 40, 10)
    rim = extruded_ring(0.78 * around, 0.68 * around, 0.5 * width).painted(1)
    hub = extruded_ring(0.2 * around, 0.08 * around, width).painted(1)
    spoke = box((0.54 * radius, 0.1 * radius, 0.3 * width)).painted(1)
    return join([tire, rim, hub, *_around_z(spoke.moved((0.44 * radius, 0, 0)), spokes)])


def head(levels: int = 3) -> Mesh:
    """Make a lion-like head: a subdivided cage (slot 0) with eyes and a nose (slot 1).

    Args:
        levels: Catmull-Clark steps.

    Returns:
        A closed, smooth mesh about 4 units high, around the origin, that faces +z.
    """
    skull = [(x, y, z) for x in range(3) for y in range(3) for z in range(2)]
    corners = {(x, y) for x in (-1, 3) for y in (-1, 3)}
    mane = [(x, y, -1) for x in range(-1, 4) for y in range(-1, 4) if (x, y) not in corners]
    snout = [(1, 0, 2), (1, 0, 3)]
    ears = [(0, 3, 0), (2, 3, 0)]
    face = blob([*skull, *mane, *snout, *ears], levels, cell=(0.8, 0.8, 0.8))
    spots = [(0.27, (0.55, 1.75, 1.45)), (0.27, (1.85, 1.75, 1.45)), (0.24, (1.2, 0.62, 2.95))]
    dark = [sphere(radius, 14).painted(1).moved(place) for radius, place in spots]
    return join([face, *dark]).moved((-1.2, -1.2, -1))


def car(levels: int = 2) -> Mesh:
    """Make the body of a toy car that faces +x, without wheels.

    Args:
        levels: Catmull-Clark steps.

    Returns:
        Body (slot 0), windows (slot 1) and lights (slot 2), about 4 units long, centered over
        the origin.
    """
    floor = [(x, 0, z) for x in range(6) for z in range(2)]
    cabin = [(x, 1, z) for x in range(1, 4) for z in range(2)]
    body = blob([*floor, *cabin], levels, cell=(0.72, 0.62, 0.85)).moved((-2.1, 0.3, -0.85))
    window = box((0.62, 0.3, 1.78)).painted(1)
    sides = [window.moved((x, 1.16, 0)) for x in (-0.7, 0.08)]
    windshield = box((2.2, 0.28, 1.1)).painted(1).moved((-0.3, 1.16, 0))
    lights = [box((0.1, 0.16, 0.3)).painted(2).moved((2.05, 0.62, z)) for z in (-0.4, 0.4)]
    stripe = box((3.6, 0.1, 1.66)).painted(2).moved((0.0, 0.55, 0))
    return join([body, *sides, windshield, *lights, stripe])


def teapot(levels: int = 3) -> Mesh:
    """Make a teapot-like blob: a cage of cells with spout, handle and lid, subdivided.

    Args:
        levels: Catmull-Clark steps.

    Returns:
        A closed, smooth mesh about 5 units wide that stands on y = 0.
    """
    body = [(x, y, z) for x in range(3) for y in (-1, 0, 1) for z in range(3)]
    spout = [(3, 0, 1), (4, 0, 1), (4, 1, 1), (5, 1, 1), (5, 2, 1)]
    handle = [(-1, 1, 1), (-2, 1, 1), (-2, 0, 1), (-2, -1, 1), (-1, -1, 1)]
    points, quads = _cage({*body, *spout, *handle, (1, 2, 1)})
    # The square body becomes a disc, narrower at its foot and shoulder.
    across = (points[:, [0, 2]] - 1.5) / 1.5
    inside = np.clip(across, -1, 1)
    girth = np.where(np.isin(points[:, 1], (-1, 2)), 0.85, 1.1)[:, None]
    points[:, [0, 2]] = 1.5 * girth * across * np.sqrt(1 - inside[:, ::-1] ** 2 / 2)
    mesh = _subdivided(points, quads, levels)
    return mesh.moved((0, -mesh.points[:, 1].min(), 0))


def blob(
    cells: Sequence[tuple[int, int, int]],
    levels: int = 3,
    *,
    cell: Sequence[float] = (1.0, 1.0, 1.0),
) -> Mesh:
    """Make a smooth blob: the boundary of a set of cells, subdivided by Catmull and Clark.

    Args:
        cells: integer corners (x, y, z) of the cells; they must meet in faces, not only in
            edges or corners.
        levels: subdivision steps; each one makes four quads of one.
        cell: (3,) size of a cell in scene units.

    Returns:
        A closed, smooth mesh; texture coordinates ``(x + z, y)``.

    Raises:
        ValueError: an edge of the boundary has more than two faces.
    """
    points, quads = _cage(set(cells))
    return _subdivided(points * np.asarray(cell), quads, levels)


def _subdivided(points: np.ndarray, quads: Quads, levels: int) -> Mesh:
    for _ in range(levels):
        points, quads = _catmull_clark(points, quads)
    triangles = _split(quads)
    texture = np.stack([points[:, 0] + points[:, 2], points[:, 1]], -1)
    return make_mesh(points, triangles, texture, normals=smooth_normals(points, triangles))


def _cage(cells: set[tuple[int, int, int]]) -> tuple[np.ndarray, Quads]:
    unit, faces = box(), []
    quads = np.array(
        [[4, 5, 7, 6], [1, 0, 2, 3], [5, 1, 3, 7], [0, 4, 6, 2], [6, 7, 3, 2], [0, 1, 5, 4]]
    )
    for cell in sorted(cells):
        for quad in unit.points[quads] + 0.5:
            outward = 2 * quad.mean(axis=0) - 1
            if tuple(np.add(cell, outward).astype(int)) not in cells:
                faces.append(quad + cell)
    corners, index = np.unique(np.concatenate(faces), axis=0, return_inverse=True)
    return corners, index.reshape(-1, 4)


def _catmull_clark(points: np.ndarray, quads: Quads) -> tuple[np.ndarray, Quads]:
    """Subdivide a closed quad mesh once [Catmull and Clark 1978]."""
    face = points[quads].mean(axis=1)
    ends = np.stack([quads, np.roll(quads, -1, axis=1)], -1)
    edges, of_side, uses = np.unique(
        np.sort(ends, -1).reshape(-1, 2), axis=0, return_inverse=True, return_counts=True
    )
    if np.any(uses != 2):
        raise ValueError("`cells` must meet in faces: a boundary edge does not have two faces.")
    of_side = of_side.reshape(-1, 4)
    count, total = len(points), len(edges)
    around_edge = np.zeros((total, 3))
    np.add.at(around_edge, of_side.ravel(), np.repeat(face, 4, axis=0))
    middle = points[edges].mean(axis=1)
    edge = middle / 2 + around_edge / 4
    valence = np.bincount(quads.ravel(), minlength=count)[:, None]
    around_face, around_middle = np.zeros((count, 3)), np.zeros((count, 3))
    np.add.at(around_face, quads.ravel(), np.repeat(face, 4, axis=0))
    np.add.at(around_middle, edges.ravel(), np.repeat(middle, 2, axis=0))
    moved = (around_face / valence + 2 * around_middle / valence + (valence - 3) * points) / valence
    face_index = count + total + np.repeat(np.arange(len(quads))[:, None], 4, axis=1)
    incoming, outgoing = count + np.roll(of_side, 1, axis=1), count + of_side
    parts = np.stack([quads, outgoing, face_index, incoming], -1).reshape(-1, 4)
    return np.concatenate([moved, edge, face]), parts
