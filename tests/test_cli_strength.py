"""Strength on the command line: ``--scale-motion`` by mattes and maps, ``--limit-motion``."""

import numpy as np
import pytest

from jaxblur import exr
from jaxblur.exr.header import relabel_as_uint
from tests.command_line import refused, run
from tests.exr_files import write_single
from tests.hero_files import BLUR, HERO, blurred, crypto_notes, frame, ids, note, write_crypto


def test_a_thing_at_rest_keeps_its_pixels(tmp_path):
    path = write_crypto(tmp_path / "a.exr")
    before = exr.read_image(path)
    plain = blurred(path)
    assert (plain != before).any(axis=-1)[HERO].all()
    # Three quarters of the hero are covered: a quarter of 1.5 px is left, which nothing blurs.
    image = blurred(path, "--scale-motion", "crypto:/hero=0")
    np.testing.assert_array_equal(image[HERO], before[HERO])
    np.testing.assert_array_equal(image[~HERO], plain[~HERO])
    assert note(tmp_path / "out.exr") == "scaled crypto:/hero=0"


def test_identifiers_mattes_and_maps(tmp_path):
    extra = {"id": np.where(HERO, 7, 3), "matte.Y": HERO, "gain.Y": np.where(HERO, 0, 0.5)}
    channels = frame() | {name: np.asarray(v, np.float32) for name, v in extra.items()}
    path = write_single(tmp_path / "a.exr", channels)
    before, half = exr.read_image(path), blurred(path, "--shutter", "0.25")
    plain = blurred(path)
    for option in ("id:id:7=0", "matte:matte.Y=0"):
        image = blurred(path, "--scale-motion", option)
        np.testing.assert_array_equal(image[HERO], before[HERO])
        np.testing.assert_array_equal(image[~HERO], plain[~HERO])
    image = blurred(path, "--scale-motion", "map:gain.Y")
    np.testing.assert_array_equal(image[HERO], before[HERO])
    np.testing.assert_allclose(image[~HERO], half[~HERO], atol=1e-6)
    both = blurred(path, "--scale-motion", "id:id:3=0.25", "--scale-motion", "2")
    np.testing.assert_allclose(both[~HERO], half[~HERO], atol=1e-6)
    assert note(tmp_path / "out.exr") == "scaled id:id:3=0.25; scaled 2"


def test_identifiers_in_whole_numbers(tmp_path):
    channels = frame() | {"id": np.where(HERO, 4_000_000_001, 4_000_000_002).astype(np.uint32)}
    types = ["float"] * (len(channels) - 1)
    bits = {**channels, "id": channels["id"].view(np.float32)}
    path = write_single(tmp_path / "a.exr", bits, [*types, "float"])
    relabel_as_uint(str(path), 0, ["id"])
    assert exr.inspect(path).channel("id").type == "uint"
    image = blurred(path, "--scale-motion", "id:id:4000000001=0")
    np.testing.assert_array_equal(image[HERO], exr.read_image(path)[HERO])
    assert (image[~HERO] != exr.read_image(path)[~HERO]).any()


def test_what_no_pixel_has_is_a_warning_and_nothing_at_all_an_error(tmp_path):
    notes = crypto_notes(("/hero", "/set/ground", "/away"))
    path = write_crypto(tmp_path / "a.0001.exr", notes=notes)
    write_crypto(tmp_path / "a.0002.exr", notes=notes)
    away, hero = ("--scale-motion", "crypto:/away=0"), ("--scale-motion", "crypto:/hero=0")
    command = ("blur", path, "-o", tmp_path / "out.exr", "--overwrite", *BLUR)
    outcome = run(*command, *away, *hero)
    assert outcome.status == 0
    assert "no pixel has crypto:/away; there are /set/ground, /hero." in outcome.err
    outcome = run(*command, *hero, "--scale-motion", "id:Z:5=0")
    assert outcome.status == 0 and "no pixel has id:Z:5; there are 4, 9." in outcome.err
    assert "none is for any pixel of" in refused(*command, *away)
    names = ("blur", tmp_path / "a.####.exr", "-o", tmp_path / "o.####.exr", "--overwrite", *BLUR)
    outcome = run(*names, *away)
    assert outcome.status == 1 and "none is for any pixel of any frame" in outcome.err
    assert run(*names, *away, *hero).status == 0


