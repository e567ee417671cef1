"""Pairs of frames across a cut, and values that jobs share."""

import gc
import itertools
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from jaxblur import exr
from jaxblur.sequence import Shared, cuts, is_cut
from tests.exr_files import CUBE, CUBE_NEXT, write_single


def frame(path, picture, x=0.0, y=0.0):
    """A frame with a picture, all of which moves by as many pixels a frame."""
    channels = {name: picture for name in "RGB"} | {"Z": np.ones_like(picture)}
    channels |= {"velocity.X": np.full_like(picture, x), "velocity.Y": np.full_like(picture, y)}
    return exr.read_buffers(write_single(path, channels), shutter=0.5)


def picture(seed=0, shape=(40, 80)):
    return np.random.default_rng(seed).random(shape, np.float32)


@pytest.mark.parametrize(("x", "y", "cut"), [(5, 2, False), (-5, -2, True), (0, 0, True)])
def test_vectors_bring_a_frame_onto_the_next(tmp_path, x, y, cut):
    first = frame(tmp_path / "1.exr", picture(), x, y)
    second = frame(tmp_path / "2.exr", np.roll(picture(), (2, 5), axis=(0, 1)), x, y)
    assert is_cut(first, second, 0.5) == cut


def test_another_picture_is_a_cut_and_a_still_one_is_not(tmp_path):
    first = frame(tmp_path / "1.exr", picture())
    assert is_cut(first, frame(tmp_path / "2.exr", picture(1)), 0.5)
    assert not is_cut(first, first, 0.5)


def test_what_is_compared_of_a_frame_is_found_once_and_goes_with_it(tmp_path, monkeypatch):
    found = []

    def counted(buffers, in_cells=cuts._in_cells):
        found.append(buffers.color[0, 0, 0])
        return in_cells(buffers)

    monkeypatch.setattr(cuts, "_in_cells", counted)
    frames = [frame(tmp_path / f"{k}.exr", picture(k)) for k in range(3)]
    is_cut(frames[0], frames[1], 0.5)
    is_cut(frames[1], frames[2], 0.5)
    assert sorted(found) == sorted(f.color[0, 0, 0] for f in frames)
    assert all(id(f) in cuts._KNOWN for f in frames)
    keys = [id(f) for f in frames]
    del frames
    gc.collect()
    assert not any(key in cuts._KNOWN for key in keys)


def test_vectors_that_are_as_long_as_the_picture_are_a_cut(tmp_path):
    first, second = frame(tmp_path / "1.exr", picture()), frame(tmp_path / "2.exr", picture(), 90)
    assert is_cut(first, second, 0.5) and is_cut(second, first, 0.5), "whichever frame has them"


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (3, 2)])
def test_black_frames_of_any_size_are_alike(tmp_path, shape):
    black = frame(tmp_path / "1.exr", np.zeros(shape, np.float32))
    assert not is_cut(black, black, 0.5)


def test_rendered_frames_belong_together():
    first, second = (exr.read_buffers(path) for path in (CUBE, CUBE_NEXT))
    assert not is_cut(first, second, 0.5)
    upside_down = {
        name: getattr(second, name)[::-1].copy() for name in ("color", "depth", "velocity")
    }
    assert is_cut(first, type(second)(**vars(second) | upside_down), 0.5)


def test_a_shared_value_is_made_once_and_forgotten_at_its_last_use():
    windows = [[n, n - 1, n + 1] for n in range(1, 60)]
    shared, made = Shared(itertools.chain(*windows)), []

    def make(number):
        made.append(number)
        return number * 10

    def work(numbers):
        return [future.result(10) for future in shared.take(numbers, make)]

    with ThreadPoolExecutor(3) as pool:
        values = list(pool.map(work, windows))
    assert values == [[10 * n for n in window] for window in windows]
    assert sorted(made) == list(range(61))
    assert not shared._kept


def test_no_order_keeps_many_values():
    order = [n * 37 % 101 for n in range(101)]
    shared, most = Shared([n for m in order for n in (m, m - 1, m + 1)], most=4), 0
    for m in order:
        shared.take((m, m - 1, m + 1), str)
        most = max(most, len(shared._kept))
    assert most == 4


def test_everybody_who_waits_gets_the_exception():
    shared, begun = Shared([1, 1]), threading.Event()

    def fail(_):
        begun.set()
        raise KeyboardInterrupt

    with ThreadPoolExecutor(1) as pool:
        first = pool.submit(shared.take, [1], fail)
        begun.wait(10)
        (second,) = shared.take([1], fail)
        assert isinstance(second.exception(10), KeyboardInterrupt)
        assert first.result(10)[0] is second
