"""Color spaces of files: previews, scores and pages show them as they look, by OpenColorIO."""

import json

import numpy as np
import OpenImageIO as oiio
import pytest

from jaxblur import exr, metrics, srgb
from tests.command_line import refused, run
from tests.exr_files import make_spec, read_raw, write_parts

SHAPE = (12, 16)
ACESCG = (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767)
REC2020 = (0.708, 0.292, 0.17, 0.797, 0.131, 0.046, 0.3127, 0.329)
FEW = ("--filter", "guertin2014", "--samples", "3", "--radius", "4")
PATCH = (0.6, 0.15, 0.05)
VIEW = "ACES 2.0 - SDR 100 nits (Rec.709)"

# A saturated red of ACEScg in 8-bit sRGB, by the matrix that is published for AP1 to Rec.709 with
# Bradford adaptation (ACES CSC transform), not by this package.
AP1_TO_REC709 = np.array(
    [
        [1.70505099, -0.62179212, -0.08325887],
        [-0.13025642, 1.14080474, -0.01054832],
        [-0.02400336, -0.12896898, 1.15297233],
    ]
)


def expected():
    linear = np.clip(AP1_TO_REC709 @ PATCH, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055) * 255


def write_patch(path, **attributes):
    """Write a frame of one color that moves, with attributes that name its color space."""
    channels = {name: np.full(SHAPE, value) for name, value in zip("RGB", PATCH, strict=True)}
    channels |= {"Z": np.ones(SHAPE), "velocity.X": np.full(SHAPE, 3.0)}
    channels["velocity.Y"] = np.zeros(SHAPE)
    spec = make_spec(channels)
    for name, value in attributes.items():
        if isinstance(value, tuple):
            spec.attribute(name, oiio.TypeDesc(f"float[{len(value)}]"), value)
        else:
            spec.attribute(name, value)
    write_parts(path, [(spec, {n: v.astype(np.float32) for n, v in channels.items()})])
    # OpenImageIO writes colorInteropID in the place of this attribute, which older versions wrote.
    path.write_bytes(path.read_bytes().replace(b"iioo:ColorSpace", b"oiio:ColorSpace"))
    return path


def shown(path):
    pixels = read_raw(path)[1]
    assert isinstance(pixels, np.ndarray)
    return pixels[6, 8].astype(float)


@pytest.mark.parametrize(
    "attributes",
    [
        {"chromaticities": ACESCG},
        {"colorInteropID": "lin_ap1_scene"},
        {"iioo:ColorSpace": "ACEScg"},
    ],
    ids=["chromaticities", "colorInteropID", "oiio:ColorSpace"],
)
def test_a_saturated_patch_looks_as_it_should(tmp_path, attributes):
    source, out = write_patch(tmp_path / "in.exr", **attributes), tmp_path / "out.exr"
    outcome = run("blur", source, "-o", out, "--png", *FEW)
    assert outcome.status == 0, outcome.err
    name = next(iter(attributes)).replace("iioo", "oiio")
    lines = [line for line in outcome.err.splitlines() if "colors:" in line]
    assert lines == [f"jaxblur: colors: ACEScg ({name}) to sRGB, by ocio://default"]
    assert np.abs(shown(tmp_path / "out.png") - expected()).max() <= 1
    notes = exr.inspect(tmp_path / "out.png").parts[0].attributes
    assert notes["jaxblur:colors"] == f"ACEScg ({name}) to sRGB, by ocio://default"
    np.testing.assert_allclose(exr.read_image(out)[6, 8], PATCH, rtol=1e-3)


@pytest.mark.parametrize(
    "attributes", [{}, {"colorInteropID": "lin_rec709_scene"}, {"iioo:ColorSpace": "scene_linear"}]
)
def test_files_without_a_space_or_in_linear_srgb_are_shown_as_they_are(tmp_path, attributes):
    source = write_patch(tmp_path / "in.exr", **attributes)
    outcome = run("blur", source, "-o", tmp_path / "out.png", *FEW)
    assert outcome.status == 0 and "colors:" not in outcome.err
    plain = np.round(srgb.encode(np.array(PATCH)) * 255)
    np.testing.assert_array_equal(shown(tmp_path / "out.png"), plain)


def test_a_space_can_be_given(tmp_path):
    source = write_patch(tmp_path / "in.exr", chromaticities=REC2020)
    given = ("--color-space", "ACEScg")
    assert "(given) to sRGB" in run("blur", source, "-o", tmp_path / "out.png", *FEW, *given).err
    assert np.abs(shown(tmp_path / "out.png") - expected()).max() <= 1
    exr.write_image(tmp_path / "python.png", exr.read_image(source), color_space="lin_ap1_scene")
    assert np.abs(shown(tmp_path / "python.png") - expected()).max() <= 1


