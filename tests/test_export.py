"""Printed filters against JAX where they run: C in a library, shaders in Chromium and Slang."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur.export import NotExpressible, graph_of, sources_of
from jaxblur.export.c import print_c
from jaxblur.export.compute import print_hlsl, print_wgsl
from jaxblur.export.fragments import print_glsl
from jaxblur.export.noise import tap_noise, tile_noise
from jaxblur.export.reference import SHARE, TOLERANCE, reference_planes
from jaxblur.filters.registry import FilterInfo, filter_info
from jaxblur.kernels import (
    Image,
    Outcome,
    each_pixel,
    largest_marks,
    mark_over,
    passes_as_equations,
    sum_over,
)
from jaxblur.noise import make_noise

from .helpers import random_frame, registered
from .ported import run_c, run_hlsl, run_sanitized, run_shaders, run_vulkan, shader_page

FILTERS = ("pixel_velocity", "mcguire2012", "guertin2014", "layered")
FETCHES = ("nearest", "bilinear")
DATA = "tests/data/cube_over_crates_frame_0011.exr"


@functools.cache
def frames():
    """A random frame of odd size, the reference frame, and a part of a rendered one."""
    graph = graph_of(filter_info("guertin2014"), channels=3)
    planes = reference_planes(graph)
    read = jaxblur.read_frame(DATA, shutter=0.5)
    rows, columns = slice(60, 105), slice(80, 147)
    rendered = [buffer[rows, columns] for buffer in (read.color, read.depth, read.velocity)]
    rendered[0] = rendered[0][..., :3]
    return (
        random_frame((37, 53), speed=12.0),
        jaxblur.Frame(planes["color"], planes["depth"][..., 0], planes["velocity"]),
        jaxblur.Frame(*rendered),
    )


def test_no_sample_of_the_reference_frame_lies_between_two_texels():
    # Rounding would decide there, and a port without noise fail on a frame that it blurs rightly.
    planes = reference_planes(graph_of(filter_info("guertin2014"), channels=3))
    speeds = np.unique(planes["velocity"].astype(np.float64).round(4))
    for count in range(2, 106):
        places = np.multiply.outer((2 * np.arange(count) + 1 - count) / (count + 1), speeds)
        assert np.abs(np.abs(places) % 1 - 0.5).min() > 5e-7, count


def planes_of(frame):
    planes = {"color": frame.color, "depth": frame.depth, "velocity": frame.velocity}
    return {name: np.asarray(plane, np.float32) for name, plane in planes.items()}


def settings_of(name, **changes):
    return dataclasses.replace(filter_info(name).settings, **changes)


def expected(name, frame, settings, **values):
    info = filter_info(name)
    return np.asarray(info.call(frame, info.make_parameters(**values), settings=settings))


def check(found, wanted):
    """What every port must keep."""
    assert found.shape == wanted.shape and np.isfinite(found).all()
    near = np.abs(found - wanted).max(axis=-1) <= TOLERANCE
    assert near.mean() >= SHARE, np.abs(found - wanted).max()


@pytest.mark.parametrize("fetch", [FETCHES[0], pytest.param(FETCHES[1], marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", FILTERS)
def test_c_equals_jax(name, fetch, tmp_path):
    settings = settings_of(name, fetch=fetch)
    graph = graph_of(filter_info(name), settings=settings, channels=3)
    text = print_c(graph)
    for frame in frames() if fetch == "bilinear" else frames()[:1]:
        found = run_c(graph, text, tmp_path, planes_of(frame))
        wanted = expected(name, frame, settings)
        assert np.abs(wanted - frame.color).max() > 0.05
        check(found, wanted)


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        {"tile_choice": "expected", "border": "clamp"},
        {"split": "variance", "spacing": 1.5, "noise": "none"},
        {"dominant": "soft", "tile_choice": "own", "radius": 13, "diagonal_tiles": "all"},
        {"directions": "one", "direction_weights": "off", "noise": "halton", "samples": 9},
    ],
    ids=lambda changes: "-".join(map(str, changes.values())),
)
def test_c_has_all_choices_of_guertin2014(changes, tmp_path):
    settings = settings_of("guertin2014", **changes)
    graph = graph_of(filter_info("guertin2014"), settings=settings, channels=3)
    frame = frames()[0]
    planes = planes_of(frame)
    noise = make_noise("halton", *frame.depth.shape)
    planes |= {"noise_tap": noise.tap, "noise_tile": noise.tile}
    names = {buffer.name for buffer in graph.inputs}
    assert ("noise_tap" in names) == (settings.noise == "halton")
    check(run_c(graph, print_c(graph), tmp_path, planes), expected("guertin2014", frame, settings))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["guertin2014", "layered"])
def test_c_stays_inside_its_arrays(name, tmp_path):
    graph = graph_of(filter_info(name), settings=settings_of(name, spacing=1.5), channels=3)
    text = print_c(graph)
    for shape in ((1, 1), (7, 41)):
        ran = run_sanitized(graph, text, tmp_path, shape)
        assert ran.returncode == 0, ran.stderr[-2000:]


@pytest.mark.slow
def test_the_sanitizer_reports_a_wrong_program(tmp_path):
    graph = graph_of(filter_info("pixel_velocity"), channels=3)
    text = print_c(graph)
    wrong = text.source.replace("* width + near_x;", "* width + near_x + 100000;")
    assert wrong != text.source
    ran = run_sanitized(graph, text._replace(source=wrong), tmp_path, (7, 41))
    assert ran.returncode != 0


@pytest.mark.slow
def test_c_follows_paths_and_parameters(tmp_path):
    frame = frames()[0]
    bend = jnp.asarray(np.random.default_rng(3).normal(size=frame.velocity.shape), jnp.float32)
    path = jnp.stack([bend - frame.velocity, bend + frame.velocity], axis=-2)
    frame = frame.replace(path=path)
    settings, info = settings_of("layered", samples=12, radius=30), filter_info("layered")
    graph = graph_of(info, settings=settings, channels=3, has_path=True)
    values = {name: 0.7 * value for name, value in info.defaults.items()}
    planes = planes_of(frame) | {"path": np.asarray(path, np.float32)}
    found = run_c(graph, print_c(graph), tmp_path, planes, list(values.values()))
    check(found, expected("layered", frame, settings, **values))
    assert np.abs(found - expected("layered", frame, settings)).max() > 0.01


def test_parameters_given_become_the_defaults(tmp_path):
    info = filter_info("mcguire2012")
    graph = graph_of(info, info.make_parameters(soft_z_extent=3.5), channels=3)
    text, frame = print_c(graph), frames()[0]
    assert ".soft_z_extent = 3.5f," in text.source
    found = run_c(graph, text, tmp_path, planes_of(frame))
    check(found, expected("mcguire2012", frame, info.settings, soft_z_extent=3.5))


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    with shader_page(tmp_path_factory.mktemp("shaders")) as opened:
        yield opened


@pytest.mark.slow
@pytest.mark.parametrize("fetch", FETCHES)
@pytest.mark.parametrize("name", FILTERS)
def test_wgsl_equals_jax(name, fetch, page):
    settings = settings_of(name, fetch=fetch)
    graph = graph_of(filter_info(name), settings=settings, channels=3)
    for frame in frames():
        found = run_shaders(page, "Webgpu", graph, print_wgsl(graph), planes_of(frame))
        check(found, expected(name, frame, settings))


@pytest.mark.slow
@pytest.mark.parametrize("fetch", FETCHES)
@pytest.mark.parametrize("name", FILTERS)
def test_glsl_equals_jax(name, fetch, page):
    settings = settings_of(name, fetch=fetch)
    graph = graph_of(filter_info(name), settings=settings, channels=3)
    for frame in frames():
        found = run_shaders(page, "Webgl", graph, print_glsl(graph), planes_of(frame))
        check(found, expected(name, frame, settings))


@pytest.mark.slow
@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize(
    ("run", "print_form"),
    [(run_vulkan, print_wgsl), (run_hlsl, print_hlsl)],
    ids=["wgsl through Vulkan", "hlsl"],
)
def test_shaders_equal_jax_outside_a_browser(run, print_form, name):
    settings = settings_of(name)
    graph = graph_of(filter_info(name), settings=settings, channels=3)
    for frame in frames():
        found = run(graph, print_form(graph), planes_of(frame))
        check(found, expected(name, frame, settings))


@pytest.mark.slow
def test_a_shader_takes_parameters(page):
    graph = graph_of(filter_info("guertin2014"), channels=3)
    frame, code = frames()[0], print_wgsl(graph)
    found = run_shaders(page, "Webgpu", graph, code, planes_of(frame), {"kappa": 2.0, "tau": 0.0})
    check(found, expected("guertin2014", frame, graph.settings, kappa=2.0, tau=0.0))


SHARES = 3


def compete(at, images, _, __):
    """In each share of the table, all pixels of a column leave marks at few places."""
    (color,) = images

    def mark(step):
        place = (step * color.height + at.row % 2) * color.width + at.column
        number = (at.row * 7919 + at.column * 104729 + (step + 1) * 1299709) * 48271
        # In the second share all have the same high bits, in the third the same low ones.
        number = jnp.where(step == 1, (number & 0xFFFF) | (5 << 16), number)
        number = jnp.where(step == 2, (number & 0x7FFF0000) | 5, number)
        return ((place, jnp.where(step < SHARES, number & 0x7FFFFFFF, 0)),)

    return Outcome(mark_over(jnp.float32(SHARES), mark))


def halves(at, images, _, __):
    """The bits of the marks, which a float holds 16 at a time."""
    (marks,) = images
    found = [marks.read(k * (marks.height // SHARES) + at.row, at.column)[0] for k in range(SHARES)]
    parts = [part for mark in found for part in (mark >> 16, mark & 0xFFFF)]
    return Outcome(tuple(part.astype(jnp.float32) for part in parts))


def competing(first, frame, parameters, *, settings=None, noise=None, apart=SHARES):
    """A filter that shows three of the halves of the largest marks."""
    height, width = frame.depth.shape
    length = SHARES * height * width
    marks = largest_marks(
        compete, (height, width), (Image(frame.color),), length, apart=apart, backend="xla"
    )
    table = Image(marks.reshape(SHARES * height, width, 1))
    bits = each_pixel(halves, (height, width), (table,), backend="xla")
    return bits[..., first : first + 3]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "print_form"), [("Webgpu", print_wgsl), ("Webgl", print_glsl)], ids=["wgsl", "glsl"]
)
def test_the_largest_mark_is_found_in_all_its_bits(kind, print_form, page):
    frame = frames()[0]
    for first in range(0, 2 * SHARES, 3):
        info = FilterInfo(
            name="own", summary="a test", function=functools.partial(competing, first)
        )
        with registered(info):
            graph = graph_of(info, channels=3)
        wanted = np.asarray(competing(first, frame, None))
        found = run_shaders(page, kind, graph, print_form(graph), planes_of(frame))
        assert np.array_equal(found, wanted) and wanted.max() > 2**14


def test_noise_has_the_bits_of_the_built_in_one():
    size = 41, 5000
    found = make_noise("ign", *size)
    tap = each_pixel(tap_noise, size, (), backend="xla")
    tile = each_pixel(tile_noise, size, (), backend="xla")
    assert np.array_equal(tap[..., 0], found.tap)
    assert np.array_equal(tile, found.tile)


def three(at, images, numbers, _):
    """The mean of three texels in a row, times a gain."""

    def sample(i):
        column = jnp.clip(at.column + i - 1, 0, images[0].width - 1)
        return [value * numbers[0] for value in images[0].read(at.row, column)]

    return Outcome(tuple(total / 3 for total in sum_over(3, sample)))


@dataclasses.dataclass(frozen=True)
class Gain:
    """Parameters of a filter of one's own."""

    gain: float = jaxblur.parameter(2.0, above=0.0, meaning="gain")


