"""Damaged files give one error or a frame that passes every check, never anything else."""

import numpy as np
import pytest

from jaxblur import exr
from tests.exr_files import DATA, plain_frame, write_single


def damaged(whole, generator):
    """Return a truncated, overwritten or bit-flipped copy of a file."""
    data = bytearray(whole)
    kind = generator.integers(3)
    if kind == 0:
        return bytes(data[: generator.integers(len(data))])
    for _ in range(generator.integers(1, 8)):
        limit = len(data) if generator.random() < 0.5 else 600
        position = generator.integers(limit)
        data[position] = (
            generator.integers(256) if kind == 1 else data[position] ^ (1 << generator.integers(8))
        )
    return bytes(data)


@pytest.mark.filterwarnings("ignore::jaxblur.exr.JaxblurIOWarning")
def test_damaged_files_give_one_error_or_a_checked_frame(tmp_path):
    generator = np.random.default_rng(11)
    originals = [
        write_single(tmp_path / "plain.exr", plain_frame((9, 12))).read_bytes(),
        (DATA / "falling_cubes_frame_0011.exr").read_bytes(),
    ]
    path = tmp_path / "damaged.exr"
    refused = 0
    for trial in range(200):
        path.write_bytes(damaged(originals[trial % 2], generator))
        try:
            buffers = exr.read_buffers(path)
        except exr.JaxblurIOError as error:
            refused += 1
            assert "\n" not in str(error)
            continue
        assert np.isfinite(buffers.color).all() and np.isfinite(buffers.velocity).all()
        assert np.abs(buffers.velocity).max() <= 1e6
        assert (buffers.depth > 0).all()
        output = tmp_path / f"out{trial}.exr"
        try:
            exr.write_image(output, buffers.color, like=path)
        except exr.JaxblurIOError:
            assert not output.exists()
        else:
            assert np.isfinite(exr.read_image(output)).all()
        assert not [file for file in tmp_path.iterdir() if file.name.startswith(".")]
    assert 50 < refused < 200