def test_mattes_may_be_in_a_file_of_their_own(tmp_path):
    path = write_single(tmp_path / "a.exr", frame())
    mattes = write_single(tmp_path / "m.exr", ids(("/hero", "/set/ground")), **crypto_notes())
    image = blurred(path, "--scale-motion", "crypto:/hero=0", "--matte-from", mattes)
    np.testing.assert_array_equal(image[HERO], exr.read_image(path)[HERO])
    assert "m.exr" in note(tmp_path / "out.exr", "jaxblur:inputs")
    small = {name: plane[:4] for name, plane in ids(("/hero", "/set/ground")).items()}
    write_single(mattes, small, **crypto_notes())
    options = ("--scale-motion", "crypto:/hero=0", "--matte-from", mattes)
    error = refused("blur", path, "-o", tmp_path / "x.exr", *BLUR, *options)
    assert "the matte of --scale-motion crypto:/hero=0 has the pixels 36x4 at (0, 0)" in error


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--scale-motion", "crypto:/herro=0"), "did you mean /hero?"),
        (("--scale-motion", "krypto:/hero=0"), "did you mean crypto?"),
        (("--scale-motion", "crypto:/hero"), "expected 0.5, crypto:NAME=0.5"),
        (("--scale-motion", "crypto:/hero=-1"), "a factor from 0"),
        (("--scale-motion", "id:Z=1"), "expected id:CHANNEL:VALUE=FACTOR"),
        (("--scale-motion", "map:Z=1"), "expected map:CHANNEL"),
        (("--scale-motion", "matte:velocity.x=1"), "no channel velocity.x (did you mean velocity"),
        (("--matte-from", "x.exr"), "--matte-from: is for --scale-motion"),
        (("--camera", "fit"), "--camera: is for --camera-motion"),
        (("--camera", "fitt", "--objects-only"), "did you mean fit?"),
        (("--camera", "no.json", "--objects-only"), "no.json: no such file; give a JSON file"),
        (("--camera-motion", "1", "--objects-only"), "not allowed with"),
        (("--limit-motion", "valf"), "did you mean valve?"),
        (("--objects-only", "--subframes", "s.####.exr"), "--objects-only: with --subframes"),
        (
            ("--objects-only", "--camera", "header"),
            "take --camera fit, which finds it from the vectors",
        ),
    ],
)
def test_refusals(tmp_path, options, words):
    path = write_crypto(tmp_path / "a.0001.exr")
    error = refused("blur", path, "-o", tmp_path / "x.exr", *BLUR, *options)
    assert words in error
    assert not (tmp_path / "x.exr").exists()


def test_limits(tmp_path):
    path = write_single(tmp_path / "a.exr", frame((20.0, 0.0)))
    # 4 % of 36 pixels is 1.44 from end to end: 1/5 of that of 0.36 frames.
    image = blurred(path, "--limit-motion", "20%", "--shutter", "0.5")
    np.testing.assert_allclose(image, blurred(path, "--shutter", "0.36"), atol=1e-5)
    np.testing.assert_allclose(image, blurred(path, "--limit-motion", "7.2px"), atol=1e-5)
    image = blurred(path, "--limit-motion", "valve")
    assert note(tmp_path / "out.exr") == "limited valve"
    np.testing.assert_allclose(image, blurred(path, "--shutter", "0.072"), atol=1e-5)


def test_a_sequence_is_made_again_if_the_strength_changes(tmp_path):
    for number in (10, 11, 12):
        write_crypto(tmp_path / f"a.{number:04d}.exr", seed=number)
    names = tmp_path / "a.####.exr", "-o", tmp_path / "o.####.exr"
    hero = ("--scale-motion", "crypto:/hero=0")
    outcome = run("blur", *names, *BLUR, *hero)
    assert outcome.status == 0 and "3 written" in outcome.out
    assert "3 kept" in run("blur", *names, *BLUR, *hero).out
    error = refused("blur", *names, *BLUR, "--scale-motion", "crypto:/hero=0.5")
    assert "made with other parameters" in error
    image = exr.read_image(tmp_path / "o.0011.exr")
    np.testing.assert_array_equal(image[HERO], exr.read_image(tmp_path / "a.0011.exr")[HERO])
    assert note(tmp_path / "o.0011.exr") == "scaled crypto:/hero=0"


@pytest.mark.slow
def test_workers_know_the_strength(tmp_path):
    for number in (10, 11):
        write_crypto(tmp_path / f"a.{number:04d}.exr", seed=number)
    names = tmp_path / "a.####.exr", "-o", tmp_path / "o.####.exr"
    options = ("--scheduler", "local", "--workers", "1", "--scale-motion", "crypto:/hero=0")
    outcome = run("blur", *names, *BLUR, *options)
    assert outcome.status == 0, outcome.err
    image = exr.read_image(tmp_path / "o.0011.exr")
    np.testing.assert_array_equal(image[HERO], exr.read_image(tmp_path / "a.0011.exr")[HERO])
