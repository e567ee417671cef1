"""Data windows on the command line: cropped renders, overscan, and files of other windows."""

import jax.numpy as jnp
import numpy as np
import OpenImageIO as oiio
import pytest

import jaxblur
from jaxblur import exr
from tests.command_line import refused, run
from tests.exr_files import make_spec, plain_frame, write_parts, write_single
from tests.hero_files import HERO, crypto_notes, frame, ids
from tests.test_cli_neighbors import FEW, SETTINGS, SIZE, channels_at, note
from tests.test_exr_windows import part_of, write_part

FAST = ("--preset", "jaxblur", "--filter", "pixel_velocity", "--noise", "none")
DISPLAY = (0, 0, SIZE[1], SIZE[0])
WINDOWS = {1: (2, 1, 28, 18), 2: (8, 2, 28, 17), 3: (12, 0, 24, 20)}


def element_at(time):
    """The square of a frame alone, with alpha."""
    channels = channels_at(time)
    alpha = np.float32(channels["Z"] < 5)
    element = {name: channels[name] * alpha for name in "RGB"} | {"A": alpha}
    element["Z"] = np.where(alpha, 1, np.inf).astype(np.float32)
    return element | {name: channels[name] for name in ("velocity.X", "velocity.Y")}


def write_shot(folder, make, windows):
    for number, window in windows.items():
        write_part(folder / f"in.{number:04d}.exr", make(number), window)


def frames_in(folder, make, windows, known):
    """The frames of a shot in the window of frame 2, with masks where nothing is known."""
    frames = {}
    for number, (x, y, width, height) in windows.items():
        held = np.zeros(SIZE, bool)
        held[y : y + height, x : x + width] = True
        whole = jaxblur.read_frame(write_single(folder / "whole.exr", make(number)), shutter=0.5)
        left, top, columns, rows = windows[2]
        part = (slice(top, top + rows), slice(left, left + columns))
        mask = None if known or held[part].all() else jnp.asarray(held[part])
        frames[number] = jaxblur.Frame(
            whole.color[part], whole.depth[part], whole.velocity[part], valid=mask
        )
    return frames


def blur_in_python(frames, origin, seed=0):
    height, width = frames[2].depth.shape
    noise = jaxblur.noise.make_noise("ign", height, width, seed, origin=origin)
    blurred = jaxblur.layered(
        frames[2],
        jaxblur.LayeredParameters(),
        settings=SETTINGS,
        noise=noise,
        before=frames.get(1),
        after=frames.get(3),
    )
    return np.asarray(blurred)


ELEMENT_WINDOWS = {1: (9, 4, 11, 12), 2: (13, 3, 15, 13), 3: (20, 4, 12, 12)}
"""As cropped to what is seen in each frame, and two pixels more."""

SHOTS = {
    "picture": (channels_at, WINDOWS, False),
    "element": (element_at, ELEMENT_WINDOWS, True),
    "same size": (channels_at, {1: (0, 0, 30, 18), 2: (4, 1, 30, 18), 3: (4, 2, 30, 18)}, False),
}


@pytest.mark.slow
@pytest.mark.parametrize("shot", SHOTS)
def test_a_sequence_puts_neighbors_in_place(tmp_path, shot):
    make, windows, known = SHOTS[shot]
    write_shot(tmp_path, make, windows)
    expected = frames_in(tmp_path, make, windows, known)
    command = ("blur", tmp_path / "in.####.exr", "-o", tmp_path / "out.####.exr", *FEW)
    outcome = run(*command, "--frames", "2")
    assert outcome.status == 0 and "do not see" not in outcome.err, outcome
    out = tmp_path / "out.0002.exr"
    assert note(out) == "before in.0001.exr, after in.0003.exr"
    assert exr.windows_of(exr.inspect(out), "R") == (windows[2], DISPLAY)
    blurred = exr.read_image(out)
    np.testing.assert_allclose(blurred, blur_in_python(expected, windows[2][:2], seed=2), atol=1e-5)
    assert np.abs(blurred - blur_in_python({2: expected[2]}, windows[2][:2], seed=2)).max() > 0.02


@pytest.mark.slow
def test_named_neighbors_are_put_in_place(tmp_path):
    write_shot(tmp_path, channels_at, WINDOWS)
    expected = frames_in(tmp_path, channels_at, WINDOWS, False)
    near = ("--before", tmp_path / "in.0001.exr", "--after", tmp_path / "in.0003.exr")
    command = ("blur", tmp_path / "in.0002.exr", "-o", tmp_path / "out.exr", *FEW, *near)
    outcome = run(*command)
    assert outcome.status == 0 and "WARNING" not in outcome.err, outcome
    blurred = exr.read_image(tmp_path / "out.exr")
    np.testing.assert_allclose(blurred, blur_in_python(expected, WINDOWS[2][:2]), atol=1e-5)


