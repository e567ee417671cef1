"""Triangular motion paths: masks, coverage, occlusion, and equality with accumulation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxblur import metrics, scenes
from jaxblur.scenes import exposure, materials, motion, motion_paths, primitives
from jaxblur.scenes.intervals import (
    UNUSED,
    Clock,
    Intervals,
    bits_before,
    count_bits,
    covered_bits,
    first_and_last_bit,
    nearer_bits,
    negative_bits,
    sort_intervals,
)
from jaxblur.scenes.keyframes import light_table
from jaxblur.scenes.occlusion import visible_bits
from jaxblur.scenes.swept import edge_polynomials, sweep

pytestmark = pytest.mark.slow

SIZE = (36, 64)
BITS = 64
MIDDLES = (np.arange(BITS) + 0.5) / BITS
BOX = Clock(light_table("box"), jnp.array([-0.5, 0.5]))


def unpack(mask):
    """Masks (W, ...) as booleans (bits, ...)."""
    words = np.asarray(mask)
    bits = (
        words[:, None] >> np.arange(32, dtype=np.uint32).reshape(-1, *[1] * (words.ndim - 1))
    ) & 1
    return bits.reshape(-1, *words.shape[1:]).astype(bool)


def sheet_over_wall(velocity=(2.0, 0.0, 0.0)):
    """A bright square that moves in front of a dark wall, both without texture."""
    bodies = [
        scenes.Body("wall", primitives.sheet((30, 30)), materials.flat("#000000")),
        scenes.Body(
            "square",
            primitives.sheet((2, 2)),
            materials.flat("#ffffff", glow=1.0),
            motion.rigid((0, 0, 1), velocity=velocity),
        ),
    ]
    light = scenes.daylight(sun=(0, 0, 0), above=(0, 0, 0), below=(0, 0, 0))
    return scenes.make_scene("square", bodies, motion.camera((0, 0, 7), (0, 0, 0)), light)


def center_truth(scene, size=SIZE, samples=128, shutter=0.5):
    """The mean of sharp images with the sample position that `motion_paths` has by default.

    That is, at the pixels' centers, with textures averaged over a pixel.
    """
    times = shutter * ((np.arange(samples) + 0.5) / samples - 0.5)
    capacity = exposure.needed_capacity(scene.world, times[[0, -1]], size)

    @jax.jit
    def mean(world):
        def step(total, time):
            color, needed = exposure.sample_color(
                world, time, jnp.zeros(2), jnp.float32(1.0), size, capacity
            )
            return total + color, needed

        return jax.lax.scan(step, jnp.zeros((*size, 3)), jnp.asarray(times, jnp.float32))

    total, needed = mean(scene.world)
    assert np.all(np.max(needed, axis=0) <= np.array([capacity.rows, capacity.fragments]))
    return total / samples


def test_masks_count_and_bound_their_bits():
    moments = jnp.array([-1.0, 0.0, 0.49, 0.51, 31.5, 32.6, 63.49, 64.0, 99.0])
    masks = bits_before(moments, BITS)
    counts = [0, 0, 0, 1, 31, 33, 63, 64, 64]
    assert count_bits(masks).tolist() == counts
    np.testing.assert_array_equal(unpack(masks), np.arange(BITS)[:, None] < np.array(counts))
    middle = masks[:, 5] & ~masks[:, 4]
    first, last = first_and_last_bit(middle)
    assert (int(first), int(last)) == (31, 32)


def test_the_sign_of_a_quadratic_is_found_in_closed_form():
    random = np.random.default_rng(0)
    polynomial = random.normal(size=(3, 500)).astype(np.float32)
    polynomial[2, :100] = 0  # linear
    polynomial[1:, :20] = 0  # constant
    polynomial[2, 100:200] *= 1e-6
    found = unpack(negative_bits(jnp.asarray(polynomial), BOX, jnp.zeros(500, int), BITS))
    c0, c1, c2 = polynomial.astype(float)
    values = c0 + MIDDLES[:, None] * (c1 + MIDDLES[:, None] * c2)
    clear = np.abs(values) > 1e-5
    np.testing.assert_array_equal(found[clear], (values < 0)[clear])
    assert clear.mean() > 0.999


def test_the_bits_where_a_line_is_negative_are_found():
    line = jnp.array([[-10.2, 10.2, 1.0, -1.0], [0.5, -0.5, 0.0, 0.0]])
    found = unpack(nearer_bits(line, BITS))
    bit = np.arange(BITS)
    np.testing.assert_array_equal(found[:, 0], bit <= 20)
    np.testing.assert_array_equal(found[:, 1], bit > 20)
    assert not found[:, 2].any() and found[:, 3].all()


def random_sweep(count, closed, seed=1):
    random = np.random.default_rng(seed)
    points = random.uniform(-1, 1, (2, 3 * count, 3)) + np.array([0, 0, 3])
    triangles = jnp.arange(3 * count).reshape(count, 3)
    ray = np.append(random.uniform(-0.2, 0.2, (2, count)), np.ones((1, count)), axis=0)
    swept = sweep(
        jnp.asarray(points, jnp.float32), triangles, jnp.full(count, closed), jnp.float32(64), SIZE
    )
    return points, ray, swept


@pytest.mark.parametrize("closed", [False, True])
def test_coverage_equals_ray_casting_at_every_bit(closed):
    """Against a float64 solve of M w = ray at each bit, away from the edges."""
    count = 200
    points, ray, swept = random_sweep(count, closed)
    polynomials = edge_polynomials(swept, jnp.arange(count), jnp.asarray(ray, jnp.float32))
    still = jnp.zeros(count, int)
    found = unpack(covered_bits(polynomials, swept.forward, swept.closed, BOX, still, BITS))
    share = MIDDLES[:, None, None, None]
    corners = ((1 - share) * points[0] + share * points[1]).reshape(BITS, count, 3, 3)
    weights = np.linalg.solve(np.swapaxes(corners, -1, -2), ray.T[None, ..., None])[..., 0]
    inside = np.all(weights > 0, axis=-1)
    if closed:
        inside &= np.linalg.det(corners) < 0
    clear = np.min(np.abs(weights), axis=-1) > 1e-4
    np.testing.assert_array_equal(found[clear], inside[clear])
    twice = np.sum(np.diff(found.astype(int), axis=0, prepend=0) == 1, axis=0) > 1
    assert 0.05 < inside.mean() < 0.9 and twice.any(), "the test must cover twisted triangles"


def test_triangles_that_share_an_edge_split_the_bits():
    """A twisting quad: every covered bit belongs to exactly one of its halves."""
    random = np.random.default_rng(2)
    start = np.array([[-1, -1, 3], [1, -1, 3], [1, 1, 3], [-1, 1, 3.0]])
    points = np.stack([start, start + random.normal(scale=0.2, size=(4, 3))])
    triangles = jnp.array([[0, 1, 2], [2, 3, 0]])
    swept = sweep(
        jnp.asarray(points, jnp.float32), triangles, jnp.zeros(2, bool), jnp.float32(64), SIZE
    )
    ray = np.append(random.uniform(-0.15, 0.15, (2, 300)), np.ones((1, 300)), axis=0)
    ray = jnp.asarray(ray, jnp.float32)
    halves = []
    for half in (0, 1):
        owner = jnp.full(300, half)
        masks = covered_bits(
            edge_polynomials(swept, owner, ray),
            swept.forward[:, owner],
            swept.closed[owner],
            BOX,
            jnp.zeros(300, int),
            BITS,
        )
        halves.append(unpack(masks))
    assert np.all(halves[0] ^ halves[1])
    assert np.any(halves[0] & ~halves[0][0]), "the common edge must pass over some rays"


def pack(bits):
    words = bits.reshape(-1, 32, *bits.shape[1:]).astype(np.uint32)
    weights = (np.uint32(1) << np.arange(32, dtype=np.uint32)).reshape(
        1, 32, *[1] * (bits.ndim - 1)
    )
    return jnp.asarray(np.sum(words * weights, axis=1, dtype=np.uint32))


def random_intervals(cells, most, seed=3):
    """Up to `most` intervals per cell with lines that cross, in random order, padded."""
    random = np.random.default_rng(seed)
    cell = np.repeat(np.arange(cells), random.integers(0, most + 1, cells))
    random.shuffle(cell)
    ends = np.sort(random.integers(0, BITS, (2, len(cell))), axis=0)
    bit = np.arange(BITS)[:, None]
    covered = (bit >= ends[0]) & (bit <= ends[1])
    depths = random.uniform(1, 2, (2, len(cell)))
    slope = (depths[1] - depths[0]) / np.maximum(ends[1] - ends[0], 1)
    line = np.stack([depths[0] - slope * ends[0], slope])
    last = line[0] + slope * ends[1]
    pad = [(0, 40)]
    return Intervals(
        jnp.asarray(np.pad(cell, pad, constant_values=UNUSED), jnp.int32),
        jnp.asarray(np.pad(np.arange(len(cell)), pad), jnp.int32),
        jnp.pad(pack(covered), [(0, 0), *pad]),
        jnp.asarray(np.pad(line, [(0, 0), *pad]), jnp.float32),
        jnp.asarray(np.pad(np.minimum(depths[0], last), pad), jnp.float32),
        jnp.asarray(np.pad(np.maximum(depths[0], last), pad), jnp.float32),
    )


def test_every_bit_goes_to_the_nearest_interval():
    """Against brute force: at each bit of a cell, the covering line of least depth."""
    found = sort_intervals(random_intervals(60, 12))
    seen, overflow, longest = jax.jit(visible_bits, static_argnums=(1, 2))(found, 16, BITS)
    assert int(overflow) == 0 and int(longest) == 12
    cell, covered = np.asarray(found.cell), unpack(found.mask)
    line = np.asarray(found.line, float)
    depth = np.where(covered, line[0] + line[1] * np.arange(BITS)[:, None], np.inf)
    expected = np.zeros_like(covered)
    for number in range(60):
        mine = np.flatnonzero(cell == number)
        for bit in range(BITS):
            if len(mine) and covered[bit, mine].any():
                expected[bit, mine[np.argmin(depth[bit, mine])]] = True
    # A bit whose middle is at an intersection may go to either interval.
    disagree = unpack(seen) != expected
    assert disagree.mean() < 1e-3
    owners = np.zeros((60, BITS), int)
    np.add.at(owners, cell[cell != UNUSED], unpack(seen).T[cell != UNUSED])
    assert owners.max() == 1


def test_lists_that_are_cut_short_are_counted_unless_the_mask_is_full():
    full = np.ones((BITS, 5), bool)
    depth = jnp.arange(1.0, 6.0)
    stack = Intervals(
        jnp.zeros(5, jnp.int32),
        jnp.arange(5, dtype=jnp.int32),
        pack(full),
        jnp.stack([depth, jnp.zeros(5)]),
        depth,
        depth,
    )
    assert int(visible_bits(stack, 2, BITS)[1]) == 0
    full[0] = False
    seen, overflow, longest = visible_bits(stack._replace(mask=pack(full)), 2, BITS)
    assert (int(overflow), int(longest)) == (1, 5)
    np.testing.assert_array_equal(unpack(seen)[1], [True, False, False, False, False])


def test_an_edge_that_moves_over_a_pixel_covers_it_for_part_of_the_time():
    """Column x is covered until the left edge, at ``x0 + v t``, passes it."""
    size, shutter = (4, 64), 1.0
    scene = sheet_over_wall((1.5, 0.0, 0.0))
    focal = float(scene.world.camera.focal) * size[1]
    speed, left = focal * 1.5 / 6, 32 - focal / 6
    image = np.asarray(motion_paths(scene, 0.0, shutter, size))
    center = np.arange(64) + 0.5
    right = left + 2 * focal / 6
    entered = np.clip((center - right) / speed + 0.5, 0, 1)
    passed = np.clip((center - left) / speed + 0.5, 0, 1)
    np.testing.assert_allclose(image[1, :, 1], passed - entered, atol=0.5 / 128 + 1e-3)


def test_equals_antialiased_accumulation():
    scene = scenes.SCENES["crossing"]()
    image = motion_paths(scene, size=SIZE, spatial_samples=16)
    truth = scenes.accumulate(scene, samples=128, size=SIZE)
    assert float(metrics.psnr(image, truth)) > 40


def test_rotation_needs_pieces():
    scene = scenes.SCENES["gears"]()
    truth = center_truth(scene, samples=48, shutter=2.0)
    cut, whole = (motion_paths(scene, 0.0, 2.0, SIZE, pieces=pieces) for pieces in (None, 1))
    good, bad = (float(metrics.psnr(image, truth)) for image in (cut, whole))
    assert good > 38 and good > bad + 3, (good, bad)


def test_shutter_functions_weight_time():
    scene = sheet_over_wall()
    curve = "triangle"
    truth = scenes.accumulate(scene, samples=128, size=SIZE, shutter_function=curve)
    image = motion_paths(scene, size=SIZE, shutter_function=curve, pieces=3, spatial_samples=16)
    assert float(metrics.psnr(image, truth)) > 40


def test_more_bits_are_closer_to_the_truth():
    scene = sheet_over_wall((3.0, 1.0, 0.0))
    truth = center_truth(scene)
    errors = [
        float(metrics.mse(motion_paths(scene, size=SIZE, mask_bits=b), truth)) for b in (32, 128)
    ]
    assert errors[0] > 4 * errors[1]


def test_overflow_is_reported():
    scene = scenes.SCENES["crossing"]()
    with pytest.warns(RuntimeWarning, match=r"longer than `max_intervals` \(1\)"):
        motion_paths(scene, size=SIZE, max_intervals=1)
    with pytest.raises(OverflowError, match="give a larger number"):
        motion_paths(scene, size=SIZE, max_intervals=1, overflow="error")


def test_statistics_and_determinism():
    scene = sheet_over_wall()
    image, statistics = motion_paths(scene, size=SIZE, with_statistics=True)
    np.testing.assert_array_equal(image, motion_paths(scene, size=SIZE))
    assert image.dtype == jnp.float32
    # The wall is in every pixel, once or twice; the square in some.
    assert 1 < statistics.intervals_per_pixel < 2
    assert statistics.pieces == 1 and statistics.overflowing == 0
    assert 0 < statistics.sorting_share < 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"mask_bits": 48}, "`mask_bits` must be a positive multiple of 32, got 48"),
        ({"max_intervals": 0}, "`max_intervals` must be at least 1"),
        ({"pieces": 0}, "`pieces` must be at least 1"),
        ({"spatial_samples": 0}, "`spatial_samples` must be at least 1"),
        ({"texture_samples": 0}, "`texture_samples` must be at least 1"),
        ({"overflow": "ignore"}, "`overflow` must be one of warn, error"),
        ({"shutter": -0.1}, "`shutter` must not be negative"),
    ],
)
def test_refusals(arguments, message):
    with pytest.raises(ValueError, match=message):
        motion_paths(sheet_over_wall(), **arguments)