jax.tree_util.register_dataclass(Gain)


def own_filter(frame, parameters, *, settings=None, noise=None):
    """A filter with arithmetic between and after its passes."""
    brighter = frame.color[..., :2] + 0.5 * frame.velocity[..., :1]
    scale = jnp.asarray(parameters.gain, jnp.float32) ** 2
    blurred = each_pixel(three, frame.depth.shape, (Image(brighter),), (scale,))
    rows = jnp.arange(frame.depth.shape[0], dtype=jnp.float32)[:, None, None]
    both = jnp.concatenate([blurred, frame.color[..., 2:]], axis=-1)
    return both + rows * jnp.stack([blurred[..., 0], blurred[..., 0]]).sum(axis=0)[..., None]


def test_a_filter_of_ones_own_is_exported_with_what_lies_between_its_passes(tmp_path):
    info = FilterInfo(name="own", summary="a test", function=own_filter, parameters=Gain)
    with registered(info):
        graph = graph_of(info, channels=3)
        found = run_c(graph, print_c(graph), tmp_path, planes_of(frames()[0]))
        wanted = own_filter(frames()[0], Gain())
    np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-5)
    assert [node.name for node in graph.nodes] == ["make_image", "three", "make_blurred"]


def angle(at, images, _, __):
    """The angle of each channel and the next as coordinates of a point."""
    x, y, z = (value - 0.5 for value in images[0].here())
    return Outcome((jnp.arctan2(y, x), jnp.arctan2(z, y), jnp.arctan2(x, z)))


