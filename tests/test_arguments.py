"""Wrong arguments in Python: one error that names the argument and the remedy."""

import dataclasses
import pathlib
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur import bench
from jaxblur.cli.blurring import apply_filter
from jaxblur.devices import blur_frames, blur_rows
from jaxblur.filters import FILTERS
from jaxblur.filters.guertin2014 import tile_outcomes
from jaxblur.filters.registry import FilterInfo, filter_info
from jaxblur.fitting import Pair, search_settings
from jaxblur.fitting.evaluation import display_error
from jaxblur.fitting.pairs import make_pairs
from tests.helpers import random_frame, registered

FRAME = random_frame((7, 9))
BUFFERS = FRAME.color, FRAME.depth, FRAME.velocity
TRUTH = np.asarray(FRAME.color)
QUICK: Any = jaxblur.Settings(samples=3, radius=4, backend="xla")
JAX_INTERNALS = ("Traceback", "abstract array", "valid JAX type", "AttributeError", "beartype")


def refused(function, *arguments, **options):
    """The message of the ValueError or TypeError that a call raises."""
    with pytest.raises((ValueError, TypeError)) as caught:
        function(*arguments, **options)
    message = str(caught.value)
    assert not any(words in message for words in JAX_INTERNALS), message
    assert "\n" not in message
    return message


def parameters_of(name) -> Any:
    return filter_info(name).make_parameters()


@pytest.mark.parametrize("other", [*FILTERS, "nothing"])
@pytest.mark.parametrize("name", FILTERS)
def test_a_filter_rejects_the_parameters_of_another_by_name(name, other):
    given = {} if other == "nothing" else parameters_of(other)
    if type(given) is type(parameters_of(name)):
        return
    kind = filter_info(name).parameters
    for call in (FILTERS[name], jax.jit(FILTERS[name])):
        message = refused(call, FRAME, given, settings=QUICK)
        if kind is None:
            assert (
                f"`parameters` must be None: {name} has no parameters, not {type(given).__name__}"
            )
        else:
            says = (
                f"{name} takes {kind.__name__}, not {type(given).__name__}; pass {kind.__name__}("
            )
            assert says in message
    if given is not None:
        assert refused(jaxblur.blur_batch, name, [FRAME], given, settings=QUICK) == message
        assert refused(blur_rows, name, FRAME, given, settings=QUICK) == message


@pytest.mark.parametrize("name", FILTERS)
def test_a_filter_rejects_the_settings_of_another_by_name(name):
    @dataclasses.dataclass(frozen=True, kw_only=True)
    class OtherSettings(jaxblur.Settings):
        depth_of_field: int = 3

    info = filter_info(name)
    message = refused(FILTERS[name], FRAME, parameters_of(name), settings=OtherSettings())
    assert f"`settings` holds choices that {name} does not have (depth_of_field)" in message
    assert f"takes {info.kind.__name__}, not OtherSettings" in message
    for wrong in (None, parameters_of("layered"), {"samples": 3}, jaxblur.Settings, 35):
        message = refused(FILTERS[name], FRAME, parameters_of(name), settings=wrong)
        assert f"`settings` must be {info.kind.__name__}: {name} takes" in message
        assert f"settings=jaxblur.{info.kind.__name__}(...)" in message


def test_pixel_velocity_has_neither_parameters_nor_the_choices_of_guertin2014():
    message = refused(jaxblur.pixel_velocity, FRAME, jaxblur.GuertinParameters())
    assert message == (
        "`parameters` must be None: pixel_velocity has no parameters, not GuertinParameters; leave "
        "it out."
    )
    message = refused(jaxblur.pixel_velocity, FRAME, settings=jaxblur.GuertinSettings())
    assert "it takes Settings, not GuertinSettings; pass jaxblur.Settings" in message