def test_a_neighbor_of_another_picture_is_refused(tmp_path):
    path = write_part(tmp_path / "a.exr", channels_at(2), WINDOWS[2])
    other = write_part(tmp_path / "b.exr", channels_at(1), WINDOWS[1], display=(0, 0, 40, 20))
    error = refused("blur", path, "-o", tmp_path / "out.exr", "--before", other)
    assert "has a display window of 40x20 at (0, 0), but the frame has one of 36x20" in error


@pytest.mark.slow
def test_subframes_are_put_in_place(tmp_path):
    windows = {1: (9, 3, 17, 14), 2: (15, 3, 15, 14)}
    path = write_part(tmp_path / "in.exr", element_at(2), (10, 2, 22, 16))
    for number, window in windows.items():
        time = 2 + 0.25 * (number - 1.5)
        write_part(tmp_path / f"sub.{number:02d}.exr", element_at(time), window)
        write_part(tmp_path / f"whole.{number:02d}.exr", element_at(time), (10, 2, 22, 16))
    out, names = tmp_path / "out.exr", ("sub.##.exr", "whole.##.exr")
    images = []
    for name in names:
        command = ("blur", path, "-o", out, "--overwrite", *FEW, "--subframes", tmp_path / name)
        assert run(*command).status == 0
        images.append(exr.read_image(out))
    np.testing.assert_array_equal(*images)


def test_subframes_must_be_known_everywhere(tmp_path):
    path = write_part(tmp_path / "in.exr", channels_at(2), (0, 0, 36, 20))
    for number, window in ((1, (0, 0, 36, 20)), (2, (1, 0, 35, 20))):
        write_part(tmp_path / f"sub.{number:02d}.exr", channels_at(2), window)
    command = ("blur", path, "-o", tmp_path / "out.exr", "--subframes", tmp_path / "sub.##.exr")
    error = refused(*command)
    assert "sub.02.exr has the pixels 35x20 at (1, 0), but the frame has 36x20 at (0, 0)" in error


def test_a_truth_is_put_in_place(tmp_path):
    path = write_part(tmp_path / "in.exr", channels_at(2), (4, 2, 20, 14))
    command = ("blur", path, "-o", tmp_path / "out.exr", "--overwrite", *FAST, "--truth")
    outcomes = [
        run(*command, write_part(tmp_path / "truth.exr", channels_at(2.1), window))
        for window in ((4, 2, 20, 14), (2, 0, 30, 18), (0, 0, 36, 20))
    ]
    assert all(outcome.status == 0 for outcome in outcomes)
    assert "PSNR" in outcomes[0].out and len({outcome.out for outcome in outcomes}) == 1
    # One of the same size at another place is refused.
    other = write_part(tmp_path / "other.exr", channels_at(2.1), (5, 2, 20, 14))
    error = refused(*command, other)
    assert "the truth has the pixels 20x14 at (5, 2) of the display window 36x20" in error


@pytest.mark.slow
def test_fit_puts_a_truth_in_place(tmp_path):
    path = write_part(tmp_path / "in.exr", channels_at(2), (4, 2, 20, 14))
    command = ("fit", path, "-o", tmp_path / "fit.toml", "--overwrite", "--steps", "2")
    command = (*command, "--filter", "guertin2014", "--radius", "16", "--truth")
    found = []
    for window in ((4, 2, 20, 14), (0, 0, 36, 20)):
        truth = write_part(tmp_path / "truth.exr", channels_at(2.1), window)
        outcome = run(*command, truth)
        assert outcome.status == 0, outcome
        found.append((tmp_path / "fit.toml").read_text())
    assert found[0] == found[1]
    other = write_part(tmp_path / "truth.exr", channels_at(2.1), (5, 2, 20, 14))
    assert "the truth has the pixels 20x14 at (5, 2)" in refused(*command, other)