def curves(at, images, _, __):
    """Functions that every language has."""
    x, y, z = (value - 0.5 for value in images[0].here())
    angles = jnp.arcsin(x) + jnp.arccos(y) + jnp.arctan(4 * z)
    return Outcome((angles, jnp.sinh(3 * x) + jnp.cosh(y), jax.nn.sigmoid(9 * z)))


def exported(program):
    """A filter that runs the program once, its result, and its graph."""

    def function(frame, parameters, *, settings=None, noise=None):
        return each_pixel(program, frame.depth.shape, (Image(frame.color),), backend="xla")

    info = FilterInfo(name="own", summary="a test", function=function)
    with registered(info):
        return np.asarray(function(frames()[0], None)), graph_of(info, channels=3)


@pytest.mark.parametrize("program", [angle, curves])
def test_functions_mean_the_same_in_c(program, tmp_path):
    wanted, graph = exported(program)
    found = run_c(graph, print_c(graph), tmp_path, planes_of(frames()[0]))
    np.testing.assert_allclose(found, wanted, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("program", [angle, curves])
@pytest.mark.parametrize(
    ("kind", "print_form"), [("Webgpu", print_wgsl), ("Webgl", print_glsl)], ids=["wgsl", "glsl"]
)
def test_functions_mean_the_same_in_shaders(kind, print_form, program, page):
    wanted, graph = exported(program)
    found = run_shaders(page, kind, graph, print_form(graph), planes_of(frames()[0]))
    np.testing.assert_allclose(found, wanted, atol=1e-4)


def test_angles_reach_all_quadrants():
    wanted, _ = exported(angle)
    assert wanted.min() < -2 and wanted.max() > 2


def rejected_filter(frame, parameters, *, settings=None, noise=None):
    return each_pixel(sorts, frame.depth.shape, (Image(jnp.sort(frame.color, axis=0)),))


def sorts(at, images, _, __):
    return Outcome(images[0].here())


def erf_filter(frame, parameters, *, settings=None, noise=None):
    return each_pixel(erf, frame.depth.shape, (Image(frame.color),))


def erf(at, images, _, __):
    return Outcome(tuple(map(jax.scipy.special.erf, images[0].here())))


def test_what_has_no_form_is_refused_by_name():
    info = FilterInfo(name="own", summary="a test", function=rejected_filter)
    with registered(info), pytest.raises(ValueError, match="the operation sort between passes"):
        graph_of(info)
    info = FilterInfo(name="own", summary="a test", function=erf_filter)
    with registered(info):
        graph = graph_of(info)
    for language in ("c", "wgsl", "glsl", "hlsl"):
        match = rf"{language}: the operation erf has no form; .* It is at .*test_export.py:\d+\."
        with pytest.raises(NotExpressible, match=match):
            sources_of(graph, language)


def test_marks_without_a_number_have_no_form_in_glsl():
    function = functools.partial(competing, 0, apart=0)
    info = FilterInfo(name="own", summary="a test", function=function)
    with registered(info):
        graph = graph_of(info, channels=3)
    with pytest.raises(NotExpressible, match="the pass compete leaves any number of marks"):
        sources_of(graph, "glsl")
    assert "atomicMax" in sources_of(graph, "wgsl")["jaxblur_own.wgsl"]


def test_settings_that_cannot_be_exported_are_refused():
    info = filter_info("guertin2014")
    with pytest.raises(ValueError, match="`fetch` must be nearest or bilinear"):
        graph_of(info, settings=settings_of("guertin2014", fetch="blend"))
    with pytest.raises(ValueError, match="`radius` must be at most 2000"):
        graph_of(info, settings=settings_of("guertin2014", radius=2001))
    with pytest.raises(ValueError, match="`channels` must be at least 1"):
        graph_of(info, channels=0)
    with pytest.raises(ValueError, match=r"`settings\.samples` must be odd"):
        graph_of(filter_info("mcguire2012"), settings=settings_of("mcguire2012", samples=8))


def test_a_filter_still_runs_at_the_size_that_it_was_exported_at():
    # What jit has traced for the export must not be taken for what runs.
    info = filter_info("pixel_velocity")
    graph_of(info, channels=3)
    planes = [
        jax.ShapeDtypeStruct((5003, 20011, *more), jnp.float32)
        for more in ((3,), (), (2,), (), (2,))
    ]

    def run(color, depth, velocity, tap, tile):
        frame = jaxblur.Frame(color, depth, velocity)
        return info.call(frame, None, noise=jaxblur.Noise(tap, tile))

    assert "pass[" not in str(jax.make_jaxpr(run)(*planes))
    with passes_as_equations():
        assert "pass[" in str(jax.make_jaxpr(run)(*planes))