@pytest.mark.parametrize(
    ("attributes", "words"),
    [
        ({"chromaticities": (0.5, 0.3, 0.2, 0.5, 0.1, 0.1, 0.3, 0.3)}, "are of no known color"),
        ({"iioo:ColorSpace": "Camera X"}, "names the color space Camera X, which ocio://default"),
    ],
)
def test_an_unknown_space_is_a_warning(tmp_path, attributes, words):
    source = write_patch(tmp_path / "in.exr", **attributes)
    outcome = run("blur", source, "-o", tmp_path / "out.png", *FEW)
    assert outcome.status == 0 and words in outcome.err and "--color-space" in outcome.err
    plain = np.round(srgb.encode(np.array(PATCH)) * 255)
    np.testing.assert_array_equal(shown(tmp_path / "out.png"), plain)


def test_a_view_is_that_of_openimageio(tmp_path):
    source = write_patch(tmp_path / "in.exr", chromaticities=ACESCG)
    outcome = run("blur", source, "-o", tmp_path / "out.png", "--view", VIEW, *FEW)
    assert outcome.status == 0
    assert f"ACEScg (chromaticities) to {VIEW} of sRGB - Display, by ocio" in outcome.err
    pixel = oiio.ImageBuf(np.array([[PATCH]], np.float32))
    display = ("sRGB - Display", VIEW, "ACEScg", "", False, False, "", "", "ocio://default")
    wanted = np.asarray(oiio.ImageBufAlgo.ociodisplay(pixel, *display).get_pixels("float"))[0, 0]
    assert np.abs(shown(tmp_path / "out.png") - np.clip(wanted, 0, 1) * 255).max() <= 0.51
    assert np.abs(shown(tmp_path / "out.png") - expected()).max() > 5


def test_info_says_how_colors_are_shown(tmp_path):
    source = write_patch(tmp_path / "in.exr", chromaticities=ACESCG)
    words = "ACEScg (chromaticities) to sRGB, by ocio://default"
    assert f"colors of previews: {words}\n" in run("info", source).out
    assert json.loads(run("info", source, "--json").out)["shown_as"] == words
    plain = write_patch(tmp_path / "plain.exr")
    assert (
        "colors of previews: linear sRGB (the file names no color space) to sRGB"
        in run("info", plain).out
    )


def test_unknown_names_are_refused_with_those_there_are(tmp_path):
    source = write_patch(tmp_path / "in.exr")
    line = refused("blur", source, "-o", tmp_path / "o.png", "--view", "Filmic")
    assert "--view must be one of" in line and VIEW in line and "'Filmic'" in line
    line = refused("blur", source, "-o", tmp_path / "o.png", "--color-space", "Foo")
    assert "--color-space must be one of" in line and "ACEScg" in line
    line = refused("blur", source, "-o", tmp_path / "o.exr", "--view", VIEW)
    assert "write a picture, such as .png, or add --truth" in line
    with pytest.raises(ValueError, match="`view` must be one of"):
        exr.write_image(tmp_path / "o.png", exr.read_image(source), view="Filmic")
    assert not list(tmp_path.glob("o.*"))


CONFIG = """\
ocio_profile_version: 1
roles: {scene_linear: mine, default: mine}
displays:
  monitor:
    - !<View> {name: Dark, colorspace: dark}
active_displays: [monitor]
active_views: [Dark]
colorspaces:
  - !<ColorSpace> {name: mine}
  - !<ColorSpace>
    name: dark
    from_reference: !<MatrixTransform> {matrix: [0.5,0,0,0, 0,0.5,0,0, 0,0,0.5,0, 0,0,0,1]}
"""


def test_the_configuration_of_the_user_is_respected(tmp_path, monkeypatch):
    (tmp_path / "studio.ocio").write_text(CONFIG)
    monkeypatch.setenv("OCIO", str(tmp_path / "studio.ocio"))
    source = write_patch(tmp_path / "in.exr", **{"iioo:ColorSpace": "mine"})
    out = tmp_path / "out.png"
    outcome = run("blur", source, "-o", out, "--view", "Dark", *FEW)
    assert outcome.status == 0, outcome.err
    assert "mine (oiio:ColorSpace) to Dark of monitor, by " in outcome.err
    np.testing.assert_array_equal(shown(out), np.round(np.array(PATCH) * 0.5 * 255))
    assert "must be one of Dark" in refused(
        "blur", source, "-o", tmp_path / "o.png", "--view", VIEW, *FEW
    )
    # It has no linear sRGB, which a plain preview needs; the built-in configuration has.
    aces = write_patch(tmp_path / "aces.exr", chromaticities=ACESCG)
    assert run("blur", aces, "-o", out, "--overwrite", *FEW).status == 0
    assert np.abs(shown(out) - expected()).max() <= 1
    monkeypatch.setenv("OCIO", str(tmp_path / "none.ocio"))
    assert "$OCIO: " in refused("blur", source, "-o", tmp_path / "o.png", "--view", "Dark", *FEW)