def test_mattes_are_put_in_place(tmp_path):
    window = (10, 4, 20, 14)
    path = write_part(tmp_path / "in.exr", frame(), window)
    out, names = tmp_path / "out.exr", ("/hero", "/set/ground")
    mattes = write_single(tmp_path / "mattes.exr", ids(names), **crypto_notes())
    command = ("blur", path, "-o", out, "--overwrite", *FAST)
    assert run(*command).status == 0
    plain = exr.read_image(out)
    given = ("--scale-motion", "crypto:/hero=0", "--matte-from", mattes)
    assert run(*command, *given).status == 0
    hero = part_of({"": HERO}, window)[""]
    image = exr.read_image(out)
    np.testing.assert_array_equal(image[hero], exr.read_image(path)[hero])
    np.testing.assert_array_equal(image[~hero], plain[~hero])


def test_outside_of_mattes_motion_stays(tmp_path):
    path, out = write_single(tmp_path / "in.exr", frame()), tmp_path / "out.exr"
    gain = {"gain.Y": np.zeros(HERO.shape, np.float32)}
    maps = write_part(tmp_path / "maps.exr", gain, (10, 4, 20, 14))
    command = ("blur", path, "-o", out, "--overwrite", *FAST)
    assert run(*command).status == 0
    plain = exr.read_image(out)
    assert run(*command, "--scale-motion", "map:gain.Y", "--matte-from", maps).status == 0
    held = np.zeros(HERO.shape, bool)
    held[4:18, 10:30] = True
    image = exr.read_image(out)
    np.testing.assert_array_equal(image[held], exr.read_image(path)[held])
    np.testing.assert_array_equal(image[~held], plain[~held])


@pytest.mark.parametrize("limit", ["10%", "valve"])
def test_shares_of_the_width_are_of_the_display_window(tmp_path, limit):
    window, images = (6, 4, 12, 14), []
    for name, part in (("whole", (0, 0, 36, 24)), ("part", window)):
        path = write_part(tmp_path / f"{name}.exr", frame((16.0, 0.0)), part)
        command = ("blur", path, "-o", tmp_path / "out.exr", "--overwrite", *FAST)
        assert run(*command, "--limit-motion", limit).status == 0
        images.append(exr.read_image(tmp_path / "out.exr"))
    # The blur reaches over the edges of the data window by less than three pixels.
    np.testing.assert_allclose(images[1][:, 3:-3], images[0][4:18, 9:15], atol=1e-6)


def test_the_sensor_shows_the_display_window(tmp_path):
    channels = plain_frame((24, 36))
    lens = ("--focus", "2", "--f-number", "1.4", "--focal-length", "70")
    images = []
    for part in ((0, 0, 36, 24), (6, 4, 24, 18)):
        path = write_part(tmp_path / "in.exr", channels, part)
        command = ("post", path, "-o", tmp_path / "out.exr", "--overwrite", "--do", "defocus")
        outcome = run(*command, *lens)
        assert outcome.status == 0, outcome
        images.append((exr.read_image(tmp_path / "out.exr"), outcome.err))
    radii = [text.partition("up to a radius of ")[2].partition(" px")[0] for _, text in images]
    assert radii[0] and radii[0] == radii[1]


def test_post_puts_the_depth_in_place(tmp_path):
    channels = plain_frame((24, 36))
    picture = {name: channels[name] for name in "RGB"}
    path = write_part(tmp_path / "in.exr", picture, (6, 4, 24, 18))
    command = ("post", path, "-o", tmp_path / "out.exr", "--overwrite", "--do", "mlaa-depth")
    images = []
    for window in ((6, 4, 24, 18), (0, 0, 36, 24)):
        depth = write_part(tmp_path / "depth.exr", {"Z": channels["Z"]}, window)
        assert run(*command, "--depth-from", depth).status == 0
        images.append(exr.read_image(tmp_path / "out.exr"))
    np.testing.assert_array_equal(*images)
    depth = write_part(tmp_path / "depth.exr", {"Z": channels["Z"]}, (5, 4, 24, 18))
    error = refused(*command, "--depth-from", depth)
    assert "the depth has the pixels 24x18 at (5, 4)" in error


@pytest.mark.slow
@pytest.mark.parametrize(
    ("given", "words"),
    [
        ((("--before", 3),), "--before: by its number"),
        ((("--after", 1), ("--before", 3)), "--after: by its number"),
        ((("--before", 1), ("--after", 4)), "--after: what"),
    ],
)
def test_neighbors_that_are_hardly_such_are_told(tmp_path, given, words):
    write_shot(tmp_path, channels_at, dict.fromkeys((1, 2, 3), DISPLAY))
    write_part(tmp_path / "in.0004.exr", channels_at(3, shift=11), DISPLAY)
    near = [text for o, n in given for text in (o, tmp_path / f"in.000{n}.exr")]
    command = ("blur", tmp_path / "in.0002.exr", "-o", tmp_path / "out.exr", *FEW, *near)
    outcome = run(*command)
    assert outcome.status == 0 and words in outcome.err, outcome


