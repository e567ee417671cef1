"""Several devices give what one gives; forced host devices, in a process of their own."""

import dataclasses
import functools
import json
import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur.devices import Blocks, plan_rows, row_reach
from jaxblur.filters import FILTERS, filter_info
from tests.exr_files import plain_frame, write_single
from tests.helpers import random_frame, random_noise

pytestmark = pytest.mark.slow

SCRIPT = """
import dataclasses, json, sys
import jax, jax.numpy as jnp, numpy as np
import jaxblur
from jaxblur.cli import blurring, main
from jaxblur.devices import blur_frames, blur_rows
from jaxblur.filters import FILTERS, filter_info
from jaxblur.noise import make_noise
from tests.helpers import random_frame, random_noise

devices, report = jax.devices(), {}

def note(label, one, many, color):
    difference, change = (np.abs(np.asarray(other) - one).max() for other in (many, color))
    report[label] = float(difference), float(change), len(many.sharding.device_set)

def rows(label, name, shape, used, settings={}, noise=random_noise, **fields):
    frame = dataclasses.replace(random_frame(shape, speed=30.0), **fields)
    kind = filter_info(name).kind
    settings = kind(**{"samples": 7, "radius": 8} | settings)
    options = {"settings": settings, "noise": noise(shape)}
    one = FILTERS[name](frame, filter_info(name).make_parameters(), **options)
    note(label, one, blur_rows(name, frame, devices=devices[:used], **options), frame.color)

rows("mcguire2012", "mcguire2012", (61, 20), 2)
rows("pixel_velocity, bilinear", "pixel_velocity", (61, 20), 2, {"fetch": "bilinear"})
# What is fast is on one device alone.
slow = random_frame((150, 20), speed=4.0).velocity.at[:30].multiply(8)
options = {"radius": 24, "fetch": "bilinear"}
rows("layered, bilinear", "layered", (150, 20), 2, options, velocity=slow)
rows("guertin2014, bilinear", "guertin2014", (61, 20), 2, {"fetch": "bilinear"})
mask = jnp.asarray(np.random.default_rng(5).random((79, 24)) > 0.2)
rows("three, masked", "guertin2014", (79, 24), 3, valid=mask)
rows("built-in noise", "guertin2014", (79, 24), 2, noise=lambda shape: None)
quick = jaxblur.Settings(samples=7, radius=8, backend="xla")
both = jax.tree.map(lambda *b: jnp.stack(b), *(random_frame((24, 20), seed=k) for k in range(2)))
one = jaxblur.blur_batch("guertin2014", both, settings=quick)
many = blur_frames("guertin2014", both, settings=quick, devices=devices[:2])
note("built-in noise, frames", one, many, both.color)

rows("few rows", "pixel_velocity", (9, 24), 3)
rows("far taps", "guertin2014", (120, 24), 2, {"samples": 2, "radius": 6, "border": "clamp"})
rows("rounded", "guertin2014", (61, 24), 2, {"split": "variance", "fetch": "bilinear"})

frames = jax.tree.map(lambda *b: jnp.stack(b), *(random_frame((24, 20), seed=k) for k in range(5)))
settings = jaxblur.Settings(samples=7, radius=8)
options = {"settings": settings, "noise": random_noise((24, 20))}
one = jaxblur.blur_batch("pixel_velocity", frames, **options)
note("frames", one, blur_frames("pixel_velocity", frames, **options), frames.color)

folder, used, blur = sys.argv[1], set(), blurring.blur

def noting(*arguments):
    used.add(str(jax.config.jax_default_device))
    return blur(*arguments)

blurring.blur = noting
few = ("--filter", "pixel_velocity", "--samples", "7", "--no-compile-cache", "-q")
status = main(["blur", folder + "/in.####.exr", "-o", folder + "/out.####.exr", *few])
difference = 0.0
for number in range(12):
    frame = jaxblur.read_frame(f"{folder}/in.{number:04d}.exr")
    noise = make_noise("ign", *frame.depth.shape, seed=number)
    settings = jaxblur.Settings(samples=7)
    one = np.asarray(jaxblur.pixel_velocity(frame, settings=settings, noise=noise))
    many = jaxblur.exr.read_image(f"{folder}/out.{number:04d}.exr")
    difference = max(difference, float(np.abs(one - many).max()))
report["sequence"] = status, difference, len(used)

def of(phi):
    return blur_rows("guertin2014", random_frame((90, 24)), jaxblur.GuertinParameters(phi=phi))

try:
    jax.jit(of)(27.0)
except ValueError as error:
    report["traced"] = str(error)
print(json.dumps(report))
"""


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """Largest difference to one device, largest change by the filter, devices used."""
    folder = tmp_path_factory.mktemp("sequence")
    for number in range(12):
        write_single(folder / f"in.{number:04d}.exr", plain_frame((40, 60), seed=number))
    flags = "--xla_force_host_platform_device_count=3 --xla_backend_optimization_level=1"
    outcome = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(folder)],
        env=os.environ | {"XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"},
        capture_output=True,
        text=True,
        timeout=400,
    )
    assert outcome.returncode == 0, outcome.stderr
    return json.loads(outcome.stdout.splitlines()[-1])


