"""``jaxblur blur --cryptomatte``: mattes cut from the result fit the blurred picture."""

import json

import numpy as np
import pytest

from jaxblur import exr
from tests.command_line import refused, run
from tests.exr_files import (
    make_spec,
    plain_frame,
    read_raw,
    read_stored,
    write_parts,
    write_single,
)

SIZE = (40, 64)
NAMES = ("/ground", "/hero", "/fence")
BLUR = ("--preset", "jaxblur", "--shutter", "1")
SIMPLE = (*BLUR, "--filter", "pixel_velocity", "--noise", "none")
LEVELS = 3


def mattes(shift=0):
    """A hero between a ground and a fence, whose uprights are half transparent."""
    hero = np.zeros(SIZE, np.float32)
    hero[10:30, 16 + shift : 36 + shift] = 1
    fence = np.zeros(SIZE, np.float32)
    fence[4:36, ::8] = 0.5
    hero *= 1 - fence
    return {"/ground": 1 - hero - fence, "/hero": hero, "/fence": fence}


def ranks(of, layer="CryptoObject", levels=LEVELS):
    """Channels of a Cryptomatte, in the order of coverage."""
    names, shares = list(of), np.stack(list(of.values()))
    order = np.argsort(-shares, axis=0, kind="stable")
    bits = np.array([exr.identifier_of(name) for name in names], np.uint32).view(np.float32)
    channels = {}
    for rank in range(2 * levels):
        thing, share = np.zeros(SIZE, np.float32), np.zeros(SIZE, np.float32)
        if rank < len(names):
            share = np.take_along_axis(shares, order[rank : rank + 1], axis=0)[0]
            thing = np.where(share > 0, bits[order[rank]], 0).astype(np.float32)
        first, second = ("RG", "BA")[rank % 2]
        channels[f"{layer}{rank // 2:02d}.{first}"] = thing
        channels[f"{layer}{rank // 2:02d}.{second}"] = share
    return channels


def notes(layer="CryptoObject", key="a1b2c3d", names=NAMES):
    entries = {
        "name": layer,
        "hash": "MurmurHash3_32",
        "conversion": "uint32_to_float32",
        "manifest": json.dumps({name: f"{exr.identifier_of(name):08x}" for name in names}),
    }
    return {f"cryptomatte/{key}/{name}": value for name, value in entries.items()}


def write(path, shift=0, seed=0, layers=("CryptoObject",), **more):
    """A hero that moves over a ground at rest; a binary matte of it as a color pass."""
    of = mattes(shift)
    channels = plain_frame(SIZE, seed)
    moves = of["/hero"] > 0
    channels["velocity.X"] = np.where(moves, 9, 0).astype(np.float32)
    channels["velocity.Y"] = np.zeros(SIZE, np.float32)
    channels["Z"] = np.where(moves, 4, 9).astype(np.float32)
    for name in NAMES:
        channels[f"pass_{name[1:]}.Y"] = of[name]
    header = {}
    for number, layer in enumerate(layers):
        channels |= ranks(of, layer)
        header |= notes(layer, f"a1b2c3{number}")
    types = ["half" if name in "RGB" else "float" for name in channels]
    return write_single(path, channels, types, **header, **more), channels


def blur(path, output, *options):
    outcome = run("blur", path, "-o", output, "--overwrite", *options)
    assert outcome.status == 0, outcome.err
    return outcome


def stored(path, layer="CryptoObject"):
    names = [f"{layer}{level:02d}.{c}" for level in range(LEVELS) for c in "RGBA"]
    return exr.read_channels(path, names)


def check_against_passes(source, output):
    """Mattes by name equal the blurred binary mattes; coverages are in order."""
    blurred = exr.read_channels(output, [f"pass_{name[1:]}.Y" for name in NAMES])
    for index, name in enumerate(NAMES):
        np.testing.assert_allclose(
            exr.read_cryptomatte(output, name), blurred[..., index], atol=1e-3
        )
    old, new = stored(source), stored(output)
    identifiers = new[..., ::2].view(np.uint32)
    known = {0, *(exr.identifier_of(name) for name in NAMES)}
    assert set(np.unique(identifiers).tolist()) <= known
    assert new[..., 1::2].sum(axis=-1).max() <= 1 + 1e-6
    assert (np.diff(new[..., 1::2], axis=-1) <= 0).all()
    same = (old.view(np.uint32) == new.view(np.uint32)).all(axis=-1)
    assert 0.3 < same.mean() < 0.9
    before, after = (exr.read_channels(p, ["R", "G", "B"]) for p in (source, output))
    rests = (before == after).all(axis=-1)
    assert same[rests].all(), "pixels that rest keep their ranks bit for bit"