def test_scores_compare_what_a_screen_shows(tmp_path):
    source = write_patch(tmp_path / "in.exr", chromaticities=ACESCG)
    linear = np.clip(AP1_TO_REC709 @ PATCH, 0, None)
    truth = tmp_path / "truth.exr"
    exr.write_image(truth, np.tile(linear.astype(np.float32), (*SHAPE, 1)), dtype="float")
    for more, best in (((), True), (("--view", VIEW), True), (("--color-space", "ACEScg"), False)):
        out = tmp_path / "out.exr"
        given = ("--truth", truth, "--overwrite", "--filter", "pixel_velocity", *more)
        outcome = run("blur", source, "-o", out, *given)
        assert outcome.status == 0, outcome.err
        psnr = float(outcome.out.splitlines()[-1].split()[1])
        # A given color space is that of both files, and the truth is linear sRGB.
        assert (psnr > 50) == best, outcome.out


def test_the_page_says_how_colors_were_converted(tmp_path):
    source = write_patch(tmp_path / "in.exr", chromaticities=ACESCG)
    truth = write_patch(tmp_path / "truth.exr", chromaticities=ACESCG)
    given = ("--truth", truth, "--result", tmp_path / "plain")
    assert run("blur", source, "-o", tmp_path / "out.exr", *given, *FEW).status == 0
    page = tmp_path / "plain.html"
    assert run("report", tmp_path / "plain", "-o", page).status == 0
    assert "Colors: ACEScg (chromaticities) to sRGB, by ocio://default." in page.read_text()
    stored = exr.read_image(tmp_path / "plain/pictures/000.exr")[6, 8]
    np.testing.assert_allclose(stored, AP1_TO_REC709 @ PATCH, atol=1e-3)

    viewed = tmp_path / "viewed.html"
    outcome = run("report", tmp_path / "plain", "-o", viewed, "--view", VIEW)
    assert outcome.status == 0 and VIEW in outcome.err
    assert f"to {VIEW} of sRGB - Display" in viewed.read_text()
    given = ("--truth", truth, "--result", tmp_path / "viewed", "--view", VIEW, "--overwrite")
    assert run("blur", source, "-o", tmp_path / "out.exr", *given, *FEW).status == 0
    line = refused("report", tmp_path / "viewed", "-o", tmp_path / "no.html", "--view", VIEW)
    assert f"are in the view {VIEW} already" in line
    assert "--view must be one of" in refused(
        "report", tmp_path / "plain", "-o", tmp_path / "no.html", "--view", "Filmic"
    )
    shot = exr.read_image(tmp_path / "viewed/pictures/000.exr")
    assert metrics.display(shot).max() <= 1


def test_a_benchmark_compares_what_a_screen_shows(tmp_path):
    source = write_patch(tmp_path / "in.exr", chromaticities=ACESCG)
    truth = tmp_path / "truth.exr"
    linear = np.clip(AP1_TO_REC709 @ PATCH, 0, None).astype(np.float32)
    exr.write_image(truth, np.tile(linear, (*SHAPE, 1)), dtype="float")
    given = ("--truth", truth, "-o", tmp_path / "out.csv", "--methods", "unblurred")
    outcome = run("bench", source, *given, "--repeats", "1")
    assert outcome.status == 0, outcome.err
    (line,) = [line for line in outcome.err.splitlines() if "PSNR" in line]
    assert float(line.partition("PSNR ")[2].split()[0]) > 50


@pytest.mark.parametrize(
    ("attributes", "name"),
    [
        ({"chromaticities": ACESCG}, "ACEScg (chromaticities)"),
        ({"colorInteropID": "lin_rec709_scene"}, "linear sRGB (colorInteropID)"),
        ({"iioo:ColorSpace": "lin_srgb"}, "linear sRGB (oiio:ColorSpace)"),
        ({}, "linear sRGB (the file names no color space)"),
    ],
)
def test_a_space_has_one_name(tmp_path, attributes, name):
    source, out = write_patch(tmp_path / "in.exr", **attributes), tmp_path / "out.png"
    assert f"colors of previews: {name} to sRGB" in run("info", source).out
    assert f"colors: {name} to {VIEW}" in run("blur", source, "-o", out, "--view", VIEW, *FEW).err
