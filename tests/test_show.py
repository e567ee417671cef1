import dataclasses
import subprocess
import sys
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

pytest.importorskip("matplotlib")

import jaxblur
from jaxblur import metrics, show
from jaxblur.filters import FILTERS, filter_info
from jaxblur.filters.taps import taps_at

from .helpers import random_frame, random_noise

pytestmark = pytest.mark.slow

SETTINGS = jaxblur.Settings(samples=9, radius=8)
UNKNOWN: Any = "unknown"


def moving_right(shape=(24, 40), speed=6.0):
    """A bright block that moves to the right in front of a static background, with sky above."""
    color = np.full((*shape, 3), 0.2, np.float32)
    color[8:16, 12:24] = (0.9, 0.5, 0.1)
    depth = np.full(shape, 10.0, np.float32)
    depth[8:16, 12:24] = 5.0
    depth[:4] = np.inf
    velocity = np.zeros((*shape, 2), np.float32)
    velocity[8:16, 12:24, 0] = speed
    return jaxblur.Frame(*map(jnp.asarray, (color, depth, velocity)))


def only_axes(figure) -> Any:
    return figure.axes[0]


@pytest.mark.parametrize(
    ("velocity", "color"),
    [
        ((0, 0), (1, 1, 1)),
        ((4, 0), (1, 0, 0)),
        ((9, 0), (1, 0, 0)),
        ((0, 4), (0.5, 1, 0)),
        ((-4, 0), (0, 1, 1)),
        ((0, -4), (0.5, 0, 1)),
        ((2, 0), (1, 0.5, 0.5)),
        ((np.nan, 0), (0.5, 0.5, 0.5)),
    ],
    ids=["still", "right", "beyond", "down", "left", "up", "half", "nan"],
)
def test_velocities_have_the_colors_of_the_wheel(velocity, color):
    np.testing.assert_allclose(show.velocity_colors(velocity, limit=4.0), color, atol=1e-12)


def test_opposed_velocities_have_complementary_colors():
    velocity = np.random.default_rng(0).normal(size=(50, 2))
    velocity /= np.linalg.norm(velocity, axis=-1, keepdims=True)
    both = show.velocity_colors(velocity, 1.0) + show.velocity_colors(-velocity, 1.0)
    np.testing.assert_allclose(both, 1.0, atol=1e-12)


def test_the_wheel_picture_shows_the_frame_and_its_legend_the_wheel():
    axes = only_axes(show.velocity_wheel(moving_right()))
    shown = axes.images[0].get_array()
    np.testing.assert_allclose(shown[10, 15], (1, 0, 0), atol=1e-6)
    np.testing.assert_allclose(shown[0, 0], (1, 1, 1))
    legend = axes.child_axes[0]
    disc = legend.images[0].get_array()
    np.testing.assert_allclose(disc[64, 126, :3], (1, 0, 0), atol=0.05)
    assert disc[0, 0, 3] == 0 and disc[64, 64, 3] == 1
    assert legend.texts[0].get_text() == "6 px"


def test_arrows_are_the_streaks_of_their_pixels():
    axes = only_axes(show.velocity_arrows(moving_right(), spacing=4))
    (arrows,) = axes.collections
    assert set(zip(arrows.X.tolist(), arrows.Y.tolist(), strict=True)) == {
        (x, y) for x in (14, 18, 22) for y in (10, 14)
    }
    assert (arrows.U == 6).all() and (arrows.V == 0).all()
    # A scale of 1/2 draws twice the half-spread, centered on the pixel.
    assert (arrows.scale, arrows.pivot, arrows.angles) == (0.5, "middle", "xy")


def test_depth_masks_the_sky_and_scales_to_surfaces():
    axes = only_axes(show.depth_map(moving_right()))
    shown = axes.images[0].get_array()
    assert shown.mask[:4].all() and not shown.mask[4:].any()
    assert axes.images[0].get_clim() == (5.0, 10.0)
    assert "sky" in axes.get_title()


