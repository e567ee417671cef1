"""Triangle meshes: the container, joining and placing, and files through trimesh.

Meshes are NumPy arrays; they become JAX arrays when a scene is built.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np


@dataclasses.dataclass(frozen=True)
class Mesh:
    """An indexed triangle mesh with a normal and a texture coordinate per **corner**.

    Corners and not points carry them, so that points can be shared across creases and texture
    seams, and a closed surface stays closed.

    Attributes:
        points: (V, 3) float, object space, y up.
        triangles: (F, 3) int, counter-clockwise seen from outside.
        normals: (F, 3, 3) unit normals at the corners.
        texture: (F, 3, 2) texture coordinates at the corners.
        slots: (F,) int, index of the triangle's material among those of the body.
        closed: (F,) bool, whether the triangle belongs to a closed surface, so that its back is
            never seen.
    """

    points: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray
    texture: np.ndarray
    slots: np.ndarray
    closed: np.ndarray

    def moved(
        self, offset: Sequence[float] = (0.0, 0.0, 0.0), rotation: np.ndarray | None = None
    ) -> "Mesh":
        """Rotate, then shift.

        Args:
            offset: (3,) added to every point.
            rotation: (3, 3) rotation matrix; identity if None.

        Returns:
            A new mesh.
        """
        turn = np.eye(3) if rotation is None else np.asarray(rotation)
        return dataclasses.replace(
            self, points=self.points @ turn.T + np.asarray(offset), normals=self.normals @ turn.T
        )

    def painted(self, slot: int) -> "Mesh":
        """Give all triangles the material with number `slot` of the body."""
        return dataclasses.replace(self, slots=np.full(len(self.triangles), slot))


def make_mesh(
    points: np.ndarray,
    triangles: np.ndarray,
    texture: np.ndarray,
    *,
    normals: np.ndarray | None = None,
    closed: bool = True,
) -> Mesh:
    """Assemble a mesh; without normals it is flat-shaded.

    Args:
        points: (V, 3).
        triangles: (F, 3) indices into `points`.
        texture: (F, 3, 2), or (V, 2) to take each point's coordinate at its corners.
        normals: (F, 3, 3), or (V, 3) for smooth shading, or None for face normals.
        closed: whether the surface encloses a volume.

    Returns:
        The mesh, with all triangles in slot 0.
    """
    triangles = np.asarray(triangles)
    if normals is None:
        normals = np.repeat(face_normals(points, triangles)[:, None], 3, axis=1)
    elif normals.ndim == 2:
        normals = normals[triangles]
    return Mesh(
        points=np.asarray(points, float),
        triangles=triangles,
        normals=normals,
        texture=texture[triangles] if texture.ndim == 2 else texture,
        slots=np.zeros(len(triangles), int),
        closed=np.full(len(triangles), closed),
    )


def face_normals(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Compute unit face normals (F, 3) by the right-hand rule."""
    first, second, third = np.moveaxis(np.asarray(points)[triangles], 1, 0)
    normal = np.cross(second - first, third - first)
    return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)


def smooth_normals(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Average the face normals at each point by area: (V, 3) unit vectors."""
    first, second, third = np.moveaxis(np.asarray(points)[triangles], 1, 0)
    face = np.cross(second - first, third - first)
    total = np.zeros_like(points, dtype=float)
    np.add.at(total, triangles.ravel(), np.repeat(face, 3, axis=0))
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)


def join(meshes: Sequence[Mesh]) -> Mesh:
    """Merge meshes into one; they then move together and keep their slots.

    Args:
        meshes: at least one mesh.

    Returns:
        One mesh with all triangles in the order given.
    """
    starts = np.cumsum([0] + [len(mesh.points) for mesh in meshes[:-1]])
    return Mesh(
        points=np.concatenate([mesh.points for mesh in meshes]),
        triangles=np.concatenate(
            [mesh.triangles + start for mesh, start in zip(meshes, starts, strict=True)]
        ),
        normals=np.concatenate([mesh.normals for mesh in meshes]),
        texture=np.concatenate([mesh.texture for mesh in meshes]),
        slots=np.concatenate([mesh.slots for mesh in meshes]),
        closed=np.concatenate([mesh.closed for mesh in meshes]),
    )


def load_mesh(path: str | Path) -> Mesh:
    """Read a mesh file (OBJ, GLB, PLY, STL, ..) with trimesh.

    All nodes of a scene file become one mesh. Geometry, normals and texture coordinates are read;
    the file's materials and images are not: give the body a material of its own.

    Args:
        path: the file.

    Returns:
        The mesh, with all triangles in slot 0. If the file has no texture coordinates, x and y of
        the points take their place.

    Raises:
        ModuleNotFoundError: trimesh is not installed.
        FileNotFoundError: there is no such file.
        ValueError: the file holds no triangles.
    """
    try:
        import trimesh
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "`load_mesh` needs trimesh, which is an optional extra: pip install 'jaxblur[mesh]'."
        ) from error
    if not Path(path).is_file():
        raise FileNotFoundError(f"{path}: no such mesh file.")
    loaded = trimesh.load(str(path), force="mesh", process=False)
    if not isinstance(loaded, trimesh.Trimesh) or len(loaded.faces) == 0:
        raise ValueError(f"{path}: holds no triangles; export the object as a triangle mesh.")
    texture = getattr(loaded.visual, "uv", None)
    return make_mesh(
        np.asarray(loaded.vertices),
        np.asarray(loaded.faces),
        np.asarray(loaded.vertices[:, :2] if texture is None else texture),
        normals=np.array(loaded.vertex_normals),
        closed=bool(loaded.is_watertight),
    )
