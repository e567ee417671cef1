"""``jaxblur layers``: files, parts, sequences and deep files, blurred together."""

from typing import Any

import numpy as np
import pytest

import jaxblur
from jaxblur import exr
from jaxblur.cli.commands.layers import ELSEWHERE
from jaxblur.cli.main import build_parser
from tests.command_line import refused, run
from tests.exr_files import make_spec, write_parts, write_single
from tests.test_exr_deep import CHANNELS, DISCS, SIZE, disc, psnr, truth, write_deep

SETTINGS = jaxblur.Settings(samples=21, radius=24, fetch="bilinear")
FEW = ("--samples", "21", "--radius", "24")
SPEED = 5.0
"""Pixels that the disc moves in a frame; half-spread a quarter of it."""


def front_at(frame):
    """A disc with alpha, in the channels of a file."""
    moved = ((20 + SPEED * frame, 24), 9, (SPEED / 4, 0.0), (0.9, 0.5, 0.2), 1.0, 2.0)
    mask, image = disc(*moved)
    image[..., 4] = np.where(mask, 2.0, np.inf)
    image[..., 5:] = np.where(mask[..., None], image[..., 5:], 0)
    return channels_of(image)


def channels_of(image):
    moved = np.moveaxis(image, -1, 0).astype(np.float32)
    return {str(name): values for name, values in zip(CHANNELS, moved, strict=True)}


def back_at(frame):
    """Opaque stripes that move to the left, without alpha."""
    columns = np.mgrid[: SIZE[0], : SIZE[1]][1] + SPEED * frame
    stripes = 0.5 + 0.4 * np.sin(columns * 0.35)
    colors = {name: stripes * share for name, share in zip("RGB", (0.3, 0.6, 0.9), strict=True)}
    more = {"Z": np.full(SIZE, 9.0), "velocity.X": np.full(SIZE, -SPEED)}
    more["velocity.Y"] = np.zeros(SIZE)
    return {name: np.asarray(v, np.float32) for name, v in (colors | more).items()}


@pytest.fixture
def files(tmp_path):
    """A folder with one frame of each layer, the front one with metadata."""
    write_single(tmp_path / "hero.exr", front_at(0), ["half"] * 4 + ["float"] * 3, shot="7")
    write_single(tmp_path / "street.exr", back_at(0))
    return tmp_path


def opaque(frame):
    alpha = np.ones((*SIZE, 1), np.float32)
    return frame.replace(color=np.concatenate([frame.color, alpha], axis=-1))


def in_python(hero, street, holdout=False, **options):
    layers = [jaxblur.read_frame(path, shutter=0.5) for path in (hero, street)]
    stack = [jaxblur.Layer(layers[0], holdout=holdout), opaque(layers[1])]
    return np.asarray(jaxblur.blur_layers(stack, settings=SETTINGS, **options))


def half(image):
    return np.asarray(image).astype(np.float16).astype(np.float32)


@pytest.mark.slow
def test_files_are_blurred_together_as_in_python(files):
    hero, street, out = files / "hero.exr", files / "street.exr", files / "out.exr"
    outcome = run("layers", hero, street, "-o", out, *FEW)
    assert outcome.status == 0 and outcome.out.split() == [str(out)], outcome
    expected = in_python(hero, street)
    np.testing.assert_array_equal(exr.read_channels(out, list("RGBA")), half(expected))
    (part,) = exr.inspect(out).parts
    assert [channel.name for channel in part.channels] == list("RGBA")
    notes = part.attributes
    assert notes["jaxblur:layers"] == notes["jaxblur:inputs"] == "hero.exr, street.exr"
    assert notes["jaxblur:filter"] == "layered" and notes["jaxblur:blurred"] == "A, B, G, R"
    assert notes["shot"] == "7", "the metadata of the front layer"
    again = refused("layers", hero, street, "-o", out, *FEW)
    assert "exists; pass --overwrite" in again
    # The rest of the options that need another run of the filter.
    more = ("--holdout", "hero", "--shutter-curve", "triangle", "--seed", "3", "--overwrite")
    assert run("layers", hero, street, "-o", out, *FEW, *more).status == 0
    shutter = jaxblur.Shutter.triangle()
    noise = jaxblur.noise.make_noise("ign", *SIZE, 3)
    expected = in_python(hero, street, holdout=True, exposure=shutter, noise=noise)
    np.testing.assert_allclose(exr.read_image(out), half(expected), atol=1e-3)
    assert (
        exr.inspect(out).parts[0].attributes["jaxblur:layers"] == "hero.exr (holdout), street.exr"
    )