@pytest.mark.parametrize(
    "options",
    [SIMPLE, pytest.param(BLUR, marks=pytest.mark.slow), (*BLUR, "--filter", "guertin2014")],
    ids=["simple", "layered", "guertin2014"],
)
def test_mattes_equal_the_blurred_binary_mattes(tmp_path, options):
    source, channels = write(tmp_path / "a.exr")
    output = tmp_path / "out.exr"
    outcome = blur(source, output, *options, "--cryptomatte", "--also", "pass_*")
    assert "stays sharp" not in outcome.err and "Cryptomattes: CryptoObject" in outcome.err
    check_against_passes(source, output)
    np.testing.assert_array_equal(read_stored(output, "Z", "float"), channels["Z"])
    assert exr.cryptomatte_layers(output)[0].manifest.keys() == set(NAMES)
    recorded = exr.inspect(output).parts[0].attributes["jaxblur:blurred"]
    assert "CryptoObject02.B" in recorded
    assert "this blurs it again" in blur(output, tmp_path / "2.exr", *options, "--cryptomatte").err


def test_all_layers_are_blurred(tmp_path):
    layers = ("CryptoObject", "CryptoMaterial", "CryptoAsset")
    source, _ = write(tmp_path / "a.exr", layers=layers)
    output = tmp_path / "out.exr"
    blur(source, output, *SIMPLE, "--cryptomatte")
    for layer in layers:
        np.testing.assert_array_equal(stored(output, layer), stored(output))
    assert (stored(output) != stored(source)).any()


def test_a_layer_in_a_part_of_its_own(tmp_path):
    _, channels = write(tmp_path / "a.exr")
    crypto = {k: v for k, v in channels.items() if k.startswith("Crypto")}
    others = {k: v for k, v in channels.items() if k not in crypto}
    parts = [
        (make_spec(others, name="rgba"), others),
        (make_spec(crypto, name="crypto", **notes()), crypto),
    ]
    source, output = write_parts(tmp_path / "parts.exr", parts), tmp_path / "out.exr"
    where = ("--velocity-channels", "rgba.velocity.X,rgba.velocity.Y", "--depth-channel", "rgba.Z")
    blur(source, output, *SIMPLE, *where, "--cryptomatte")
    alone = tmp_path / "alone.exr"
    blur(tmp_path / "a.exr", alone, *SIMPLE, "--cryptomatte")
    _, pixels = read_raw(output, 1)
    np.testing.assert_array_equal(pixels, stored(alone))
    # Without the other channels the ranks go with the picture.
    blur(source, output, *SIMPLE, *where, "--cryptomatte", "--drop-extra")
    assert len(exr.inspect(output).channels) == 3 + 4 * LEVELS
    np.testing.assert_array_equal(read_raw(output, 1)[1], stored(alone))


def test_without_the_option_ranks_stay_with_a_warning(tmp_path):
    source, _ = write(tmp_path / "a.exr")
    output = tmp_path / "out.exr"
    outcome = blur(source, output, *SIMPLE)
    assert "CryptoObject stays sharp and does not fit the blurred picture" in outcome.err
    np.testing.assert_array_equal(stored(output), stored(source))
    for option in ("--no-cryptomatte", "--drop-extra"):
        assert "stays sharp" not in blur(source, output, *SIMPLE, option).err


def test_refusals(tmp_path):
    source, channels = write(tmp_path / "a.exr")
    png = refused("blur", source, "-o", tmp_path / "a.png", *SIMPLE, "--cryptomatte")
    assert "a.png cannot hold Cryptomattes" in png
    plain = write_single(tmp_path / "b.exr", plain_frame(SIZE))
    error = refused("blur", plain, "-o", tmp_path / "o.exr", *SIMPLE, "--cryptomatte")
    assert "no Cryptomatte of this picture" in error
    half = write_single(tmp_path / "c.exr", channels, "half", **notes())
    error = refused("blur", half, "-o", tmp_path / "o.exr", *SIMPLE, "--cryptomatte")
    assert "half cannot hold the identifiers" in error


def test_an_identifier_that_a_pixel_has_twice_counts_once(tmp_path):
    """Some renderers split a thing into several ranks."""
    _, channels = write(tmp_path / "a.exr")
    hero, share = channels["CryptoObject00.R"], channels["CryptoObject00.G"] / 2
    split = channels | {"CryptoObject00.G": share, "CryptoObject02.R": hero}
    split["CryptoObject02.G"] = share
    source, output = write_single(tmp_path / "b.exr", split, **notes()), tmp_path / "out.exr"
    blur(source, output, *SIMPLE, "--cryptomatte", "--also", "pass_hero")
    blurred = exr.read_channels(output, ["pass_hero.Y"])[..., 0]
    np.testing.assert_allclose(exr.read_cryptomatte(output, "/hero"), blurred, atol=1e-3)