def test_a_frame_of_sky_alone_can_be_drawn(tmp_path):
    frame = moving_right()
    sky = dataclasses.replace(frame, depth=jnp.full_like(frame.depth, jnp.inf))
    show.frame_sheet(sky).savefig(tmp_path / "sky.png")
    assert (tmp_path / "sky.png").stat().st_size > 5000


def test_the_sheet_holds_all_buffers_and_can_be_written(tmp_path):
    figure = show.frame_sheet(moving_right())
    titles = " ".join(axes.get_title() for axes in figure.axes)
    assert all(word in titles for word in ("40 x 24", "depth", "by color", "p - v"))
    figure.savefig(tmp_path / "sheet.png")
    assert (tmp_path / "sheet.png").stat().st_size > 5000


def test_tile_velocities_are_those_of_the_public_operators():
    frame = random_frame((20, 28), speed=20)
    settings = jaxblur.Settings(samples=9, radius=6)
    speed = np.linalg.norm(frame.velocity, axis=-1, keepdims=True)
    clamped = np.asarray(frame.velocity) * np.minimum(1, 6 / np.maximum(speed, 1e-9))
    tiles = jaxblur.tile_max(clamped, 6)
    # Clamped vectors tie except for rounding, so their speeds are compared.
    stages: Any = {"tile": tiles, "neighbor": jaxblur.neighbor_max(tiles)}
    for stage, expected in stages.items():
        found = show.tile_velocities(frame, settings, stage)
        np.testing.assert_allclose(
            np.linalg.norm(found, axis=-1), np.linalg.norm(expected, axis=-1), rtol=1e-5
        )


def test_the_overlay_draws_grid_tint_and_arrows_of_the_tiles():
    frame = moving_right()
    axes = only_axes(show.tile_overlay(frame, SETTINGS, stage="tile"))
    tiles = show.tile_velocities(frame, SETTINGS, "tile")
    (arrows,) = axes.collections
    assert len(arrows.X) == int((np.linalg.norm(tiles, axis=-1) > 0).sum()) == 2
    assert sorted(zip(arrows.X, arrows.Y, strict=True)) == [(11.5, 11.5), (19.5, 11.5)]
    assert len(axes.lines) == 4 + 6
    reddish = np.asarray(axes.images[0].get_array())[10, 10]
    assert reddish[0] > reddish[1] == pytest.approx(reddish[2], abs=1e-6)


@pytest.mark.parametrize("name", sorted(FILTERS))
def test_texel_weights_make_the_pixel(name):
    frame = random_frame((14, 18), speed=8)
    info = filter_info(name)
    parameters, usual = info.make_parameters(), info.settings
    settings = dataclasses.replace(usual, samples=9, radius=7)
    noise = random_noise((14, 18))
    blurred = FILTERS[name](frame, parameters, settings=settings, noise=noise)
    weights = show.texel_weights(name, frame, 6, 9, settings=settings, noise=noise)
    assert weights.min() >= -1e-6 and weights.sum() == pytest.approx(1, abs=1e-5)
    mixed = (weights[..., None] * np.asarray(frame.color)).sum(axis=(0, 1))
    np.testing.assert_allclose(mixed, blurred[6, 9], rtol=1e-4)


@pytest.mark.parametrize(
    ("tile_choice", "split"), [("stochastic", "variance"), ("expected", "even")]
)
def test_taps_lie_on_all_texels_with_weight(tile_choice, split):
    frame, noise = random_frame((20, 26), speed=8), random_noise((20, 26))
    settings = jaxblur.GuertinSettings(samples=9, radius=8, tile_choice=tile_choice, split=split)
    row, column = 8, 9
    taps = taps_at(frame, jaxblur.GuertinParameters(), row, column, settings=settings, noise=noise)
    options = {"settings": settings, "noise": noise}
    weights = show.texel_weights("guertin2014", frame, row, column, **options)
    x, y = np.floor(np.asarray(taps.offset).reshape(-1, 2).T + 0.5).astype(int)
    reached = {(row, column), *zip((row + y).tolist(), (column + x).tolist(), strict=True)}
    weighing = {(int(r), int(c)) for r, c in np.argwhere(weights > 0)}
    assert len(weighing) > 3 and weighing <= reached
    assert float(taps.chance.sum()) == pytest.approx(1)