def test_parts_and_layers_by_name(files):
    hero, street, out = front_at(0), back_at(0), files / "out.exr"
    named = {f"hero.{name}": values for name, values in hero.items()}
    named |= {f"street.{name}": values for name, values in street.items()}
    write_single(files / "one.exr", named)
    parts = [(make_spec(p, name=n), p) for n, p in (("hero", hero), ("street", street))]
    write_parts(files / "parts.exr", parts)
    write_single(files / "hero.exr", hero)
    expected = in_python(files / "hero.exr", files / "street.exr")
    for name in ("one.exr", "parts.exr"):
        path = files / name
        given = (f"{path}:hero", f"{path}:street", "-o", out, *FEW, "--overwrite")
        assert run("layers", *given).status == 0
        np.testing.assert_array_equal(exr.read_channels(out, list("RGBA")), expected)
        (part,) = exr.inspect(out).parts
        assert part.attributes["jaxblur:layers"] == f"{name}:hero, {name}:street"
        assert part.name == ""


def test_a_still_layer_needs_no_vectors(files):
    out, plate = files / "out.exr", files / "plate.exr"
    write_single(plate, {name: back_at(0)[name] for name in "RGB"})
    given = ("layers", files / "hero.exr", plate, "-o", out, *FEW)
    message = refused(*given)
    assert "plate.exr: layer 2 has no motion vectors" in message and "--still 2" in message
    assert run(*given, "--still", "plate").status == 0
    hero = jaxblur.read_frame(files / "hero.exr", shutter=0.5)
    alone = np.asarray(jaxblur.blur_layers([hero], settings=SETTINGS))
    behind = np.stack([back_at(0)[name] for name in "RGB"], axis=-1)
    expected = alone[..., :3] + (1 - alone[..., 3:]) * behind
    np.testing.assert_allclose(exr.read_image(out)[..., :3], expected, atol=2e-3)


@pytest.mark.slow
def test_passes_still_add_up_to_the_picture(files):
    for name, channels in (("hero.exr", front_at(0)), ("street.exr", back_at(0))):
        shares = np.linspace(0.2, 0.8, SIZE[1], dtype=np.float32)
        for c in "RGB":
            channels[f"diffuse.{c}"] = channels[c] * shares
            channels[f"glossy.{c}"] = channels[c] * (1 - shares)
        write_single(files / name, channels)
    out = files / "out.exr"
    given = ("layers", files / "hero.exr", files / "street.exr", "-o", out, *FEW)
    assert run(*given, "--all-color").status == 0
    picture, *passes = (
        exr.read_channels(out, [f"{prefix}{c}" for c in "RGB"])
        for prefix in ("", "diffuse.", "glossy.")
    )
    np.testing.assert_allclose(passes[0] + passes[1], picture, atol=2e-6)
    expected = in_python(files / "hero.exr", files / "street.exr")
    np.testing.assert_allclose(picture, expected[..., :3], atol=1e-6)
    write_single(files / "street.exr", back_at(0))
    message = refused(*given, "--all-color", "--overwrite")
    assert "street.exr" in message and "no other layer of color" in message