@pytest.mark.parametrize(
    ("frame", "says"),
    [
        (BUFFERS, "got tuple; pass jaxblur.Frame(color, depth, velocity)"),
        ((FRAME, TRUTH), "got tuple; pass the first entry alone"),
        (jaxblur.Frame, "got the class Frame itself; pass jaxblur.Frame(color"),
        (TRUTH, "got an array (7, 9, 3); pass jaxblur.Frame(color, depth, velocity)"),
        ("beauty.exr", "got str; read the file: jaxblur.read_frame(path)"),
        (pathlib.Path("beauty.exr"), "read the file: jaxblur.read_frame(path)"),
        (None, "got NoneType; pass jaxblur.Frame"),
        (jaxblur.GuertinParameters(), "got GuertinParameters; pass jaxblur.Frame"),
    ],
)
def test_what_is_no_frame(frame, says):
    for name, function in FILTERS.items():
        message = refused(function, frame, parameters_of(name), settings=QUICK)
        assert message.startswith("`frame` must be a jaxblur.Frame, got") and says in message
    for function in (jaxblur.frame_statistics, jaxblur.finite_frame):
        assert says in refused(function, frame)
    assert "`frame_or_statistics` must be" in refused(jaxblur.plan, frame)
    assert says in refused(bench.frame_subject, "mine", frame)
    assert says in refused(blur_rows, "layered", frame)
    assert "`frames` must be a jaxblur.Frame" in refused(blur_frames, "layered", frame)
    assert says in refused(jaxblur.blur_batch, "layered", [frame])


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class OwnParameters:
    gain: float | jax.Array = jaxblur.parameter(2.0, low=0.0, meaning="brightness")


def brighten(frame, parameters, *, settings=QUICK, noise=None, strength=1.0):
    return strength * parameters.gain * frame.color


@pytest.fixture(params=["plain", "jitted", "decorated"])
def own(request):
    """A filter of one's own: called by its name, and the function itself if it checks."""
    function = {
        "plain": brighten,
        "jitted": jax.jit(brighten, static_argnames="settings"),
        "decorated": jaxblur.filters.takes(OwnParameters, more=("strength",))(brighten),
    }[request.param]
    info = FilterInfo(name="own", summary="", function=function, parameters=OwnParameters)
    with registered(info):
        by_name = FILTERS["own"]
        assert filter_info(by_name) is info is filter_info(function)
        yield by_name, *([function] if request.param == "decorated" else [])


@dataclasses.dataclass(frozen=True, kw_only=True)
class OwnSettings(jaxblur.Settings):
    gain: int = 3


@pytest.mark.parametrize("kind", [jaxblur.Settings, type("Plain", (jaxblur.Settings,), {})])
def test_a_filter_of_ones_own_finds_all_its_settings_whichever_class_is_given(kind):
    @jaxblur.filters.takes(None, OwnSettings)
    @jax.jit
    def brighter(frame, parameters=None, *, settings=OwnSettings(), noise=None):
        return settings.gain * settings.samples * frame.color

    found = brighter(FRAME, settings=kind(samples=5))
    np.testing.assert_allclose(found, 15 * FRAME.color, rtol=1e-6)
    assert "pass settings=OwnSettings(...)" in refused(brighter, FRAME, settings=None)
    assert "pass OwnSettings." in refused(brighter, FRAME, settings=jaxblur.GuertinSettings())


def test_settings_that_are_registered_as_arrays_are_rejected():
    @jax.tree_util.register_dataclass
    @dataclasses.dataclass(frozen=True, kw_only=True)
    class Wrong(jaxblur.Settings):
        gain: int = 3

    message = refused(jaxblur.filters.takes, None, Wrong)
    assert message == (
        "`Wrong` must be static, but its fields are registered with jax as arrays; remove "
        "@jax.tree_util.register_dataclass above Wrong."
    )