def test_a_pixel_beside_a_moving_block_looks_along_it_and_across():
    settings = dataclasses.replace(SETTINGS, noise="none")
    taps = taps_at(moving_right(), jaxblur.GuertinParameters(), 12, 10, settings=settings)
    np.testing.assert_allclose(taps.along, [(1, 0)], atol=1e-6)
    np.testing.assert_allclose(np.abs(np.asarray(taps.center)), [(0, 1)], atol=1e-6)
    assert np.asarray(taps.second).tolist() == [index % 2 == 1 for index in range(9)]
    steps = np.abs(np.asarray(taps.offset)).max(axis=-1)
    np.testing.assert_allclose(steps, 6 * np.abs(np.arange(-8, 9, 2))[None] / 10, atol=1e-5)


def test_the_diagram_draws_a_dot_for_every_texel_with_weight():
    frame = moving_right()
    weights = show.texel_weights("guertin2014", frame, 12, 10, settings=SETTINGS)
    axes = only_axes(show.tap_diagram(frame, 12, 10, settings=SETTINGS))
    dots = next(
        group
        for group in axes.collections
        if hasattr(group, "get_sizes") and len(group.get_offsets()) == np.count_nonzero(weights)
    )
    for (x, y), area in zip(dots.get_offsets(), dots.get_sizes(), strict=True):
        assert area == pytest.approx(250 * weights[int(y), int(x)] / weights.max(), rel=1e-4)
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert labels == ["dominant direction", "center direction", "own velocity"]


@pytest.mark.parametrize("place", [(24, 0), (-1, 0), (0, 40)])
@pytest.mark.parametrize("draw", [show.tap_diagram, taps_at], ids=["diagram", "taps"])
def test_a_pixel_outside_is_refused(draw, place):
    between = (jaxblur.GuertinParameters(),) if draw is taps_at else ()
    with pytest.raises(ValueError, match=r"24 rows and 40 columns, got -?\d+, \d+"):
        draw(moving_right(), *between, *place)


def test_the_error_map_is_the_flip_of_the_metrics():
    sharp = moving_right().color
    truth = jnp.roll(sharp, 3, axis=1)
    figure = show.error_map(sharp, truth)
    shown, expected = metrics.display(sharp), metrics.display(truth)
    image = only_axes(figure).images[0]
    np.testing.assert_allclose(image.get_array(), metrics.flip_map(shown, expected))
    assert image.get_clim() == (0, 1) and len(figure.axes) == 2
    assert only_axes(figure).get_title() == f"FLIP, mean {metrics.flip(shown, expected):.4f}"


def test_the_display_error_scales_to_its_largest():
    black, gray = np.zeros((6, 8, 3)), np.full((6, 8, 3), 0.214041)
    image = only_axes(show.error_map(gray, black, kind="display")).images[0]
    np.testing.assert_allclose(image.get_array(), 0.5, atol=1e-4)
    assert image.get_clim() == pytest.approx((0, 0.5), abs=1e-4)


def test_before_and_after_show_the_pictures_that_they_name():
    sharp = moving_right().color
    truth = jnp.roll(sharp, 2, axis=1)
    figure = show.before_after(sharp, truth, truth, name="moved")
    titles = [axes.get_title() for axes in figure.axes[:4]]
    decibel = float(metrics.psnr(metrics.display(sharp), metrics.display(truth)))
    assert titles == [f"sharp, {decibel:.2f} dB", "moved, inf dB", "truth", "FLIP, mean 0.0000"]
    pictures = [np.asarray(axes.images[0].get_array()) for axes in figure.axes[:3]]
    np.testing.assert_array_equal(pictures[1], pictures[2])
    np.testing.assert_allclose(pictures[0], metrics.display(sharp))


