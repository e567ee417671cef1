"""``jaxblur blur`` on real and on damaged files."""

import functools
import re
import tomllib

import numpy as np
import pytest

import jaxblur
from jaxblur import exr, srgb
from jaxblur.cli import blurring
from jaxblur.settings import choices_of
from tests.command_line import refused, run
from tests.exr_files import CAR, CUBE, DATA, plain_frame, read_raw, write_single
from tests.helpers import slow

TRUTH = DATA / "sky_car_truth_0011.exr"
GUERTIN = ("--filter", "guertin2014")
FEW = (*GUERTIN, "--samples", "7", "--radius", "25")


@functools.cache
def expected(samples=7, radius=25):
    """The car, blurred through the Python interface."""
    settings = jaxblur.Settings(samples=samples, radius=radius)
    frame = jaxblur.read_frame(CAR)
    return np.asarray(jaxblur.guertin2014(frame, jaxblur.GuertinParameters(), settings=settings))


def attributes(path):
    """All metadata of the first part."""
    return exr.inspect(path).parts[0].attributes


def test_the_output_is_the_filtered_color_and_everything_else_is_untouched(tmp_path):
    out = tmp_path / "out.exr"
    outcome = run("blur", CAR, "-o", out, *FEW)
    assert outcome.status == 0 and outcome.out == f"{out}\n"
    # Color is stored as half, as in the input.
    stored = exr.read_image(out)
    np.testing.assert_array_equal(stored, expected().astype(np.float16).astype(np.float32))
    parts = exr.inspect(CAR).parts
    assert [part.name for part in exr.inspect(out).parts] == [part.name for part in parts]
    for index in range(1, len(parts)):
        np.testing.assert_array_equal(read_raw(out, index)[1], read_raw(CAR, index)[1])


def test_a_spacing_is_passed_on(tmp_path):
    out = tmp_path / "out.exr"
    assert run("blur", CAR, "-o", out, *FEW, "--spacing", "4").status == 0
    settings = jaxblur.Settings(samples=7, radius=25, spacing=4.0)
    frame = jaxblur.read_frame(CAR)
    blurred = np.asarray(jaxblur.guertin2014(frame, jaxblur.GuertinParameters(), settings=settings))
    stored = exr.read_image(out)
    np.testing.assert_array_equal(stored, blurred.astype(np.float16).astype(np.float32))
    assert tomllib.loads(attributes(out)["jaxblur:settings"])["spacing"] == 4


def test_it_says_on_stderr_what_was_decided_and_why(tmp_path):
    err = run("blur", CAR, "-o", tmp_path / "out.exr", *FEW).err
    assert "jaxblur: vectors: blender: found ViewLayer.Vector.X" in err
    assert "jaxblur: depth: ViewLayer.Depth.Z, read as z" in err


def test_provenance_is_in_the_header(tmp_path):
    out = tmp_path / "out.exr"
    assert run("blur", CAR, "-o", out, *FEW, "--param", "kappa=30", "--shutter", ".25").status == 0
    found = attributes(out)
    assert found["jaxblur:version"] == jaxblur.__version__
    assert found["jaxblur:filter"] == "guertin2014"
    assert found["jaxblur:inputs"] == CAR.name
    parameters = tomllib.loads(found["jaxblur:parameters"])
    assert parameters == {
        **{"kappa": 30, "gamma": 1.5, "tau": 1, "eta": 0.95, "phi": 27},
        "depth_sharpness": 1,
    }
    settings = tomllib.loads(found["jaxblur:settings"])
    assert {key: settings[key] for key in ("samples", "radius", "shutter", "preset")} == {
        **{"samples": 7, "radius": 25, "shutter": 0.25},
        "preset": "blender",
    }
    assert found["Time"] == attributes(CAR)["Time"], "metadata of the input is kept"


