"""Parts that are copied as they are stored."""

import contextlib
import warnings

import numpy as np
import OpenImageIO as oiio
import pytest

from jaxblur import exr
from jaxblur.exr import chunks, write_like
from tests.exr_files import make_spec, plain_frame, read_raw, write_parts

SHAPE = (40, 24)


def source_of(path, compression, tile=0, name="data"):
    """Color in the middle of three parts; whole numbers and floats with any bits around it."""
    generator = np.random.default_rng(1)
    color = {c: generator.random(SHAPE, np.float32) for c in "RGB"}
    others = {k: v for k, v in plain_frame(SHAPE).items() if k not in "RGB"}
    bits = generator.integers(0, 2**32, SHAPE, np.uint32).view(np.float32)
    first = {"id.X": bits, "id.Y": bits}
    specs = [
        make_spec(first, name="id"),
        make_spec(color, "half", name="rgb"),
        make_spec(others, name=name),
    ]
    for spec in specs:
        spec.attribute("compression", compression)
        spec.tile_width = spec.tile_height = tile
    with np.errstate(invalid="ignore"):
        return write_parts(path, list(zip(specs, (first, color, others), strict=True)))


@pytest.fixture
def copies(monkeypatch):
    """What is copied as it is stored, and how often pixels are decoded."""
    found = []
    copy = write_like.copy_chunks
    monkeypatch.setattr(
        write_like, "copy_chunks", lambda *given: (found.append(given[2]), copy(*given))[1]
    )
    return found


# What is decoded is looked at.
@pytest.mark.filterwarnings("ignore:.*NaN or infinity in id:jaxblur.exr.JaxblurIOWarning")
@pytest.mark.parametrize("tile", [0, 16])
@pytest.mark.parametrize("compression", ["none", "rle", "zips", "zip", "piz", "pxr24"])
def test_other_parts_are_copied_bit_for_bit(tmp_path, copies, compression, tile):
    source = source_of(tmp_path / "a.exr", compression, tile)
    image = np.random.default_rng(2).random((*SHAPE, 3), np.float32)
    exr.write_image(tmp_path / "o.exr", image, like=source)
    for part in (0, 2):
        (spec, old), (written, new) = (read_raw(tmp_path / p, part) for p in ("a.exr", "o.exr"))
        np.testing.assert_array_equal(
            np.asarray(old).view(np.uint32), np.asarray(new).view(np.uint32)
        )
        assert spec.tile_width == written.tile_width
    stored = exr.read_channels(tmp_path / "o.exr", ["rgb.R", "rgb.G", "rgb.B"])
    np.testing.assert_allclose(stored, image, atol=1e-3)
    # Lossy parts are decoded and stored without loss.
    assert copies == ([] if compression == "pxr24" else [{0: 0, 2: 2}])
    if copies:
        again = tmp_path / "2.exr"
        exr.write_image(again, image, like=source)
        assert again.read_bytes() == (tmp_path / "o.exr").read_bytes()


def test_the_copy_is_whole_for_another_reader(tmp_path):
    source = source_of(tmp_path / "a.exr", "zip")
    exr.write_image(tmp_path / "o.exr", np.ones((*SHAPE, 3), np.float32), like=source)
    buffer = oiio.ImageBuf(str(tmp_path / "o.exr"), 2, 0)
    assert buffer.read(2, 0, True) and buffer.nsubimages == 3


def test_a_part_with_missing_chunks_is_no_copy(tmp_path, copies):
    source = source_of(tmp_path / "a.exr", "zips")
    data = source.read_bytes()
    source.write_bytes(data[: len(data) - 200])
    with pytest.raises(exr.JaxblurIOError):
        exr.write_image(tmp_path / "o.exr", np.ones((*SHAPE, 3), np.float32), like=source)
    assert not (tmp_path / "o.exr").exists() and {0: 0, 2: 2} not in copies


def test_a_part_without_a_number_of_chunks_is_not_copied(tmp_path, copies):
    source = source_of(tmp_path / "a.exr", "zip")
    source.write_bytes(source.read_bytes().replace(b"chunkCount", b"chunkKount", 1))
    with contextlib.suppress(exr.JaxblurIOError), warnings.catch_warnings():
        warnings.simplefilter("ignore", exr.JaxblurIOWarning)
        exr.write_image(tmp_path / "o.exr", np.ones((*SHAPE, 3), np.float32), like=source)
    assert copies == []


def test_chunks_that_overlap_are_not_copied(tmp_path, copies):
    source = source_of(tmp_path / "a.exr", "zips")
    data = source.read_bytes()
    with source.open("rb") as file:
        first, *_ = chunks._parts(file)
    table = slice(first.table, first.table + 8 * first.chunks)
    source.write_bytes(data.replace(data[table], first.chunks * data[table][:8]))
    # OpenImageIO may read such a file: then the part is decoded, which limits its size.
    with contextlib.suppress(exr.JaxblurIOError), warnings.catch_warnings():
        warnings.simplefilter("ignore", exr.JaxblurIOWarning)
        exr.write_image(tmp_path / "o.exr", np.ones((*SHAPE, 3), np.float32), like=source)
    assert copies == []


def test_many_parts_are_compared_in_one_pass(tmp_path, monkeypatch):
    extra = {"X": np.zeros(SHAPE, np.float32)}
    parts = [(make_spec(extra, name=f"p{index}"), extra) for index in range(40)]
    color = {c: np.zeros(SHAPE, np.float32) for c in "RGB"}
    source = write_parts(tmp_path / "a.exr", [(make_spec(color, name="rgb"), color), *parts])
    found, parse = [], chunks._parts
    monkeypatch.setattr(chunks, "_parts", lambda file: (found.append(file), parse(file))[1])
    exr.write_image(tmp_path / "o.exr", np.ones((*SHAPE, 3), np.float32), like=source)
    # Both files when they are compared, and when chunks are copied.
    assert len(found) == 4


def test_non_finite_values_are_repaired_on_request(tmp_path, copies):
    source = source_of(tmp_path / "a.exr", "zip")
    with pytest.warns(exr.JaxblurIOWarning, match=r"id\.X"):
        exr.write_image(
            tmp_path / "o.exr", np.ones((*SHAPE, 3), np.float32), like=source, nonfinite="zero"
        )
    stored = exr.read_channels(tmp_path / "o.exr", ["id.X", "id.Y"])
    assert not copies and np.isfinite(stored).all()
