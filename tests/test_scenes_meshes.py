"""Meshes: closed, outward, unit normals; textures averaged exactly; mesh files."""

import builtins

import jax.numpy as jnp
import numpy as np
import pytest

from jaxblur.scenes import load_mesh, materials, primitives
from jaxblur.scenes.mesh import face_normals, join

CLOSED = {
    "box": lambda: primitives.box((1, 2, 3)),
    "sphere": lambda: primitives.sphere(1.5, 24),
    "torus": lambda: primitives.torus(1.0, 0.3, 24, 10),
    "cylinder": lambda: primitives.cylinder(0.5, 2.0, 12),
    "disc": lambda: primitives.disc(1.0, 0.2, 16),
    "gear": lambda: primitives.gear(1.0, 12, 5),
    "wheel": lambda: primitives.wheel(1.0, 5),
    "rotor": lambda: primitives.rotor(1.0, 3),
    "teapot": lambda: primitives.teapot(2),
    "head": lambda: primitives.head(2),
    "car": lambda: primitives.car(1),
}


def volume(mesh):
    """Signed volume by the divergence theorem; positive where normals point out."""
    a, b, c = np.moveaxis(mesh.points[mesh.triangles], 1, 0)
    return np.sum(a * np.cross(b, c)) / 6


@pytest.mark.parametrize("name", CLOSED)
def test_closed_meshes_are_watertight_and_face_outward(name):
    mesh = CLOSED[name]()
    sides = np.concatenate([mesh.triangles[:, [i, (i + 1) % 3]] for i in range(3)])
    directed, uses = np.unique(sides, axis=0, return_counts=True)
    assert np.all(uses == 1)
    assert {tuple(side) for side in directed} == {tuple(side[::-1]) for side in directed}
    assert volume(mesh) > 0
    assert np.all(mesh.closed)


@pytest.mark.parametrize("name", [*CLOSED, "plane", "sheet"])
def test_normals_are_unit_vectors_on_the_side_of_their_face(name):
    mesh = CLOSED[name]() if name in CLOSED else getattr(primitives, name)((2, 3), (3, 2))
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=-1), 1, atol=1e-6)
    face = face_normals(mesh.points, mesh.triangles)
    assert np.all(np.einsum("fci,fi->fc", mesh.normals, face) > 0)


def test_volumes_match_closed_forms():
    assert volume(primitives.box((1, 2, 3))) == pytest.approx(6)
    assert volume(primitives.sphere(1.5, 96)) == pytest.approx(4 / 3 * np.pi * 1.5**3, rel=5e-3)
    torus = volume(primitives.torus(1.0, 0.3, 96, 48))
    assert torus == pytest.approx(2 * np.pi**2 * 0.3**2, rel=5e-3)
    assert volume(primitives.cylinder(0.5, 2.0, 96)) == pytest.approx(np.pi * 0.5, rel=5e-3)


def test_plane_faces_up_and_sheet_faces_the_viewer():
    assert np.allclose(primitives.plane((2, 2)).normals, (0, 1, 0))
    assert np.allclose(primitives.sheet((2, 2)).normals, (0, 0, 1))
    assert not np.any(primitives.sheet().closed)


def test_blob_refuses_cells_that_meet_in_an_edge():
    with pytest.raises(ValueError, match="must meet in faces"):
        primitives.blob([(0, 0, 0), (1, 1, 0)])


def test_join_keeps_slots_and_geometry():
    joined = join([primitives.box(), primitives.box().painted(1).moved((5, 0, 0))])
    assert volume(joined) == pytest.approx(2)
    assert joined.slots.tolist() == [0] * 12 + [1] * 12


def average(point_value, position, width, resolution=400):
    """Mean of a function over a box, by brute force."""
    steps = (np.arange(resolution) + 0.5) / resolution - 0.5
    u, v = np.meshgrid(position[0] + width[0] * steps, position[1] + width[1] * steps)
    return point_value(u, v).mean()


def board(u, v):
    return ((np.floor(2 * u) + np.floor(2 * v)) % 2).astype(float)


def brick_wall(u, v, joint=0.2, bond=0.5):
    shifted = u + bond * (np.floor(v) % 2)
    return ((shifted % 1 < 1 - joint) & (v % 1 < 1 - joint)).astype(float)


