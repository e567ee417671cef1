"""The registry: what it knows of the filters, what it rejects, and filters of one's own."""

import dataclasses
import os
import pathlib
import subprocess
import sys
import tomllib
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur import bench, show
from jaxblur.devices import blur_rows
from jaxblur.exr import read_image
from jaxblur.filters import FILTERS
from jaxblur.filters.registry import FilterInfo, filter_info, load_filter, names, register
from jaxblur.fitting import FitResult
from tests.command_line import refused, run
from tests.exr_files import CAR, plain_frame, write_single
from tests.helpers import random_frame, registered, slow

FILE = """
import dataclasses

import jax
import jaxblur


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Parameters:
    gain: float | jax.Array = jaxblur.parameter(2.0, above=0.0, meaning="brightness")
    lift: float | jax.Array = jaxblur.parameter(0.0, meaning="added light", free=False)


def brighten(frame, parameters, *, settings=jaxblur.Settings(), noise=None):
    return parameters.gain * frame.color + parameters.lift


jaxblur.register(
    jaxblur.FilterInfo(
        name="NAME", summary="brighter", function=brighten, parameters=Parameters, reads_color=True
    )
)
"""


@pytest.fixture
def brighten(tmp_path):
    """A file that registers a filter under a name of its own, and `FILE.py:NAME`."""
    name = f"brighten_{os.getpid()}_{abs(hash(tmp_path))}"
    path = tmp_path / "mine.py"
    path.write_text(FILE.replace("NAME", name), encoding="utf-8")
    yield f"{path}:{name}"
    if name in FILTERS:
        jaxblur.filters.unregister(name)


def plain(frame, parameters, *, settings=jaxblur.Settings(), noise=None):
    return frame.color


@pytest.mark.parametrize("name", FILTERS)
def test_records_and_the_registry_have_the_same_defaults(name):
    info = filter_info(name)
    record = info.make_parameters()
    assert info.defaults == ({} if record is None else vars(record))
    assert list(info.parameter_infos) == list(info.defaults)
    for known in info.parameter_infos.values():
        assert known.allows(known.default) and not known.allows(known.low - 1)
        assert not known.allows(float("nan")) and not known.allows(float("inf"))
    assert filter_info(FILTERS[name]) is info and info.call is FILTERS[name]
    assert FILTERS[name] is getattr(jaxblur, name)


def test_ranges_in_words():
    assert filter_info("guertin2014").parameter_infos["gamma"].range == "above 0 px"
    assert filter_info("guertin2014").parameter_infos["eta"].range == "0 spacings or more"
    assert filter_info("layered").parameter_infos["bend"].range == "0 to 1"
    assert [n for n, p in filter_info("guertin2014").parameter_infos.items() if p.free] == [
        *("kappa", "gamma", "tau", "phi")
    ]


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"above": 0.0, "low": 0.0}, "`above` and `low` must not both be given"),
        ({"above": 2.0}, "`default` must be above 2, got 1"),
        ({"low": 3.0, "high": 2.0}, "`low` must be a number below `high`"),
        ({"high": 2.0}, "`low` must be a number below `high`, got -inf and 2"),
        ({"useful": (2.0, 3.0)}, "`useful` must be two values around the default 1, got 2 and 3"),
        ({"useful": (0.1, 3.0), "ends": ("off", "")}, "`ends` must say what the filter does at 3"),
    ],
)
def test_ranges_that_are_rejected(options, match):
    with pytest.raises(ValueError, match=match):
        jaxblur.parameter(1.0, meaning="x", **options)


def test_every_parameter_says_where_it_stops_to_matter():
    for name in FILTERS:
        for known in filter_info(name).parameter_infos.values():
            first, last = known.useful
            assert known.useless(known.default) == "" and known.low < first < last
            assert known.useless(first) == known.useless(first / 10) == known.ends[0] != ""
            assert last == np.inf or known.useless(last) == known.useless(2 * last) == known.ends[1]
    sharpness = filter_info("guertin2014").parameter_infos["depth_sharpness"]
    assert sharpness.useless(0.0019) == "depth is switched off"