ROWS = (
    *("mcguire2012", "pixel_velocity, bilinear", "layered, bilinear", "guertin2014, bilinear"),
    *("three, masked", "far taps", "built-in noise"),
)


@pytest.mark.parametrize("label", ROWS)
def test_rows_are_those_of_the_whole_frame_to_the_bit(report, label):
    difference, change, devices = report[label]
    assert difference == 0
    assert change > 0.1 and devices == (3 if label == "three, masked" else 2)


def uneven_frame(shape, curved):
    """Fast at the top, slower below; masked here and there, and bent if it is to be."""
    frame = random_frame(shape)
    row, column = jnp.mgrid[: shape[0], : shape[1]]
    velocity = 12 * jnp.stack([jnp.cos(row / 80), jnp.sin(column / 90)], axis=-1)
    velocity = velocity.at[:20].multiply(3)
    valid = jnp.asarray(np.random.default_rng(5).random(shape) > 0.2)
    bend = 20 * np.random.default_rng(3).normal(size=velocity.shape)
    path = jnp.stack([bend - velocity, bend + velocity], axis=2).astype(jnp.float32)
    path = path if curved else None
    return dataclasses.replace(frame, velocity=velocity, path=path, valid=valid)


@pytest.mark.parametrize(
    ("name", "fetch", "radius", "curved"),
    [
        ("mcguire2012", "nearest", 40, False),
        ("pixel_velocity", "bilinear", 40, False),
        ("guertin2014", "nearest", 40, False),
        ("guertin2014", "bilinear", 40, False),
        ("layered", "nearest", 40, False),
        ("layered", "bilinear", 16, True),
    ],
)
def test_a_part_with_its_halo_is_the_whole_to_the_bit(name, fetch, radius, curved):
    """What is farther away, faster too, changes nothing."""
    frame, noise = uneven_frame((160, 152), curved), random_noise((160, 152))
    settings = jaxblur.Settings(samples=7, radius=radius, fetch=fetch)
    parameters = filter_info(name).make_parameters()
    tile, reach = row_reach(name, parameters, settings, curved=curved)
    halo = -(-reach // tile) * tile
    blur = functools.partial(FILTERS[name], settings=settings)
    whole = np.asarray(blur(frame, parameters, noise=noise))
    cut = np.s_[40 // tile * tile :, 40 // tile * tile :]
    part, own = jax.tree.map(lambda buffer: buffer[cut], (frame, noise))
    alone = np.asarray(blur(part, parameters, noise=own))
    inner = np.s_[halo:, halo:]
    assert whole[cut][inner].size > 1000
    np.testing.assert_array_equal(alone[inner], whole[cut][inner])
    assert np.abs(whole - frame.color).max() > 0.1
    assert np.abs(alone - whole[cut]).max() > 0.01, "without its halo it differs"


def test_rows_where_shares_are_rounded_at_other_places(report):
    difference, change, devices = report["rounded"]
    assert difference < 1e-5
    assert change > 0.1 and devices == 2


def test_a_frame_of_few_rows_stays_on_one_device(report):
    assert report["few rows"][0] == 0 and report["few rows"][2] == 1


def test_frames_are_those_of_one_device(report):
    difference, change, devices = report["frames"]
    assert difference < 1e-6
    assert change > 0.1 and devices == 3


def test_frames_on_several_devices_have_the_built_in_noise(report):
    difference, change, devices = report["built-in noise, frames"]
    assert difference < 1e-6
    assert change > 0.1 and devices == 2


def test_a_sequence_is_blurred_on_every_device(report):
    assert report["sequence"] == [0, 0.0, 3]


def test_traced_parameters_are_refused(report):
    assert "`parameters` must be numbers here" in report["traced"]


def test_blocks_begin_where_tiles_begin_and_cover_the_frame():
    blocks = plan_rows(height=103, devices=4, alignment=8, reach=16)
    assert blocks == Blocks(height=103, count=4, rows=32, halo=16)
    # The first has nothing above; the last but one sees only the seven rows of the last.
    assert blocks.windows == [(16, 64), (0, 64), (0, 55), (0, 23)]


def test_blocks_are_no_smaller_than_their_halo():
    assert plan_rows(height=100, devices=50, alignment=8, reach=24).rows == 24
    assert plan_rows(height=16, devices=4, alignment=8, reach=24).count == 1


def test_how_far_a_result_depends_on_other_rows():
    parameters, settings = jaxblur.GuertinParameters(), jaxblur.Settings(samples=35, radius=40)
    assert row_reach("guertin2014", parameters, settings) == (40, 80)
    # Few samples are jittered far beyond the end of their line: 13 spacings of two thirds.
    few = jaxblur.Settings(samples=2, radius=40)
    assert row_reach("guertin2014", parameters, few)[1] == 40 * 8.883 // 1 + 3
    with pytest.raises(ValueError, match="must be one of guertin2014"):
        row_reach("unknown", None, settings)