def test_a_filter_of_ones_own_rejects_what_it_does_not_take(own):
    for call in own:
        message = refused(call, FRAME.color, OwnParameters())
        assert message == (
            "`frame` must be a jaxblur.Frame, got an array (7, 9, 3); pass jaxblur.Frame(color, "
            "depth, velocity)."
        )
        message = refused(call, FRAME, None)
        assert message == (
            "`parameters` must be OwnParameters: own takes OwnParameters, not NoneType; pass "
            "OwnParameters()."
        ).replace("own takes", f"{call.__name__} takes")
        assert "`parameters` of" in refused(call, FRAME)
        assert "must be given by name" in refused(call, FRAME, OwnParameters(), QUICK)
        assert "leave it out" in refused(call, FRAME, OwnParameters(), blur=1)
        nan = FRAME.replace(velocity=FRAME.velocity.at[0, 0].set(jnp.nan))
        assert "`frame.velocity` is NaN" in refused(call, nan, OwnParameters())
        image = call(FRAME, OwnParameters(3.0), strength=2.0)
        np.testing.assert_allclose(image, 6 * FRAME.color, rtol=1e-6)


@pytest.mark.parametrize(
    ("result", "given"),
    [(None, "NoneType"), (FRAME.depth, "an array (7, 9)"), (np.zeros((2, 9, 3)), "an array (2, 9")],
)
def test_a_filter_that_returns_no_image_is_named(result, given):
    def broken(frame, parameters=None, *, settings=QUICK, noise=None):
        return result

    with registered(FilterInfo(name="broken", summary="", function=broken)):
        message = refused(apply_filter, "broken", FRAME, {}, QUICK)
    assert "broken must return an image, an array (7, 9, 'channels') of this frame" in message
    assert f"got {given}" in message


def test_a_frame_with_a_buffer_missing():
    frame = jaxblur.Frame(FRAME.color, None, FRAME.velocity)  # pyright: ignore
    message = refused(jaxblur.pixel_velocity, frame)
    assert message == "`frame.depth` must be an array, got None."


@pytest.mark.parametrize("name", FILTERS)
def test_how_a_filter_is_called(name):
    call: Any = FILTERS[name]
    parameters, info = parameters_of(name), filter_info(name)
    message = refused(call, FRAME, parameters, QUICK)
    assert message.startswith(f"`settings` of {name} must be given by name: {name}(frame")
    assert "must be given by name" in refused(call, FRAME, QUICK)
    assert "by position and the rest by name, got 3" in refused(call, FRAME, parameters, None)
    assert f"`frame` of {name} is missing" in refused(call, parameters=parameters)
    message = refused(call, FRAME, parameters, samples=9)
    assert message == (
        f"`samples` is a setting of {name}: pass settings={info.kind.__name__}(samples=...)."
    )
    assert "not `sample`; leave it out" in refused(call, FRAME, parameters, sample=9)
    assert "`noise` must be a jaxblur.Noise or None" in refused(
        call, FRAME, parameters, settings=QUICK, noise=np.zeros((7, 9))
    )
    if info.parameters is not None:
        kind = info.parameters.__name__
        assert f"`parameters` of {name} are missing: {name}(frame, {kind}())" in refused(
            call, FRAME
        )
        first = next(iter(info.parameter_infos))
        assert f"`{first}` is a parameter of {name}" in refused(call, FRAME, **{first: 2.0})
        assert f"the class {kind} itself; pass {kind}()" in refused(call, FRAME, info.parameters)
        assert f"pass {kind}(**values)" in refused(call, FRAME, {first: 2.0})
        text = dataclasses.replace(parameters, **{first: "4"})
        assert f"`parameters.{first}` must be a number, got '4'" in refused(call, FRAME, text)


def test_the_other_entries_of_guertin2014_check_too():
    for function in (tile_outcomes, jaxblur.luma_hint):
        assert f"{function.__name__} takes GuertinParameters, not LayeredParameters" in refused(
            function, FRAME, jaxblur.LayeredParameters()
        )
        assert "got tuple" in refused(function, BUFFERS, jaxblur.GuertinParameters())