@pytest.mark.slow
def test_scores_against_the_truth(tmp_path):
    outcome = run("blur", CUBE, "-o", tmp_path / "out.exr", "--truth", _truth_of(CUBE))
    heading, sharp, blurred = (re.split(r"\s{2,}", row) for row in outcome.out.splitlines()[1:])
    assert heading == ["against truth", "PSNR dB", "SSIM", "FLIP"]
    # The figure for the sharp crop is that of the data's README.
    assert sharp[:2] == ["input", "15.99"]
    assert blurred[0] == "layered", "the default"
    assert float(blurred[1]) > 27 and float(blurred[2]) > float(sharp[2])
    assert float(blurred[3]) < float(sharp[3])


def _truth_of(frame):
    return frame.with_name(frame.name.replace("frame", "truth"))


@pytest.mark.parametrize("name", ["mcguire2012", "pixel_velocity", slow("layered")])
def test_other_filters_use_their_published_settings(tmp_path, name):
    from jaxblur.filters import FILTERS, filter_info

    out = tmp_path / "out.exr"
    assert run("blur", CAR, "-o", out, "--filter", name).status == 0
    info = filter_info(name)
    parameters, settings = info.make_parameters(), info.settings
    image = FILTERS[name](jaxblur.read_frame(CAR), parameters, settings=settings)
    stored = exr.read_image(out)
    np.testing.assert_array_equal(stored, np.asarray(image).astype(np.float16).astype(np.float32))


def test_parameters_reach_the_filter(tmp_path):
    out = tmp_path / "out.exr"
    given = ("--param", "kappa=2", "--param", "gamma=3", "--tile-choice", "own", "--noise", "none")
    assert run("blur", CAR, "-o", out, *FEW, *given).status == 0
    settings = jaxblur.GuertinSettings(samples=7, radius=25, tile_choice="own", noise="none")
    parameters = jaxblur.GuertinParameters(kappa=2.0, gamma=3.0)
    image = jaxblur.guertin2014(jaxblur.read_frame(CAR), parameters, settings=settings)
    half = np.asarray(image).astype(np.float16).astype(np.float32)
    np.testing.assert_array_equal(exr.read_image(out), half)


@pytest.mark.parametrize("name", ["layered", "mcguire2012", "pixel_velocity"])
def test_choices_that_a_filter_does_not_have_are_refused(tmp_path, name):
    out, choices = tmp_path / "out.exr", choices_of(jaxblur.GuertinSettings)
    only = choices.keys() - choices_of(jaxblur.Settings).keys()
    assert len(only) == 6
    for choice in only:
        option = f"--{choice.replace('_', '-')}"
        message = refused("blur", CAR, "-o", out, "--filter", name, option, choices[choice][-1])
        assert f"{option}: {name} has no such choice" in message
    with pytest.raises(ValueError, match=rf"that {name} does not have \(tile_choice, split"):
        jaxblur.FILTERS[name](
            jaxblur.read_frame(CAR),
            jaxblur.filter_info(name).make_parameters(),
            settings=jaxblur.GuertinSettings(samples=5),
        )
    assert run("blur", CAR, "-o", out, "--filter", name).status == 0
    assert "tile_choice" not in tomllib.loads(attributes(out)["jaxblur:settings"])


@pytest.mark.slow
@pytest.mark.parametrize(("quality", "samples"), [("preview", 15), slow("final", 105)])
def test_a_quality_is_a_number_of_samples(tmp_path, quality, samples):
    channels = plain_frame((6, 8))
    source = write_single(tmp_path / "in.exr", channels)
    assert run("blur", source, "-o", tmp_path / "out.exr", "--quality", quality).status == 0
    settings = tomllib.loads(attributes(tmp_path / "out.exr")["jaxblur:settings"])
    assert settings["samples"] == samples and "seed" not in settings


def test_a_seed_moves_the_noise_of_a_single_frame(tmp_path):
    channels = plain_frame((24, 32))
    for axis in "XY":
        channels[f"velocity.{axis}"] *= 20
    source = write_single(tmp_path / "in.0007.exr", channels)
    outs = {seed: tmp_path / f"{seed}.exr" for seed in ("none", "0", "7", "frame")}
    for seed, out in outs.items():
        given = () if seed == "none" else ("--seed", seed)
        assert run("blur", source, "-o", out, *FEW, *given).status == 0
    images = {seed: exr.read_image(out) for seed, out in outs.items()}
    np.testing.assert_array_equal(images["0"], images["none"])
    np.testing.assert_array_equal(images["frame"], images["7"])
    assert np.abs(images["7"] - images["0"]).max() > 0.01
    assert tomllib.loads(attributes(outs["frame"])["jaxblur:settings"])["seed"] == 7