@pytest.mark.slow
def test_another_shutter_blurs_the_ranks_alike(tmp_path):
    source, _ = write(tmp_path / "a.exr")
    output = tmp_path / "out.exr"
    options = (*BLUR, "--shutter-position", "start", "--shutter-curve", "triangle")
    options = (*options, "--samples", "15", "--radius", "16")
    blur(source, output, *options, "--cryptomatte", "--also", "pass_*")
    check_against_passes(source, output)


def test_sub_frames_are_averaged(tmp_path):
    source, _ = write(tmp_path / "a.exr")
    for number in (1, 2):
        write(tmp_path / f"s.{number:04d}.exr", shift=6 * number - 9)
    output = tmp_path / "out.exr"
    options = (*SIMPLE, "--subframes", tmp_path / "s.####.exr", "--cryptomatte")
    blur(source, output, *options, "--also", "pass_*")
    blurred = exr.read_channels(output, ["pass_hero.Y"])[..., 0]
    np.testing.assert_allclose(exr.read_cryptomatte(output, "/hero"), blurred, atol=1e-3)


@pytest.mark.slow
def test_a_sequence_with_neighbors(tmp_path):
    for number in (1, 2, 3):
        write(tmp_path / f"a.{number:04d}.exr", shift=9 * number - 18)
    names = (tmp_path / "a.####.exr", "-o", tmp_path / "o.####.exr")
    options = (*BLUR, "--samples", "15", "--radius", "16", "--also", "pass_*")
    outcome = run("blur", *names, *options, "--cryptomatte")
    assert outcome.status == 0, outcome.err
    for number in (1, 2, 3):
        check_against_passes(*(tmp_path / f"{x}.{number:04d}.exr" for x in "ao"))
    noted = exr.inspect(tmp_path / "o.0002.exr").parts[0].attributes
    assert noted["jaxblur:neighbors"] == "before a.0001.exr, after a.0003.exr"


def test_a_sequence_is_made_again_with_the_option(tmp_path):
    for number in (1, 2):
        write(tmp_path / f"a.{number:04d}.exr")
    names = (tmp_path / "a.####.exr", "-o", tmp_path / "o.####.exr")
    outcome = run("blur", *names, *SIMPLE)
    assert outcome.err.count("stays sharp") == 1
    assert "2 kept" in run("blur", *names, *SIMPLE, "--no-cryptomatte").out
    assert "other parameters" in refused("blur", *names, *SIMPLE, "--cryptomatte")
    outcome = run("blur", *names, *SIMPLE, "--cryptomatte", "--cut", "2", "--overwrite")
    assert outcome.status == 0 and "2 written" in outcome.out
    first, second = (stored(tmp_path / f"o.000{n}.exr") for n in (1, 2))
    sharp = stored(tmp_path / "a.0002.exr")
    assert (first != sharp).any() and (second == sharp).all()
    assert "2 kept" in run("blur", *names, *SIMPLE, "--cryptomatte", "--cut", "2").out


def test_info_lists_names_and_identifiers(tmp_path):
    names = [f"/set/thing{number:02d}" for number in range(30)]
    source, channels = write(tmp_path / "a.exr")
    many = write_single(tmp_path / "b.exr", channels, **notes(names=names))
    hero = f"{exr.identifier_of('/hero'):08x}"
    out = run("info", source).out
    assert "Cryptomatte CryptoObject: 6 ranks, manifest of 3 names" in out
    assert ["/hero", hero] in [line.split() for line in out.splitlines()]
    out = run("info", many).out
    assert "/set/thing19" in out and "/set/thing20" not in out and "and 10 more; -v" in out
    assert "/set/thing29" in run("info", many, "-v").out
    unlisted = {key: value for key, value in notes().items() if "manifest" not in key}
    bare = write_single(tmp_path / "c.exr", channels, **unlisted)
    assert f"<{hero}>" in run("info", bare).out
    listing = json.loads(run("info", bare, "--json").out)["cryptomatte"]
    assert set(listing[0]["identifiers"].values()) == {
        f"{exr.identifier_of(name):08x}" for name in NAMES
    }
    broken = {key.replace("manifest", "manif_file"): value for key, value in notes().items()}
    damaged = write_single(tmp_path / "d.exr", channels, **broken)
    outcome = run("info", damaged)
    assert outcome.status == 0 and "Cryptomatte: damaged (" in outcome.out