@pytest.mark.slow
def test_layers_put_neighbors_in_place(tmp_path):
    """The layer behind is opaque: of what its neighbor does not hold nothing is known."""
    windows = {2: (0, 0, 36, 20), 3: (2, 1, 33, 18)}
    for number, window in windows.items():
        write_part(tmp_path / f"hero.{number}.exr", element_at(number), window)
        write_part(tmp_path / f"set.{number}.exr", channels_at(number), window)
    write_part(tmp_path / "hero.4.exr", element_at(3), windows[2])
    write_part(tmp_path / "set.4.exr", channels_at(3), windows[2])
    images = []
    for after in (3, 4):
        out = tmp_path / "out.exr"
        command = ("layers", tmp_path / "hero.2.exr", tmp_path / "set.2.exr", "-o", out, *FEW)
        near = [f"{tmp_path / name}.{after}.exr" for name in ("hero", "set")]
        outcome = run(*command, "--overwrite", "--after", *near)
        assert outcome.status == 0, outcome
        images.append(exr.read_image(out))
    inside = (slice(4, 16), slice(4, 32))
    np.testing.assert_allclose(images[0][inside], images[1][inside], atol=0.02)
    assert images[0].min() > 0.01


@pytest.mark.slow
def test_layers_of_several_data_windows_are_blurred_in_one_that_holds_them(tmp_path):
    """Where all layers know what the full ones show, the result is that of the full ones."""
    hero, back = element_at(2), channels_at(1)
    full = [
        write_part(tmp_path / f"full_{name}.exr", each, DISPLAY)
        for name, each in (("hero", hero), ("set", back))
    ]
    rows, columns = np.nonzero(hero["A"])
    left, top = int(columns.min()), int(rows.min())
    tight = (left, top, int(columns.max()) + 1 - left, int(rows.max()) + 1 - top)
    small = write_part(tmp_path / "hero.exr", hero, tight)
    region = write_part(tmp_path / "set.exr", back, (4, 2, 30, 16))
    images = []
    for layers in (full, (small, full[1]), (small, region)):
        out = tmp_path / "out.exr"
        outcome = run("layers", *layers, "-o", out, "--overwrite", *FEW)
        assert outcome.status == 0 and "cut off" not in outcome.err, outcome
        images.append(exr.read_image(out))
    assert exr.inspect(out).parts[0].data_window == (4, 2, 30, 16)
    np.testing.assert_array_equal(images[1], images[0])
    # At its edges less is known of what hides behind the hero.
    np.testing.assert_allclose(images[2][4:-4, 4:-4], images[0][6:14, 8:30], atol=0.002)


PICTURES = ("out.tif", "out.png", "out.jpg")


@pytest.mark.parametrize("window", [(6, 4, 20, 14), (-4, -2, 44, 28), (30, -3, 9, 12)])
@pytest.mark.parametrize("name", PICTURES)
def test_pictures_show_the_display_window(tmp_path, name, window):
    whole = {key: np.float32(0.5) + 0 * plane for key, plane in frame((0.0, 0.0)).items()}
    channels = {key: np.pad(plane, 4, "edge") for key, plane in whole.items()}
    x, y, *size = window
    part = part_of(channels, (x + 4, y + 4, *size))
    path = write_single(tmp_path / "in.exr", part, origin=(x, y), display=(0, 0, 36, 24))
    held = exr.put_into(np.ones(size[::-1], bool), window, (0, 0, 36, 24))
    out = tmp_path / name
    for command in (("blur", path, *FAST), ("post", path, "--do", "fxaa")):
        assert run(*command, "-o", out, "--overwrite").status == 0
        image = exr.read_image(out)
        assert image.shape == (24, 36, 3)
        assert image[held].min() > 0.3 and image[~held].max(initial=0) < 0.2, "JPEG rings"
    colors = np.float32(0.5) * np.ones((*size[::-1], 3), np.float32)
    exr.write_image(out, colors, like=path, overwrite=True)
    assert exr.read_image(out).shape == (24, 36, 3)