def test_a_closed_shutter_gives_the_input_back(tmp_path):
    out = tmp_path / "out.exr"
    assert run("blur", CAR, "-o", out, *FEW, "--shutter", "0").status == 0
    np.testing.assert_array_equal(exr.read_image(out), exr.read_image(CAR))


def test_an_automatic_radius_fits_the_fastest_vector(tmp_path):
    out = tmp_path / "out.exr"
    outcome = run("blur", CAR, "-o", out, *FEW, "--radius", "auto")
    fastest = np.linalg.norm(exr.read_buffers(CAR).velocity, axis=-1).max()
    radius = tomllib.loads(attributes(out)["jaxblur:settings"])["radius"]
    assert fastest <= radius < fastest + 5
    assert f"radius: {radius} px, for half-spreads up to {fastest:.1f} px" in outcome.err
    stored = exr.read_image(out)
    half = expected(radius=radius).astype(np.float16).astype(np.float32)
    np.testing.assert_array_equal(stored, half)


@pytest.mark.slow
def test_vectors_longer_than_the_radius_are_a_warning(tmp_path):
    err = run("blur", CAR, "-o", tmp_path / "out.exr", "--samples", "7", "--radius", "3").err
    assert "jaxblur: warning: " in err and "--radius auto" in err


def test_blurring_a_blurred_frame_is_a_warning(tmp_path):
    once = tmp_path / "once.exr"
    run("blur", CAR, "-o", once, *FEW)
    outcome = run("blur", once, "-o", tmp_path / "twice.exr", *FEW)
    assert outcome.status == 0
    assert "once.exr: was blurred by guertin2014 before; this blurs it again." in outcome.err


def test_png_output_is_srgb(tmp_path):
    out = tmp_path / "out.png"
    outcome = run("blur", CAR, "-o", out, *FEW)
    assert outcome.status == 0 and "8-bit sRGB" in outcome.err
    pixels = read_raw(out)[1]
    shown = srgb.encode(np.clip(expected()[..., :3], 0, 1)) * 255
    assert isinstance(pixels, np.ndarray) and pixels.dtype == np.uint8
    assert np.abs(pixels - shown).max() <= 0.501


def test_a_tif_holds_the_light_and_integers_what_a_screen_shows(tmp_path):
    light = expected()
    run("blur", CAR, "-o", tmp_path / "light.tif", *FEW)
    pixels = read_raw(tmp_path / "light.tif")[1]
    assert isinstance(pixels, np.ndarray) and pixels.dtype == np.float32
    np.testing.assert_array_equal(pixels, np.float32(light))
    shown = srgb.encode(np.clip(light[..., :3], 0, 1))
    for name, most in (("deep.tif", 65535), ("deep.png", 65535)):
        outcome = run("blur", CAR, "-o", tmp_path / name, *FEW, "--bits", "16")
        assert "16-bit sRGB, clipped to 0..1" in outcome.err
        pixels = read_raw(tmp_path / name)[1]
        assert isinstance(pixels, np.ndarray) and pixels.dtype == np.uint16
        assert np.abs(pixels - shown * most).max() <= 0.51
    assert run("blur", CAR, "-o", tmp_path / "out.jpg", *FEW).status == 0
    pixels = read_raw(tmp_path / "out.jpg")[1]
    assert isinstance(pixels, np.ndarray) and pixels.dtype == np.uint8
    assert np.abs(pixels / 255 - shown).mean() < 0.02


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("out.exr", ("--bits", "16"), "--bits: is for pictures"),
        ("out.jpg", ("--bits", "16"), "--bits must be 8 for .jpg, got 16"),
        ("out.png", ("--bits", "32"), "--bits must be 8 or 16 for .png, got 32"),
        ("out.tif", ("--png", "--bits", "32"), "--bits must be 8 or 16 for .png, got 32"),
        ("out.tif", ("--view", "Raw"), "--view: is for pictures and scores"),
    ],
)
def test_bits_and_views_that_a_format_does_not_have(tmp_path, name, options, message):
    outcome = run("blur", CAR, "-o", tmp_path / name, *FEW, *options)
    assert outcome.status == 2 and message in outcome.err
    assert not any(tmp_path.iterdir())