@pytest.mark.parametrize(
    ("name", "parameter", "end"),
    [
        *(("guertin2014", "gamma", 0), ("guertin2014", "phi", 0)),
        *(("guertin2014", "depth_sharpness", 0), ("mcguire2012", "soft_z_extent", 1)),
        *(slow("layered", "front_sharpness", 0), slow("layered", "own_tolerance", 1)),
        *(slow("layered", "landing_tolerance", 1), slow("layered", "distinct", 1)),
    ],
)
def test_beyond_the_useful_range_hardly_anything_changes(name, parameter, end):
    info, frame = filter_info(name), jaxblur.read_frame(CAR)
    edge = info.parameter_infos[parameter].useful[end]

    def blur(value):
        record = info.make_parameters(**{parameter: value})
        return np.asarray(info.call(frame, record))[..., :3]

    beyond = blur(edge * (10 if end else 0.1)) - blur(edge)
    blurred = blur(edge) - np.asarray(frame.color)[..., :3]
    assert np.sqrt(np.mean(beyond**2)) < 0.02 * np.sqrt(np.mean(blurred**2))


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"name": "layered"}, "there is a filter 'layered'"),
        ({"name": "a b"}, "`name` must be a word"),
        ({"function": "no reference"}, "`function` must be a function or 'module:attribute'"),
        ({"takes_neighbors": True}, "must take before and after and shutter by name, .*after=None"),
        ({"takes_shutter": True, "takes_lens": True}, "must take exposure and lens by name"),
        ({"parameters": int}, "`parameters` must be a dataclass or None"),
        ({"parameters": jaxblur.Frame}, "`Frame.color` must have a default made by"),
    ],
)
def test_records_that_are_rejected(changes, match):
    record: Any = {"name": "another", "summary": "", "function": plain} | changes
    with pytest.raises(ValueError, match=match):
        register(FilterInfo(**record))
    assert "another" not in FILTERS


def test_a_name_is_taken_once_and_the_same_object_is_harmless():
    info = FilterInfo(name="plain", summary="", function=plain)
    with registered(info):
        assert register(info) is info and filter_info(plain) is info
        assert names()[:4] == ("guertin2014", "mcguire2012", "pixel_velocity", "layered")
        assert list(FILTERS) == list(names()) and "plain" in FILTERS
        with pytest.raises(ValueError, match="there is a filter 'plain'; choose another name"):
            register(dataclasses.replace(info, function=lambda *_, settings, noise: None))
    assert "plain" not in FILTERS
    with pytest.raises(ValueError, match="must be a filter of your own, got 'layered'"):
        jaxblur.filters.unregister("layered")


def test_a_function_that_is_defined_again_takes_the_place_of_the_former():
    """As when the cell of a notebook runs again."""

    def cell(value):
        def brighter(frame, parameters, *, settings=None, noise=None):
            return frame.color + value

        return register(FilterInfo(name="brighter", summary="", function=brighter))

    frame = jaxblur.Frame(jnp.zeros((2, 3, 3)), jnp.ones((2, 3)), jnp.zeros((2, 3, 2)))
    try:
        for value in (1, 2):
            info = cell(value)
            assert filter_info("brighter") is info
            np.testing.assert_array_equal(FILTERS["brighter"](frame, None), value)
    finally:
        jaxblur.filters.unregister("brighter")


def test_unknown_filters_are_named_with_a_hint():
    match = r"one of guertin2014, .* got 'layerd' \(did you mean layered\?\)"
    with pytest.raises(ValueError, match=match):
        filter_info("layerd")
    with pytest.raises(
        KeyError, match=r"no filter 'layerd' \(did you mean layered\?\); there are g"
    ):
        FILTERS["layerd"]
    with pytest.raises(KeyError, match=r"'guertin' \(did you mean guertin2014\?\)"):
        FILTERS["guertin"]
    assert FILTERS.get("guertin") is None
    with pytest.raises(ValueError, match="`kapa` must be a parameter of guertin2014; it has kappa"):
        filter_info("guertin2014").make_parameters(kapa=1.0)
    with pytest.raises(ValueError, match="`split` must be a setting of layered; it has samples"):
        filter_info("layered").make_settings(split="even")