def test_a_preview_shows_the_display_window_and_the_exr_keeps_its_own(tmp_path):
    path = write_part(tmp_path / "in.exr", frame(), (6, 4, 20, 14))
    out = tmp_path / "out.exr"
    assert run("blur", path, "-o", out, "--png", *FAST).status == 0
    assert exr.windows_of(exr.inspect(out), "R") == ((6, 4, 20, 14), (0, 0, 36, 24))
    assert exr.read_image(out.with_suffix(".png")).shape == (24, 36, 3)


def test_floats_of_a_picture_are_transparent_where_nothing_is_held(tmp_path):
    channels = frame((0.0, 0.0)) | {"A": np.ones((24, 36), np.float32)}
    path = write_part(tmp_path / "in.exr", channels, (6, 4, 20, 14))
    assert run("blur", path, "-o", tmp_path / "out.tif", *FAST).status == 0
    alpha = exr.read_image(tmp_path / "out.tif")[..., 3]
    assert (alpha[4:18, 6:26] == 1).all() and alpha.sum() == 14 * 20


TIGHT = (16, 5, 9, 11)
"""The square of frame 2 with a row and a column to spare."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "options", [("--shutter", "1"), ("--shutter-open", "0", "--shutter-close", "0.7")]
)
def test_the_blur_of_a_cropped_element_is_not_cut_off(tmp_path, options):
    channels = element_at(2) | {"id": np.full(SIZE, 7, np.float32)}
    cropped = write_part(tmp_path / "a.exr", channels, TIGHT)
    whole = write_part(tmp_path / "b.exr", channels, DISPLAY)
    out, images = tmp_path / "out.exr", []
    for path in (cropped, whole):
        command = ("blur", path, "-o", out, "--overwrite", *FEW, *options)
        outcome = run(*command)
        assert outcome.status == 0 and "cut off" not in outcome.err, outcome
        windows = exr.windows_of(exr.inspect(out), "R")
        images.append(exr.put_into(exr.read_image(out), windows.data, DISPLAY))
        if path == cropped:
            x, y, width, height = windows.data
            assert (y, height) == (5, 11) and x < 16 and x + width > 25
            identifiers = exr.put_into(np.full((11, 9), 7), TIGHT, windows.data)
            np.testing.assert_array_equal(exr.read_values(out, "id"), identifiers)
            depth = exr.read_values(out, "Z")
            assert np.isposinf(depth[:, 0]).all() and (depth == 1).any()
    np.testing.assert_allclose(*images, atol=1e-5)
    assert np.abs(images[0][:, 25:]).max() > 0.05


@pytest.mark.slow
def test_cryptomattes_and_further_parts_of_a_cropped_element(tmp_path):
    channels = element_at(2)
    moves = np.float32(channels["A"])
    name = np.array(exr.identifier_of("/hero"), np.uint32).view(np.float32)
    planes = {"R": name * moves, "G": moves, "B": 0 * moves, "A": 0 * moves}
    channels |= {f"CryptoObject00.{end}": np.float32(plane) for end, plane in planes.items()}
    found = []
    for window in (TIGHT, DISPLAY):
        main, data = part_of(channels, window), part_of({"normal.X": channels["R"]}, window)
        place = {"origin": window[:2], "display": DISPLAY}
        header = make_spec(main, name="main", **place, **crypto_notes(("/hero",)))
        parts = [(header, main), (make_spec(data, name="data", **place), data)]
        path, out = write_parts(tmp_path / "a.exr", parts), tmp_path / "out.exr"
        outcome = run("blur", path, "-o", out, "--overwrite", *FEW, "--cryptomatte")
        assert outcome.status == 0, outcome
        windows = exr.windows_of(exr.inspect(out), "main.R")
        matte = exr.read_cryptomatte(out, "/hero")
        found.append(exr.put_into(matte, windows.data, DISPLAY))
        assert exr.windows_of(exr.inspect(out), "data.normal.X").data == window
        np.testing.assert_array_equal(exr.read_values(out, "data.normal.X"), data["normal.X"])
    np.testing.assert_allclose(*found, atol=1e-5)
    assert ((found[0] > 0) & (found[0] < 1)).any()


def test_the_truth_of_an_element_is_transparent_outside(tmp_path):
    path = write_part(tmp_path / "in.exr", element_at(2), (14, 4, 13, 13))
    command = ("blur", path, "-o", tmp_path / "out.exr", "--overwrite", *FAST, "--truth")
    outcomes = [
        run(*command, write_part(tmp_path / "truth.exr", element_at(2.1), window))
        for window in ((16, 4, 12, 12), DISPLAY)
    ]
    assert all(outcome.status == 0 for outcome in outcomes), outcomes
    assert "PSNR" in outcomes[0].out and outcomes[0].out == outcomes[1].out
    opaque = write_part(tmp_path / "opaque.exr", channels_at(2.1), TIGHT)
    assert "the truth has the pixels 9x11 at (16, 5)" in refused(*command, opaque)


def test_views_of_one_file_keep_their_window(tmp_path):
    element = element_at(2)
    views = element | {f"right.{name}": plane for name, plane in element.items()}
    part = part_of(views, TIGHT)
    spec = make_spec(part, origin=TIGHT[:2], display=DISPLAY)
    spec.attribute("multiView", oiio.TypeDesc("string[2]"), ("left", "right"))
    path, out = write_parts(tmp_path / "a.exr", [(spec, part)]), tmp_path / "out.exr"
    outcome = run("blur", path, "-o", out, *FAST, "--shutter", "1")
    assert outcome.status == 0, outcome
    assert "its blur is cut off there" in outcome.err
    assert exr.windows_of(exr.inspect(out), "R").data == TIGHT


def test_views_in_parts_keep_their_own_windows(tmp_path):
    windows = {"left": (2, 3, 20, 14), "right": (5, 1, 20, 14)}
    parts = []
    for view, window in windows.items():
        part = part_of(channels_at(2), window)
        parts.append(
            (make_spec(part, name=view, view=view, origin=window[:2], display=DISPLAY), part)
        )
    path, out = write_parts(tmp_path / "a.exr", parts), tmp_path / "out.exr"
    outcome = run("blur", path, "-o", out, "--views", "all", *FAST)
    assert outcome.status == 0, outcome
    before, after = exr.inspect(path), exr.inspect(out)
    assert [part.data_window for part in after.parts] == [*windows.values()]
    for name in ("left.Z", "right.Z"):
        assert name in before.channel_names
        np.testing.assert_array_equal(exr.read_values(out, name), exr.read_values(path, name))


@pytest.mark.slow
def test_the_blur_of_a_cropped_layer_is_not_cut_off(tmp_path):
    images = []
    for window in (TIGHT, DISPLAY):
        hero = write_part(tmp_path / "hero.exr", element_at(2), window)
        shade = write_part(tmp_path / "shade.exr", element_at(2), TIGHT)
        command = ("layers", hero, shade, "-o", tmp_path / "out.exr", *FEW, "--shutter", "1")
        outcome = run(*command, "--overwrite")
        assert outcome.status == 0 and "cut off" not in outcome.err, outcome
        windows = exr.windows_of(exr.inspect(tmp_path / "out.exr"), "R")
        assert windows.display == DISPLAY
        images.append(exr.put_into(exr.read_image(tmp_path / "out.exr"), windows.data, DISPLAY))
    np.testing.assert_allclose(*images, atol=1e-5)
    assert images[0][:, 25:].max() > 0.05


@pytest.mark.slow
@pytest.mark.parametrize("options", [("--then", "defocus"), ()])
def test_a_cropped_element_out_of_focus_is_not_cut_off(tmp_path, options):
    lens = ("--focus", "2", "--f-number", "0.8", "--focal-length", "70", "--unit", "0.5")
    channels = element_at(2) | {"velocity.X": np.zeros(SIZE, np.float32)}
    sums = []
    for window in (TIGHT, DISPLAY):
        path = write_part(tmp_path / "a.exr", channels, window)
        command = ("blur", path, "-o", tmp_path / "out.exr", "--overwrite", *FEW, *lens, *options)
        outcome = run(*command)
        assert outcome.status == 0, outcome
        sums.append(exr.read_image(tmp_path / "out.exr").sum())
    radius = float(outcome.err.partition("up to a radius of ")[2].partition(" px")[0])
    path = write_part(tmp_path / "a.exr", channels, TIGHT)
    assert run(*command).status == 0
    x, y, width, height = exr.windows_of(exr.inspect(tmp_path / "out.exr"), "R").data
    assert radius > 2 and x <= 17 - radius and x + width >= 24 + radius
    assert y <= 6 - radius and y + height >= 15 + radius
    np.testing.assert_allclose(*sums, rtol=0.02)


def test_a_cropped_element_at_rest_keeps_its_window(tmp_path):
    path = write_part(tmp_path / "a.exr", element_at(2), TIGHT)
    out = tmp_path / "out.exr"
    assert run("blur", path, "-o", out, *FAST, "--scale-motion", "0").status == 0
    assert exr.windows_of(exr.inspect(out), "R") == (TIGHT, DISPLAY)