def test_png_beside_the_exr(tmp_path):
    outcome = run("blur", CAR, "-o", tmp_path / "out.exr", *FEW, "--png")
    assert outcome.out.split() == [str(tmp_path / "out.exr"), str(tmp_path / "out.png")]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.exr", "out.png"]


def test_extra_channels_are_dropped_on_request(tmp_path):
    out = tmp_path / "out.exr"
    assert run("blur", CAR, "-o", out, *FEW, "--drop-extra").status == 0
    (part,) = exr.inspect(out).parts
    assert [channel.name for channel in part.channels] == [
        f"ViewLayer.Combined.{c}" for c in "RGBA"
    ]


def test_color_vectors_and_depth_from_three_files(tmp_path):
    channels = plain_frame((24, 32))
    whole = write_single(tmp_path / "whole.exr", channels)
    groups = {"color": "RGB", "depth": ("Z",), "vectors": ("velocity.X", "velocity.Y")}
    for name, members in groups.items():
        write_single(tmp_path / f"{name}.exr", {member: channels[member] for member in members})
    apart = ("--velocity-from", tmp_path / "vectors.exr", "--depth-from", tmp_path / "depth.exr")
    assert run("blur", whole, "-o", tmp_path / "a.exr", *FEW).status == 0
    assert run("blur", tmp_path / "color.exr", "-o", tmp_path / "b.exr", *FEW, *apart).status == 0
    blurred = exr.read_image(tmp_path / "a.exr")
    np.testing.assert_array_equal(blurred, exr.read_image(tmp_path / "b.exr"))
    assert np.abs(blurred - exr.read_image(whole)).max() > 0.05
    inputs = attributes(tmp_path / "b.exr")["jaxblur:inputs"]
    assert inputs == "color.exr, vectors.exr, depth.exr"


def test_an_existing_output_is_kept_unless_told_otherwise(tmp_path):
    out = tmp_path / "out.exr"
    out.write_bytes(b"precious")
    assert "pass --overwrite" in refused("blur", CAR, "-o", out, *FEW)
    assert out.read_bytes() == b"precious"
    assert run("blur", CAR, "-o", out, *FEW, "--overwrite").status == 0
    assert exr.inspect(out).parts[0].attributes["jaxblur:filter"] == "guertin2014"


