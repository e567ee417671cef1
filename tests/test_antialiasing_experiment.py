"""The vegetation of experiment 017."""

import importlib

import numpy as np

vegetation = importlib.import_module("experiments.017_antialiasing.vegetation")


def test_a_strip_lies_around_its_curve_and_ends_in_a_tip():
    spine = np.array([[[0, height, 0] for height in (0, 1, 2, 3)]], float)
    mesh = vegetation.strips(spine, np.array([[1.0, 0, 0]]), np.array([0.3, 0.2, 0.1, 0]))
    corners = mesh.points.reshape(4, 2, 3)
    np.testing.assert_allclose(corners[:, 0, 0], [-0.3, -0.2, -0.1, 0])
    np.testing.assert_allclose(corners.mean(axis=1), spine[0])
    first, second, third = np.moveaxis(mesh.points[mesh.triangles], 1, 0)
    areas = np.linalg.norm(np.cross(second - first, third - first), axis=-1) / 2
    np.testing.assert_allclose(areas.sum(), 0.5 + 0.3 + 0.1)
    assert not mesh.closed.any(), "leaves are seen from both sides"


def test_vegetation_is_the_same_each_time_and_fits_the_smaller_arrays():
    one, other = vegetation.vegetation(), vegetation.vegetation()
    np.testing.assert_array_equal(one.world.points, other.world.points)
    assert one.world.points.shape == (65536, 3)
    assert sum("grass" in name for name in one.object_names) == 3
    used = np.unique(np.asarray(one.world.triangles))
    assert len(used) > 2 * vegetation.JOINTS * (vegetation.BLADES + vegetation.LEAVES)