@pytest.mark.slow
def test_subclasses_of_parameters_frames_and_tracers_are_accepted():
    @jax.tree_util.register_dataclass
    @dataclasses.dataclass(frozen=True)
    class Mine(jaxblur.GuertinParameters):
        pass

    def blur(frame, parameters):
        return jaxblur.guertin2014(frame, parameters, settings=QUICK)

    plain = jaxblur.GuertinParameters(kappa=30.0)
    expected = blur(FRAME, plain)
    np.testing.assert_array_equal(blur(FRAME, Mine(kappa=30.0)), expected)
    jitted = jax.jit(jaxblur.guertin2014)(FRAME, plain, settings=QUICK)
    np.testing.assert_allclose(jitted, expected, rtol=1e-5)
    stacked = jax.tree.map(lambda b: jnp.stack([b, b]), FRAME)
    many = jax.vmap(blur, in_axes=(0, None))(stacked, plain)
    np.testing.assert_allclose(many[1], expected, rtol=1e-5)
    each = jax.vmap(blur, in_axes=(None, 0))(FRAME, jax.tree.map(lambda p: jnp.full(2, p), plain))
    np.testing.assert_allclose(each[0], expected, rtol=1e-5)
    slope = jax.grad(lambda p: blur(FRAME, p).sum())(Mine(kappa=30.0))
    assert isinstance(slope, Mine) and np.isfinite(slope.kappa)
    jax.eval_shape(blur, FRAME, plain)

    @dataclasses.dataclass(frozen=True)
    class Unknown(jaxblur.GuertinParameters):
        pass

    message = refused(blur, FRAME, Unknown())
    assert "put @jax.tree_util.register_dataclass above Unknown" in message


def test_a_filter_of_ones_own_is_checked_where_the_package_calls_it():
    def plain(frame, parameters, *, settings=jaxblur.Settings(), noise=None):
        return frame.color

    with registered(FilterInfo(name="plain_color", summary="", function=plain)):
        message = refused(jaxblur.blur_batch, plain, [FRAME], jaxblur.LayeredParameters())
        assert "plain_color has no parameters, not LayeredParameters" in message
        message = refused(jaxblur.blur_batch, plain, [FRAME], settings=jaxblur.GuertinSettings())
        assert "plain_color does not have" in message


@pytest.mark.parametrize(
    ("pairs", "says"),
    [
        ((FRAME, TRUTH), "`pairs` must be a list of (frame, truth), got one pair; pass [pair]"),
        (FRAME, "`pairs` must be a list of (frame, truth), got a Frame without its truth"),
        (3, "`pairs` must be a list of (frame, truth), got int"),
        ([FRAME], "`pairs[0]` must be (frame, truth), got a Frame without its truth"),
        ([(FRAME,)], "`pairs[0]` must be (frame, truth), got tuple of 1"),
        ([(TRUTH, FRAME)], "`pairs[0]` must be (frame, truth), got (truth, frame); swap the two"),
        ([(FRAME, TRUTH), (BUFFERS, TRUTH)], "`pairs[1][0]` must be a jaxblur.Frame, got tuple"),
        ([(jaxblur.Frame, TRUTH)], "`pairs[0][0]` must be a jaxblur.Frame, got the class Frame"),
        ([(FRAME, "truth.exr")], "read the file: jaxblur.exr.read_image(path)"),
        ([(FRAME, None)], "`pairs[0][1]` must be the true image"),
        ([(FRAME, TRUTH[:3])], "pair 0: the truth must have shape (height, width, channels)"),
        ([(FRAME, TRUTH[..., 0])], "pair 0: the truth must have shape (height, width, channels)"),
        (
            [(FRAME, TRUTH[..., :1])],
            "pair 0: the truth must have 3 color channels like the frame, got 1",
        ),
    ],
)
def test_what_are_no_pairs(pairs, says):
    settings = {"settings": QUICK}
    assert says in refused(jaxblur.fit, "mcguire2012", pairs, **settings)
    assert says in refused(search_settings, "mcguire2012", pairs, tolerance=0.1, **settings)
    key = jax.random.key(0)
    parameters = jaxblur.McGuireParameters()
    assert says in refused(display_error, "mcguire2012", parameters, pairs, QUICK, key, 1)


def test_tuples_and_pairs_are_one_and_the_same():
    (pair,) = make_pairs([(FRAME, TRUTH)], ["mine"])
    assert isinstance(pair, Pair)
    assert make_pairs([pair]) == [pair] and make_pairs([pair], ["other"])[0].name == "other"
    key, parameters = jax.random.key(0), jaxblur.McGuireParameters()
    errors = [
        display_error("mcguire2012", parameters, [given], QUICK, key, 1)
        for given in (pair, (FRAME, TRUTH))
    ]
    assert errors[0] == errors[1]