def test_a_grid_lays_pictures_out_in_order():
    images = {name: np.full((4, 6, 3), value) for name, value in (("a", 0.0), ("b", 1.0))}
    figure = show.image_grid(images | {"c": np.full((4, 6, 1), 0.214041)}, columns=2)
    named: list[Any] = [axes for axes in figure.axes if axes.images]
    assert [axes.get_title() for axes in named] == ["a", "b", "c"]
    values = [float(axes.images[0].get_array()[0, 0, 0]) for axes in named]
    assert values == pytest.approx([0, 1, 0.5], abs=1e-4)


def test_curves_and_bars_draw_their_values():
    axes: Any = show.curves(
        {"a": ([1, 2], [3, 4]), "": ([1, 2], [5, 6])}, x="n", y="e", log="x", marks={"fit": 1.5}
    ).axes[0]
    assert axes.lines[0].get_ydata().tolist() == [3, 4]
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["a", "fit"]
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "linear")
    axes = show.bars({"g": {"one": 1.0, "two": -2.0}, "h": {"one": 3.0, "two": 4.0}}, x="dB").axes[
        0
    ]
    assert [bar.get_width() for bar in axes.patches] == [1, -2, 3, 4]
    assert axes.get_ylim()[0] > axes.get_ylim()[1], "the first name is on top"


@pytest.mark.parametrize(
    ("draw", "message"),
    [
        (lambda: show.velocity_colors(np.zeros((2, 3)), 1.0), "`velocity` must have shape"),
        (lambda: show.velocity_colors(np.zeros((2, 2)), 0.0), "`limit` must be above 0"),
        (lambda: show.velocity_arrows(moving_right(), spacing=0), "`spacing` must be at least 1"),
        (lambda: show.tile_velocities(moving_right(), SETTINGS, UNKNOWN), "`stage` must be"),
        (lambda: show.texel_weights("blur", moving_right(), 0, 0), "`filter` must be one of"),
        (lambda: show.error_map(np.zeros((2, 2, 3)), np.zeros((2, 2, 3)), kind=UNKNOWN), "`kind`"),
        (lambda: show.image_grid({}), "at least one image"),
        (lambda: show.curves({}, x="", y=""), "at least one line"),
        (lambda: show.curves({"a": ([1], [1])}, x="", y="", log="z"), "`log` may hold only"),
        (lambda: show.bars({"a": {"x": 1.0}, "b": {"y": 1.0}}, x=""), "the same names"),
    ],
)
def test_what_cannot_be_drawn_is_refused(draw, message):
    with pytest.raises(ValueError, match=message):
        draw()


def test_sliders_without_a_kernel_draw_once_at_their_start():
    assert show.sliders(lambda a, b: (a, b), a=(0.0, 2.0, 1.0), b=(1.0, 500.0, 40.0)) == (1, 40)
    with pytest.raises(ValueError, match="`a` must start between 0 and 2, got 3"):
        show.sliders(lambda a: a, a=(0.0, 2.0, 3.0))


def test_axes_are_drawn_into():
    figure = show.new_figure(6, 3)
    axes = figure.subplots(1, 2)
    assert show.velocity_wheel(moving_right(), axes=axes[0]) is figure
    assert show.tile_overlay(moving_right(), SETTINGS, axes=axes[1]) is figure
    assert all(part.images for part in axes)


def test_without_matplotlib_the_message_says_what_to_install():
    code = (
        "import sys; sys.modules['matplotlib.figure'] = None; import jaxblur.show as show\n"
        "try: show.new_figure(1, 1)\n"
        "except ImportError as error: print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "pip install 'jaxblur[plot]'" in done.stdout