def test_bounds_hold_the_values_that_a_filter_takes():
    bounds = filter_info("layered").bounds
    assert bounds["bend"] == (0.0, 1.0) and bounds["distinct"] == (0.0, np.inf)
    for info in map(filter_info, names()):
        assert info.bounds.keys() == info.defaults.keys()
        for name, (low, high) in info.bounds.items():
            assert low <= info.defaults[name] <= high
            assert not info.parameter_infos[name].allows(low - 1e-3)
            assert not info.parameter_infos[name].allows(high + 1e-3)


def test_parameters_that_jax_does_not_know_are_rejected():
    @dataclasses.dataclass(frozen=True)
    class Unknown:
        gain: float = jaxblur.parameter(1.0, meaning="x")

    info = FilterInfo(name="unknown", summary="", function=plain, parameters=Unknown)
    with registered(info), pytest.raises(ValueError, match="register_dataclass above Unknown"):
        info.make_parameters()


def test_settings_of_other_filters_are_rejected():
    frame, settings = random_frame((4, 5)), jaxblur.GuertinSettings()
    match = r"layered does not have \(tile_choice, .*\): .*; pass jaxblur.LayeredSettings"
    with pytest.raises(ValueError, match=match):
        jaxblur.layered(frame, jaxblur.LayeredParameters(), settings=settings)
    with pytest.raises(ValueError, match="choices that mcguire2012 does not have"):
        bench.Case("mcguire2012", settings)
    assert bench.Case("guertin2014").settings == settings


def test_filters_of_ones_own_run_everywhere_but_where_they_say_no(brighten):
    info = load_filter(brighten)
    assert load_filter(brighten) is info
    frame = random_frame((12, 14))
    frames = [frame, dataclasses.replace(frame, color=2 * frame.color)]
    batch = jaxblur.blur_batch(info.name, frames, info.make_parameters(gain=3.0))
    np.testing.assert_allclose(batch[1], 6 * frame.color, rtol=1e-6)
    with pytest.raises(ValueError, match="must be one whose reach is known, got 'brighten"):
        blur_rows(info.name, frame)
    with pytest.raises(ValueError, match="whose weights do not depend on color"):
        show.texel_weights(info.name, frame, 1, 2)
    result = jaxblur.fit(
        info.name, [(frame, jnp.asarray(3.5 * frame.color))], steps=30, noise="builtin"
    )
    assert result.free == ("gain",) and result.parameters["lift"] == 0
    np.testing.assert_allclose(result.parameters["gain"], 3.5, rtol=1e-3)
    assert result.minimized.startswith("mse error of the image")


@pytest.mark.parametrize(
    ("text", "name", "match"),
    [
        (None, "mine", ": there is no such file"),
        ("", "mine", ": registers no filter; it must call jaxblur.register"),
        ("1 / 0", "mine", ":1: cannot be imported: ZeroDivisionError: division by zero"),
        ("x = = 1", "mine", ": cannot be imported: SyntaxError"),
    ],
)
def test_files_that_register_nothing_are_rejected(tmp_path, text, name, match):
    path = tmp_path / "filter.py"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    before = names()
    with pytest.raises(ValueError, match=f"{path}{match}"):
        load_filter(f"{path}:{name}")
    assert names() == before
    message = refused("blur", CAR, "-o", "x.exr", "--filter", f"{path}:{name}")
    assert match.rpartition("Error")[0] in message


def test_an_error_at_the_import_names_its_line(tmp_path):
    path = tmp_path / "filter.py"
    path.write_text("import jaxblur\n\nboost = jaxblur.parameter(1.0)\n", encoding="utf-8")
    with pytest.raises(ValueError, match=f"{path}:3: cannot be imported: TypeError"):
        load_filter(f"{path}:mine")