def test_where_a_fit_starts_and_what_it_runs():
    pairs = [(FRAME, TRUTH)]
    for wrong in (jaxblur.LayeredParameters(), jaxblur.GuertinParameters, QUICK):
        message = refused(jaxblur.fit, "guertin2014", pairs, initial=wrong)
        assert message.startswith("`initial` must be GuertinParameters: guertin2014 takes")
    message = refused(jaxblur.fit, "guertin2014", pairs, settings=jaxblur.GuertinParameters())
    assert message.startswith("`settings` must be GuertinSettings: guertin2014 takes")


def test_the_truth_of_a_benchmark_has_the_shape_of_its_frame():
    for wrong in (TRUTH[:3], TRUTH[..., 0]):
        message = refused(bench.frame_subject, "mine", FRAME, wrong)
        assert "`truth` must have shape (7, 9, channels) like the frame" in message


def test_parameters_out_of_range_and_nan_are_refused_where_they_are_known():
    blur = jaxblur.guertin2014
    for value, says in ((-3.0, "got -3"), (0, "got 0"), (jnp.float32(jnp.nan), "got nan")):
        message = refused(blur, FRAME, jaxblur.GuertinParameters(kappa=value), settings=QUICK)
        assert message == f"`parameters.kappa` must be above 0, {says}."
        assert message == refused(
            blur_rows, blur, FRAME, jaxblur.GuertinParameters(kappa=value), settings=QUICK
        )
    bad = jaxblur.LayeredParameters(bend=np.float64("nan"))
    assert "`parameters.bend` must be" in refused(jaxblur.layered, FRAME, bad, settings=QUICK)
    traced = jax.jit(lambda bend: jaxblur.LayeredParameters(bend=bend).bend)
    assert np.isnan(traced(jnp.nan))


class Tensor:
    """An array of another library."""

    def __init__(self, values):
        self.values = values

    def __array__(self, dtype=None, copy=None):
        return self.values


def test_buffers_of_other_libraries_are_named():
    for name in ("color", "depth", "velocity"):
        values = np.asarray(getattr(FRAME, name))
        given = jaxblur.Frame(
            **{"color": FRAME.color, "depth": FRAME.depth}
            | {"velocity": FRAME.velocity}
            | {name: Tensor(values)}
        )
        message = refused(jaxblur.pixel_velocity, given, settings=QUICK)
        assert message.startswith(f"`frame.{name}` must be an array of NumPy or JAX, got Tensor")
        other = FRAME.replace(**{name: values.astype(">f4")})
        assert "newbyteorder" in refused(jaxblur.pixel_velocity, other, settings=QUICK)


def test_whole_numbers_of_numpy_are_settings():
    settings = jaxblur.Settings(samples=np.int32(9), radius=np.int64(20))
    assert settings == jaxblur.Settings(samples=9, radius=20) and type(settings.radius) is int
    assert "`spacing` must be a number" in refused(jaxblur.Settings, spacing="a")


def test_wrappers_for_several_devices_check_before_they_spread():
    frames = jax.tree.map(lambda buffer: jnp.stack([buffer, buffer]), FRAME)
    settings: Any = {"radius": 4}
    for function, given in ((blur_rows, FRAME), (blur_frames, frames)):
        message = refused(function, "guertin2014", given, settings=settings)
        assert "`settings` must be GuertinSettings" in message
        bad = given.replace(velocity=given.velocity.at[..., 1].set(jnp.nan))
        assert "velocity` is NaN" in refused(function, "guertin2014", bad, settings=QUICK)
    uneven = frames.replace(depth=frames.depth[:1])
    assert "`frames.depth` 1" in refused(blur_frames, "guertin2014", uneven, settings=QUICK)
    assert "stack them" in refused(blur_frames, "guertin2014", [FRAME, FRAME], settings=QUICK)