@pytest.mark.slow
def test_a_deep_file_becomes_layers(tmp_path):
    deep = write_deep(tmp_path / "deep.exr", [disc(*parts) for parts in DISCS])
    plain, out = ("--noise", "none", "--samples", "66", "--radius", "24"), tmp_path / "out.exr"
    outcome = run("layers", deep, "-o", out, *plain, "--deep-layers", "2")
    assert outcome.status == 0 and "flattened into 2 layers" in outcome.err, outcome
    assert psnr(exr.read_image(out), truth()) > 45
    (part,) = exr.inspect(out).parts
    assert not part.deep and part.attributes["jaxblur:layers"] == "deep.exr, deep.exr"


@pytest.mark.slow
def test_sequences_have_neighbors_and_are_resumed(tmp_path):
    for frame in (1, 2, 3):
        write_single(tmp_path / f"hero.{frame:04d}.exr", front_at(frame))
        write_single(tmp_path / f"street.{frame:04d}.exr", back_at(frame))
    hero, street = tmp_path / "hero.####.exr", tmp_path / "street.####.exr"
    given = ("layers", hero, street, "-o", tmp_path / "out.####.exr", *FEW)
    outcome = run(*given, "--frames", "1-2")
    assert outcome.status == 0 and "2 written" in outcome.out, outcome
    read = {
        frame: [
            jaxblur.read_frame(tmp_path / f"hero.{frame:04d}.exr", shutter=0.5),
            opaque(jaxblur.read_frame(tmp_path / f"street.{frame:04d}.exr", shutter=0.5)),
        ]
        for frame in (1, 2, 3)
    }
    stack = [jaxblur.Layer(read[2][k], before=read[1][k], after=read[3][k]) for k in (0, 1)]
    noise = jaxblur.noise.make_noise("ign", *SIZE, 2)
    expected = jaxblur.blur_layers(stack, settings=SETTINGS, noise=noise)
    found = exr.read_channels(tmp_path / "out.0002.exr", list("RGBA"))
    np.testing.assert_allclose(found, expected, atol=1e-6)
    notes = exr.inspect(tmp_path / "out.0002.exr").parts[0].attributes
    assert notes["jaxblur:neighbors"] == "before hero.0001.exr, after hero.0003.exr"
    assert "3 written" not in run(*given).out
    assert "3 kept" in run(*given).out
    # A file of the second layer counts as an input; another holdout is another choice.
    write_single(tmp_path / "street.0003.exr", back_at(3))
    plan = run(*given, "--dry-run").out.splitlines()[-1]
    assert plan == "1 keep, 2 blur", "frame 2 sees frame 3"
    message = refused(*given, "--holdout", "1")
    assert "made with other parameters" in message
    # One file for all frames, and neighbors given for a single frame.
    single = tmp_path / "street.0002.exr"
    given = ("layers", hero, single, "-o", tmp_path / "plate.####.exr", *FEW, "--frames", "2")
    assert run(*given).status == 0
    near = [tmp_path / f"{name}.0001.exr" for name in ("hero", "street")]
    out = tmp_path / "single.exr"
    layers = (tmp_path / "hero.0002.exr", tmp_path / "street.0002.exr")
    assert run("layers", *layers, "-o", out, *FEW, "--before", *near).status == 0
    stack = [jaxblur.Layer(read[2][k], before=read[1][k]) for k in (0, 1)]
    expected = jaxblur.blur_layers(stack, settings=SETTINGS)
    np.testing.assert_allclose(exr.read_channels(out, list("RGBA")), expected, atol=1e-6)


def test_frames_that_only_other_layers_have_are_told(tmp_path):
    for frame in (1, 2, 3, 4, 6):
        write_single(tmp_path / f"street.{frame:04d}.exr", back_at(frame))
    for frame in (1, 2):
        write_single(tmp_path / f"hero.{frame:04d}.exr", front_at(frame))
    hero, street = tmp_path / "hero.####.exr", tmp_path / "street.####.exr"
    given = ("layers", hero, street, "-o", tmp_path / "out.####.exr", "--dry-run")
    outcome = run(*given)
    assert outcome.status == 0 and "2 blur" in outcome.out
    words = f"{hero}: frames that it lacks are left out: 3-4,6, which {street} has."
    assert outcome.err.count(words) == 1, outcome.err
    assert "left out" not in run(*given, "-F", "1-2").err