def test_another_name_than_the_file_registers_is_rejected(brighten):
    path, _, name = brighten.rpartition(":")
    with pytest.raises(ValueError, match=f"registers no filter 'darken'; give {path}:{name}"):
        load_filter(f"{path}:darken")
    message = f"{path}: is a file, not a filter in it; give {path}:{name}."
    with pytest.raises(ValueError, match=message):
        load_filter(path)
    assert message[:-1] in refused("blur", CAR, "-o", "x.exr", "--filter", path)
    with pytest.raises(ValueError, match=r"must be a name, or path/to/file.py:name"):
        load_filter("file:name")


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("1 / 0", "ZeroDivisionError: division by zero; -v shows"),
        ("frame.color + frame.depth", "ncompatible shapes"),
        ("if frame.depth[0, 0] > 1: pass", "take jnp.where in place of `if`"),
        ("numpy.asarray(frame.depth)", "take jax.numpy in place of numpy; -v shows"),
        ("float(frame.depth[0, 0])", "take jax.numpy in place of math"),
        ("range(frame.depth[0, 0].astype(int))", "take jax.lax.fori_loop in place of range()"),
    ],
)
def test_a_fault_in_a_filter_of_ones_own_is_one_line_that_names_its_place(
    tmp_path, brighten, fault, words
):
    path, _, name = brighten.rpartition(":")
    jitted = "import functools, numpy\n@functools.partial(jax.jit, static_argnames='settings')\n"
    text = FILE.replace("NAME", name).replace("def brighten", f"{jitted}def brighten")
    text = text.replace("    return", f"    {fault}\n    return")
    pathlib.Path(path).write_text(text, encoding="utf-8")
    line = next(number for number, row in enumerate(text.splitlines(), 1) if fault in row)
    frame = write_single(tmp_path / "in.exr", plain_frame((4, 5)))
    command = ("blur", frame, "-o", tmp_path / "out.exr", "--filter", brighten)
    message = refused(*command)
    assert f"{path}:{line}: " in message and words in message
    assert "Traceback" in run(*command, "-v").err


@pytest.mark.slow
def test_the_command_line_takes_a_file(tmp_path, brighten):
    out, name = tmp_path / "out.exr", brighten.rpartition(":")[2]
    assert run("blur", CAR, "-o", out, "--filter", brighten, "--param", "gain=0.5").status == 0
    expected = np.asarray(0.5 * jaxblur.read_frame(CAR).color)
    np.testing.assert_allclose(read_image(out), expected, rtol=2e-3, atol=1e-4)
    message = refused("blur", CAR, "-o", out, "--filter", brighten, "--param", "gain=0")
    assert "--param: gain must be above 0, got 0" in message

    fitted = tmp_path / "fitted.toml"
    options = ("--truth", str(out), "--crop", "48x32+0+0", "--steps", "3", "-q")
    assert run("fit", CAR, *options, "-o", fitted, "--filter", brighten).status == 0
    assert FitResult.load(fitted).filter == name
    again = tmp_path / "again.exr"
    given = ("--filter", brighten, "--parameters", fitted)
    assert run("blur", CAR, "-o", again, *given).status == 0

    rows = tmp_path / "rows.csv"
    given = ("--methods", brighten, "--samples", "9", "--repeats", "3", "-q")
    scene = ("--scene", "crossing", "--size", "32x20", "--truth-samples", "2")
    assert run("bench", "-o", rows, *given, *scene).status == 0
    assert [row["method"] for row in bench.read_rows(rows)] == [name]


def test_help_loads_no_jax():
    code = (
        "import contextlib, io, sys\nfrom jaxblur.cli import main\n"
        "with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()):\n"
        "    main(['blur', '--help'])\n"
        "print('jax' in sys.modules)"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.split() == ["False"]


def test_a_function_without_the_arguments_of_every_filter_is_rejected():
    info = FilterInfo(
        name="mine", summary="", function=lambda frame, parameters, *, settings: frame.color
    )
    with pytest.raises(ValueError, match=r"must take noise by name, .* settings=jaxblur.Settings"):
        register(info)


def test_plugins_are_found_and_broken_ones_are_named(tmp_path):
    info = tmp_path / "blurs-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: blurs\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[jaxblur.filters]\nmine = blurs:INFO\nbroken = blurs_broken\n"
    )
    (tmp_path / "blurs.py").write_text(
        "from jaxblur.filters.registry import FilterInfo\n"
        "def mine(frame, parameters, *, settings=None, noise=None):\n    return frame.color\n"
        "INFO = FilterInfo(name='mine', summary='', function=mine)\n"
    )
    code = (
        "import sys\nfrom jaxblur.filters.registry import filter_info, names\n"
        "filter_info('layered')\nprint('blurs' in sys.modules)\n"
        "print(filter_info('mine').function.__name__, 'jax' in sys.modules)\nprint(*names())"
    )
    path = os.pathsep.join([str(tmp_path), *sys.path])
    found = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"PYTHONPATH": path},
    )
    assert found.stdout.splitlines() == [
        "False",
        "mine False",
        "guertin2014 mcguire2012 pixel_velocity layered mine",
    ]
    assert found.stderr.count("the filter plug-in 'broken' of blurs (blurs_broken) cannot be") == 1


