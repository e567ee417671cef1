"""Cryptomatte ranks that fit a blurred picture: any linear blur, many things in few images."""

import numpy as np
import pytest

from jaxblur import exr
from jaxblur.exr.cryptomatte import CryptomatteLayer

SIZE = (96, 160)
CHANNELS = tuple(f"C0{rank}.{letter}" for rank in range(3) for letter in "RGBA")
LAYER = CryptomatteLayer("", "C", CHANNELS, {})


def ranks_of(mattes, layer=LAYER):
    """The ranks of (things, H, W) coverages; a thing's identifier is its number times 1000."""
    things, row, column = np.nonzero(mattes)
    return exr.Ranks(
        *(layer, mattes.shape[1:], (row * mattes.shape[2] + column).astype(np.int32)),
        *((1000 + 1000 * things).astype(np.uint32), mattes[things, row, column]),
    )


def crowd(seed=0, count=40, size=SIZE):
    """Boxes over a ground, with partial coverages."""
    generator = np.random.default_rng(seed)
    mattes = np.zeros((count, *size), np.float32)
    mattes[0] = 1
    for index in range(1, count):
        row, column = generator.integers(0, size[0] - 8), generator.integers(0, size[1] - 8)
        box = np.s_[row : row + generator.integers(3, 9), column : column + 6]
        share = generator.uniform(0.3, 1)
        mattes[:, *box] *= np.float32(1 - share)
        mattes[index, *box] = share
    return mattes


def moved(image, column):
    """The mean of an image at several places, in all but the upper rows."""
    columns = range(-column, column + 1)
    mean = np.mean([np.roll(image, shift, axis=1) for shift in columns], axis=0)
    mean[:20] = image[:20]
    return mean.astype(np.float32)


def expected_of(mattes, blur):
    return blur(mattes.transpose(1, 2, 0)).transpose(2, 0, 1)


def matte(change, base, identifier):
    """The matte that programs cut: of the ranks that are changed, and of the others."""
    result = np.zeros(base.size, np.float32).ravel()
    own = base.identifiers == identifier
    result[base.pixels[own]] = base.coverages[own]
    hit = change.values.view(np.uint32)[:, ::2] == identifier
    result[change.pixels] = (change.values[:, 1::2] * hit).sum(axis=1)
    return result.reshape(base.size)


def run(base, images, blur, reach, moves=None):
    calls = []

    def counted(planes):
        calls.append(planes)
        assert all(each.shape[2] == exr.PLANES for each in planes)
        return blur(planes)

    moves = moves or [None] * len(images)
    (change,) = exr.blur_ranks([base], images, counted, reach=reach, moves=moves)
    assert (np.diff(change.pixels) > 0).all()
    return change, len(calls)


@pytest.mark.parametrize("reach", [5, 0])
def test_mattes_of_many_things_are_their_blurred_mattes(reach):
    mattes = crowd()
    base = ranks_of(mattes)
    # With a reach that is too short things are found far from their places, and blurred alone.
    step = 5 if reach else 60
    change, calls = run(base, [[base]], lambda planes: moved(planes[0], step), reach)
    expected = expected_of(mattes, lambda image: moved(image, step))
    dropped = np.sort(expected, axis=0)[:-6].max()
    for index, wanted in enumerate(expected):
        found = matte(change, base, 1000 + 1000 * index)
        np.testing.assert_allclose(found, wanted, atol=dropped + 2e-6)
    assert change.pixels.min() >= 20 * SIZE[1], "rows at rest"
    sums = change.values[:, 1::2].sum(axis=1)
    assert sums.max() <= 1 + 1e-6
    assert (np.diff(change.values[:, 1::2], axis=1) <= 0).all(), "in order of coverage"
    empty = change.values[:, 1::2] == 0
    assert (change.values[:, ::2][empty] == 0).all()
    if reach:
        assert dropped < 0.02 and calls <= 4, "40 things in 2 or 3 times 8 images"
    else:
        assert calls > 5, "some were blurred alone"


def test_things_of_a_neighbor_come_in():
    mattes = crowd(count=12)
    base = ranks_of(mattes)
    other = mattes.copy()
    other[5], other[0] = 0, other[0] + other[5]
    fewer = ranks_of(other)

    def blur(planes):
        return (planes[0] + planes[1]) / 2

    change, _ = run(fewer, [[fewer], [base]], blur, 0, [None, np.zeros((*SIZE, 2))])
    np.testing.assert_allclose(matte(change, fewer, 6000), mattes[5] / 2, atol=1e-6)


def test_what_moves_nothing_changes_nothing():
    base = ranks_of(crowd())
    change, calls = run(base, [[base]], lambda planes: planes[0], 0)
    assert change.pixels.size == 0 and calls == 1


def test_few_things_take_one_run():
    mattes = crowd(count=8)
    base = ranks_of(mattes)
    change, calls = run(base, [[base]], lambda planes: moved(planes[0], 4), 4)
    assert calls == 1
    wanted = expected_of(mattes, lambda image: moved(image, 4))
    np.testing.assert_allclose(matte(change, base, 1000), wanted[0], atol=2e-6)


def test_layers_are_told_apart():
    mattes = crowd(count=20)
    base = [ranks_of(mattes), ranks_of(mattes[::-1], LAYER)]
    first, second = exr.blur_ranks(
        *(base, [base], lambda planes: moved(planes[0], 3)), reach=3, moves=[None]
    )
    np.testing.assert_allclose(
        matte(first, base[0], 1000), matte(second, base[1], 20000), atol=1e-6
    )


def test_things_in_no_layer():
    base = ranks_of(np.zeros((1, 6, 9), np.float32))
    change, _ = run(base, [[base]], lambda planes: moved(planes[0], 3), 3)
    assert change.pixels.size == 0