@pytest.mark.slow
def test_layers_given_back_to_front_are_told(files):
    """Depths are compared where both layers cover a pixel; a tenth out of order is no warning."""
    opaque = back_at(0) | {"A": np.ones(SIZE, np.float32)}
    write_single(files / "wall.exr", opaque)
    options = ("-o", files / "out.exr", "--overwrite", "--samples", "3", "--radius", "8")
    right = run("layers", files / "hero.exr", files / "wall.exr", *options)
    assert right.status == 0 and "is farther away" not in right.err
    wrong = run("layers", files / "wall.exr", files / "hero.exr", *options)
    assert wrong.status == 0
    words = "wall.exr is given in front of hero.exr, but is farther away in 100 % of the pixels"
    assert words in wrong.err
    depth = np.where(np.arange(SIZE[1]) < 0.1 * SIZE[1], np.float32(1), opaque["Z"])
    write_single(files / "wall.exr", opaque | {"Z": np.broadcast_to(depth, SIZE)})
    assert "farther" not in run("layers", files / "hero.exr", files / "wall.exr", *options).err


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("street.exr", "hero.exr"), "street.exr: R, G, B: no alpha (A), which every layer but"),
        (("street.exr",), "street.exr: is one layer; give more"),
        (("hero.exr", "street.exr", "--deep-layers", "2"), "--deep-layers: no layer is of a deep"),
        (("hero.exr:villain", "street.exr"), "hero.exr: no layer 'villain'"),
        (("hero.exr", "street.exr", "--holdout", "3"), "--holdout 3: no layer of that name; there"),
        (("hero.exr", "--holdout", "hero"), "--holdout: nothing is left to be seen"),
        (("hero.exr", "small.exr"), "small.exr: the display window is 8x6 at (0, 0), but that of"),
        (("hero.exr", "street.exr", "./hero.exr"), "hero.exr: layer 3 is layer 1 again; leave it"),
        (("hero.exr", "street.exr", "--split", "even"), "--split: layers are blurred by layered"),
        (("hero.exr", "street.exr", "--focus", "4"), "--focus: layers are blurred by motion alone"),
        (("hero.exr", "street.exr", "--splitt"), "unknown option --splitt"),
        (("hero.exr", "street.exr", "--before", "hero.exr"), "--before: needs one file for each"),
        (("wrong.exr", "street.exr"), "wrong.exr: A: alpha from 0 to 7"),
        (("hero.exr", "gray.exr"), "gray.exr: 2 color channels with alpha, but hero.exr has 4"),
        (("hero.exr", "missing.exr"), "missing.exr: no such file"),
        (("many.exr",), "choose one as FILE:LAYER"),
        (("nodepth.exr", "street.exr"), "give --depth-channel, or --depth=flat"),
        (("hero.exr", "street.exr", "-F", "1"), "for the frame number"),
    ],
)
def test_what_is_no_stack_of_layers_is_refused(files, monkeypatch, arguments, says):
    monkeypatch.chdir(files)
    write_single("small.exr", {name: values[:6, :8] for name, values in back_at(0).items()})
    write_single("wrong.exr", front_at(0) | {"A": 7 * front_at(0)["A"]})
    named = {f"{layer}.{c}": back_at(0)[c] for layer in ("near", "far") for c in "RGB"}
    write_single("many.exr", named)
    write_single("nodepth.exr", {n: v for n, v in front_at(0).items() if n != "Z"})
    gray = back_at(0)
    write_single("gray.exr", {"Y": gray["R"]} | {n: gray[n] for n in (*CHANNELS[4:],)})
    assert says in refused("layers", *arguments, "-o", "out.exr")


def test_every_option_of_blur_is_taken_or_has_a_remedy():
    parser: Any = build_parser()
    (commands,) = parser._subparsers._group_actions
    options = {
        name: {text for text in parser._option_string_actions if text.startswith("--")}
        for name, parser in commands.choices.items()
    }
    assert options["blur"] - options["layers"] == set(ELSEWHERE)