def result_of(name):
    """A result of a fit of no steps, for what its file holds of settings."""
    info = filter_info(name)
    return FitResult(
        filter=name,
        parameters=info.defaults,
        initial=info.defaults,
        published=info.defaults,
        free=(),
        minimized="",
        objective={},
        settings=dataclasses.asdict(info.settings),
        notes={},
        steps=0,
        interrupted=True,
        history={},
        scores=(),
        sensitivity=None,
        data=(),
        versions={},
    )


@pytest.mark.parametrize("name", ["guertin2014", "layered"])
def test_a_file_of_a_fit_that_is_older_than_a_setting_loads(tmp_path, name):
    path = tmp_path / "fitted.toml"
    result = result_of(name)
    result.save(path)
    text = path.read_text(encoding="utf-8")
    usual = filter_info(name).settings.backend
    assert f'backend = "{usual}"\n' in text
    path.write_text(text.replace(f'backend = "{usual}"\n', ""), encoding="utf-8")
    assert FitResult.load(path) == result
    path.write_text(text.replace("samples =", "sharpness = 3\nsamples ="), encoding="utf-8")
    with pytest.raises(ValueError, match=r"unknown key 'settings.sharpness'; remove it"):
        FitResult.load(path)
    path.write_text(text.replace('border = "skip"', 'border = "wrap"'), encoding="utf-8")
    with pytest.raises(ValueError, match=r"'border' must be one of"):
        FitResult.load(path)


def test_a_file_of_version_01_holds_choices_that_the_filter_ignored(tmp_path):
    path = tmp_path / "fitted.toml"
    old = result_of("layered")
    ignored: dict[str, Any] = {"tile_choice": "stochastic", "split": "even"}
    dataclasses.replace(old, settings=old.settings | ignored).save(path)
    assert tomllib.loads(path.read_text(encoding="utf-8"))["settings"]["split"] == "even"
    assert FitResult.load(path) == old
    assert FitResult.load(path).filter_settings == filter_info("layered").settings


def test_a_file_of_an_unknown_filter_is_rejected(tmp_path):
    path = tmp_path / "fitted.toml"
    dataclasses.replace(result_of("layered"), filter="lost").save(path)
    with pytest.raises(ValueError, match=rf"{path}: 'filter' must be one of .* got 'lost'"):
        FitResult.load(path)


def test_rows_that_are_older_than_a_setting_are_those_of_its_default(tmp_path):
    path = tmp_path / "rows.csv"
    path.write_text(
        "scene,method,samples,radius,fetch,tile_choice,ms\n"
        "crossing,guertin2014,9,20,nearest,own,3.5\n"
        "crossing,layered,9,20,nearest,own,4.5\n"
        "crossing,unblurred,9,20,nearest,own,0.5\n",
        encoding="utf-8",
    )
    guertin, layered, unblurred = bench.read_rows(path)
    expected = jaxblur.GuertinSettings(samples=9, radius=20, tile_choice="own")
    assert guertin.case == bench.Case("guertin2014", expected)
    assert layered.case == bench.Case(
        "layered", jaxblur.Settings(samples=9, radius=20, fetch="nearest")
    )
    assert layered["tile_choice"] == "" and layered["border"] == "skip"
    assert {unblurred[column] for column in ("samples", "tile_choice", "border")} == {""}