BOXES = [((0.3, 0.7), (0.2, 0.9)), ((-3.4, 12.1), (1.7, 0.3)), ((5.2, -0.6), (7.3, 4.1))]


@pytest.mark.parametrize(("position", "width"), BOXES)
def test_checker_and_brick_are_exact_box_averages(position, width):
    place, extent = jnp.array(position)[:, None], jnp.array(width)[:, None]
    joint, bond = jnp.array([0.2]), jnp.array([0.5])
    checker = materials.filtered_checker(place, extent)[0]
    brick = materials.filtered_brick(place, extent, joint, bond)[0]
    # Brute force on a grid of 400 has an error too: edges cut cells.
    assert float(checker) == pytest.approx(average(board, position, width), abs=5e-3)
    assert float(brick) == pytest.approx(average(brick_wall, position, width), abs=5e-3)


def test_a_narrow_footprint_gives_the_point_value():
    generator = np.random.default_rng(0)
    place = generator.uniform(-5, 5, (2, 200))
    width = jnp.full((2, 200), materials.SMALLEST_WIDTH)
    checker = np.asarray(materials.filtered_checker(jnp.asarray(place), width))
    assert np.mean(np.abs(checker - board(*place)) < 1e-2) > 0.98


def test_noise_levels_keep_the_mean_and_repeat():
    texels = jnp.asarray(materials.noise_texels())
    mean = float(texels[: 256**2].mean())
    assert texels.size == (4**9 - 1) // 3
    assert float(texels[-1]) == pytest.approx(mean, abs=1e-5)
    place = jnp.array([[0.31, 1.31, 0.31], [0.77, 0.77, -2.23]])
    fine = materials.filtered_noise(texels, place, jnp.full((2, 3), 1e-4))
    coarse = materials.filtered_noise(texels, place, jnp.full((2, 3), 4.0))
    np.testing.assert_allclose(fine, fine[0], atol=1e-4)
    np.testing.assert_allclose(coarse, mean, atol=1e-3)


def test_noise_at_a_texel_center_is_that_texel():
    texels = jnp.asarray(materials.noise_texels())
    place = (jnp.array([[7], [100]]) + 0.5) / 256
    value = materials.filtered_noise(texels, place, jnp.full((2, 1), 1e-4))
    assert float(value[0]) == pytest.approx(float(texels[100 * 256 + 7]), abs=1e-5)


def test_colors_are_read_as_srgb():
    np.testing.assert_allclose(materials.linear_color("#ffffff"), 1)
    np.testing.assert_allclose(materials.linear_color("#808080"), 0.2158605, atol=1e-6)
    with pytest.raises(ValueError, match="must look like '#rrggbb'"):
        materials.linear_color("red")


def test_mesh_files_are_read(tmp_path):
    pytest.importorskip("trimesh")
    path = tmp_path / "box.obj"
    corners = primitives.box((2, 2, 2))
    lines = [f"v {x} {y} {z}" for x, y, z in corners.points]
    lines += [f"f {a} {b} {c}" for a, b, c in corners.triangles + 1]
    path.write_text("\n".join(lines) + "\n")
    mesh = load_mesh(path)
    assert volume(mesh) == pytest.approx(8)
    assert np.all(mesh.closed)


def test_mesh_files_that_are_missing_or_empty_are_refused(tmp_path):
    pytest.importorskip("trimesh")
    with pytest.raises(FileNotFoundError, match=r"none\.obj: no such mesh file"):
        load_mesh(tmp_path / "none.obj")
    points = tmp_path / "points.obj"
    points.write_text("v 0 0 0\nv 1 0 0\n")
    with pytest.raises(ValueError, match=r"points\.obj: holds no triangles"):
        load_mesh(points)


def test_without_trimesh_the_extra_is_named(monkeypatch):
    real = builtins.__import__

    def fail(name, *arguments, **keywords):
        if name == "trimesh":
            raise ModuleNotFoundError(name)
        return real(name, *arguments, **keywords)

    monkeypatch.setattr(builtins, "__import__", fail)
    with pytest.raises(ModuleNotFoundError, match=r"jaxblur\[mesh\]"):
        load_mesh("any.obj")