@pytest.mark.parametrize("option", ["input", "--truth", "--velocity-from"])
def test_an_input_is_never_overwritten(tmp_path, option):
    frame = write_single(tmp_path / "frame.exr", plain_frame())
    other = write_single(tmp_path / "other.exr", plain_frame())
    before = frame.read_bytes(), other.read_bytes()
    if option == "input":
        link = tmp_path / "link.exr"
        link.symlink_to(frame)
        message = refused("blur", frame, "-o", link, "--overwrite")
    else:
        message = refused("blur", frame, option, other, "-o", other, "--overwrite")
    assert "is an input too" in message
    assert (frame.read_bytes(), other.read_bytes()) == before


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (("--filter", "guertin"), ("no filter 'guertin'", "did you mean guertin2014")),
        (("--preset", "blendr"), ("no preset 'blendr'", "did you mean blender")),
        ((*GUERTIN, "--param", "kapa=1"), ("'kapa'", "did you mean kappa", "gamma")),
        (("--param", "kappa=abc"), ("kappa must be a number", "'abc'")),
        (("--param", "kappa"), ("NAME=VALUE",)),
        ((*GUERTIN, "--param", "kappa=0"), ("kappa must be above 0",)),
        ((*GUERTIN, "--param", "tau=1.5"), ("tau must be 0 to 1",)),
        ((*GUERTIN, "--param", "kappa=nan"), ("kappa must be above 0",)),
        (("--filter", "pixel_velocity", "--param", "kappa=1"), ("it has none",)),
        (("--filter", "mcguire2012", "--samples", "14"), ("--samples must be odd", "use 15")),
        (("--samples", "0"), ("whole number from 1",)),
        (("--samples", "9", "--quality", "final"), ("--quality: chooses", "leave out --samples")),
        (
            ("--quality", "best"),
            (
                "choose from",
                "preview",
                "standard",
                "final",
            ),
        ),
        (("--seed", "1.5"), ("frame or a whole number", "'1.5'")),
        (("--samples", "2"), ("--samples must be at least 3 for layered",)),
        (("--radius", "big"), ("whole number from 1",)),
        (("--border", "wrap"), ("skip, clamp",)),
        (("--shutter", "-1"), ("--shutter must be", "-1")),
        (("--shutter", "nan"), ("expected an exposure", "nan")),
        (("--depth", "w"), ("--depth must be auto or one of", "'w'")),
        (("--layer", "Nothing"), ("no layer 'Nothing'",)),
        (("--depth-channel", "Y"), ("no channel called Y",)),
        (
            ("--preset", "arnold", "--velocity-channels", "ViewLayer.Vector.X,ViewLayer.Vector.Y"),
            ("over the shutter", "--file-shutter"),
        ),
        (("--preset", "nuke"), ("no channels of preset `nuke`", "--velocity-channels")),
        (
            ("--velocity-channels", "ViewLayer.Vector.X,ViewLayer.Vector.Y"),
            ("--velocity-channels do not say", "name the convention with --preset"),
        ),
        (("--truth", CUBE.with_name("none.exr")), ("none.exr: no such file",)),
        (("--velocity-from", CUBE.with_name("none.exr")), ("none.exr: no such file",)),
    ],
    ids=lambda value: " ".join(map(str, value)) if str(value[0]).startswith("--") else "",
)
def test_wrong_arguments_are_refused_with_a_remedy(tmp_path, given, words):
    message = refused("blur", CAR, "-o", tmp_path / "out.exr", *given)
    for word in words:
        assert word in message
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "word"),
    [
        ("missing/out.exr", "create it first"),
        ("out.gif", "can write .exr, .png, .tif, .tiff, .jpg, .jpeg only"),
    ],
)
def test_outputs_that_cannot_be_written(tmp_path, name, word):
    assert word in refused("blur", CAR, "-o", tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_an_output_below_a_file_names_it_once(tmp_path):
    (tmp_path / "text.exr").touch()
    message = refused("blur", CAR, "-o", tmp_path / "text.exr" / "out.exr")
    assert f"{tmp_path / 'text.exr'}: is not a folder; choose another name" in message
    message = refused("blur", CAR, "-o", tmp_path / "new" / "out.exr")
    assert f"no folder {tmp_path / 'new'}; create it first" in message
    message = refused("blur", CAR, "-o", tmp_path / "new")
    assert (
        f"new: no such folder; create it, or give a file, such as {tmp_path / 'new'}.exr" in message
    )


def test_nan_vectors_are_refused_by_name_or_taken_as_still_with_a_warning(tmp_path):
    channels = plain_frame((12, 16))
    channels["velocity.Y"][3, 5] = np.nan
    frame, out = write_single(tmp_path / "nan.exr", channels), tmp_path / "out.exr"
    message = refused("blur", frame, "-o", out)
    assert "nan.exr: velocity.Y: 1 of 192 pixels are NaN" in message
    assert "row 3, column 5" in message and "--nonfinite=ignore" in message
    assert not out.exists()
    outcome = run("blur", frame, "-o", out, "--nonfinite", "ignore")
    assert outcome.status == 0 and "jaxblur: warning: " in outcome.err
    assert (
        "velocity.X, velocity.Y: 1 of 192 pixels are NaN or infinite, and are taken" in outcome.err
    )
    assert np.isfinite(exr.read_image(out)).all()


def test_truncated_files(tmp_path):
    data = CAR.read_bytes()
    for share in (0.001, 0.5, 0.95):
        frame = tmp_path / "cut.exr"
        frame.write_bytes(data[: int(share * len(data))])
        assert "cut.exr" in refused("blur", frame, "-o", tmp_path / "out.exr")
        assert [path.name for path in tmp_path.iterdir()] == ["cut.exr"]


def test_a_file_without_depth_names_the_ways_out(tmp_path):
    channels = plain_frame((12, 16))
    del channels["Z"]
    frame, out = write_single(tmp_path / "flat.exr", channels), tmp_path / "out.exr"
    message = refused("blur", frame, "-o", out)
    assert "--depth-from" in message and "--depth=flat" in message
    assert run("blur", frame, "-o", out, *FEW, "--depth=flat").status == 0


def test_a_truth_of_another_size_is_refused_before_the_work(tmp_path):
    truth = write_single(tmp_path / "truth.exr", plain_frame((20, 30)))
    message = refused("blur", CAR, "-o", tmp_path / "out.exr", "--truth", truth)
    assert "30x20" in message and "160x112" in message
    assert not (tmp_path / "out.exr").exists()


def test_the_truth_may_be_a_png(tmp_path):
    png = tmp_path / "truth.png"
    exr.write_image(png, exr.read_image(TRUTH))
    outcome = run("blur", CAR, "-o", tmp_path / "out.exr", *FEW, "--truth", png)
    # Within the rounding to 8 bits of the figure in the data's README.
    assert abs(float(outcome.out.splitlines()[2].split()[1]) - 22.15) < 0.05


def test_a_truth_of_a_frame_that_has_no_scores_is_refused_before_the_blur(tmp_path):
    frame = write_single(tmp_path / "input.exr", plain_frame((10, 40)))
    truth = write_single(tmp_path / "truth.exr", plain_frame((10, 40)))
    message = refused("blur", frame, "-o", tmp_path / "out.exr", "--truth", truth)
    assert "has 40x10 pixels, but scores need 11x11 or more" in message


@pytest.mark.parametrize("role", ["input", "depth"])
@pytest.mark.parametrize("output", ["out.exr", "out.png"])
def test_an_input_that_changes_meanwhile_is_an_error(tmp_path, monkeypatch, role, output):
    channels = plain_frame((16, 16))
    files = {name: write_single(tmp_path / f"{name}.exr", channels) for name in ("input", "depth")}
    blur = blurring.blur

    def replaced_meanwhile(*arguments):
        write_single(files[role], channels | {"Z": channels["Z"] + 1})
        return blur(*arguments)

    monkeypatch.setattr(blurring, "blur", replaced_meanwhile)
    command = ("blur", files["input"], "-o", tmp_path / output, "--depth-from", files["depth"])
    message = refused(*command, "--filter", "pixel_velocity")
    assert f"{role}.exr: changed while it was being used; nothing was written" in message
    assert sorted(path.name for path in tmp_path.iterdir()) == ["depth.exr", "input.exr"]


def test_an_input_that_changes_between_two_outputs_is_not_used_any_more(tmp_path, monkeypatch):
    channels = plain_frame((16, 16))
    frame = write_single(tmp_path / "input.exr", channels)
    write_image = exr.write_image

    def write_then_change(path, *arguments, **options):
        write_image(path, *arguments, **options)
        write_single(frame, channels | {"R": channels["R"] + 1})

    monkeypatch.setattr(exr, "write_image", write_then_change)
    output = tmp_path / "out.exr"
    outcome = run("blur", frame, "-o", output, "--png", "--filter", "pixel_velocity")
    assert outcome.status == 0, outcome.err
    written = exr.read_image(output)
    np.testing.assert_allclose(
        exr.read_image(tmp_path / "out.png"), np.clip(written, 0, 1), atol=5e-3
    )


def test_a_pattern_for_the_output_of_one_file_is_refused(tmp_path):
    out = tmp_path / "out.####.exr"
    assert "has a place for frame numbers, but" in refused("blur", CAR, "-o", out)
    assert not out.exists()
