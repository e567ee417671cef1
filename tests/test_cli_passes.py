"""Further color passes on the command line: ``--also`` and ``--all-color``."""

import numpy as np
import pytest

from jaxblur import exr
from tests.command_line import refused, run
from tests.exr_files import make_spec, read_stored, write_parts, write_single
from tests.hero_files import BLUR, HERO, SIZE, blurred, crypto_notes, frame, ids, note


def write_passes(path, seed=0, letters="RGB"):
    """A beauty that is the sum of three passes, and layers of data."""
    generator = np.random.default_rng(seed)
    row, column = np.mgrid[: SIZE[0], : SIZE[1]]
    velocity = np.where(HERO[..., None], (9.0, 2.0), (-3.0, 0.0))
    channels = {k: v for k, v in frame(velocity).items() if k not in "RGB"}
    checks = np.where(HERO, 1.0, 0.2) * (1 + (row // 3 + column // 3) % 2)
    for name in ("diffuse", "specular", "emission"):
        for letter in letters:
            values = generator.random(SIZE) * 0.3 + checks * generator.random()
            channels[f"{name}.{letter}"] = values.astype(np.float32)
    for letter in letters:
        parts = [channels[f"{name}.{letter}"] for name in ("diffuse", "specular", "emission")]
        channels[letter] = np.sum(parts, axis=0, dtype=np.float32)
    for letter in "RGB":
        channels[f"N.{letter}"] = generator.random(SIZE).astype(np.float32)
    channels["A"] = np.where(HERO, 1, 0.5).astype(np.float32)
    channels |= ids(("/hero", "/set/ground"))
    channels = dict(sorted(channels.items()))
    return write_single(path, channels, **crypto_notes()), channels


def sum_of_passes(path, letters):
    return sum(
        exr.read_channels(path, [f"{name}.{letter}" for letter in letters])
        for name in ("diffuse", "specular", "emission")
    )


@pytest.mark.parametrize(
    ("filter", "letters", "option"),
    [
        ("guertin2014", "Y", ("--also", "diffuse,SPEC*,emission")),
        # Compiles native code for thirteen channels.
        pytest.param("layered", "RGB", ("--all-color",), marks=pytest.mark.slow),
    ],
)
def test_passes_add_up_to_the_beauty(tmp_path, filter, letters, option):
    path, channels = write_passes(tmp_path / "a.exr", letters=letters)
    alone, together = tmp_path / "alone.exr", tmp_path / "together.exr"
    options = ("--preset", "jaxblur", "--filter", filter, "--shutter", "1")
    outcome = run("blur", path, "-o", alone, *options)
    assert outcome.status == 0 and outcome.err.count("stay sharp: ") == 1
    assert "stay sharp: diffuse, emission, specular; --also blurs them too" in outcome.err
    outcome = run("blur", path, "-o", together, *options, *option, "--png")
    assert outcome.status == 0 and "stay sharp" not in outcome.err, outcome.err
    beauty = exr.read_channels(together, [*letters, "A"])
    # The picture is what it is without the passes.
    np.testing.assert_allclose(beauty, exr.read_channels(alone, [*letters, "A"]), atol=1e-6)
    np.testing.assert_allclose(sum_of_passes(together, letters), beauty[..., :-1], atol=1e-5)
    for name in ("diffuse", "specular"):
        channel = f"{name}.{letters[0]}"
        changed = read_stored(together, channel, "float") != channels[channel]
        assert changed.mean() > 0.9
    for name in ("N.R", "CryptoObject00.R", "Z"):
        np.testing.assert_array_equal(read_stored(together, name, "float"), channels[name])
    recorded = note(together, "jaxblur:blurred").split(", ")
    assert f"diffuse.{letters[0]}" in recorded and "N.R" not in recorded
    warned = run("blur", together, "-o", alone, "--overwrite", *options, *option).err
    assert "this blurs it again" in warned


def test_a_pass_that_is_not_named_is_copied(tmp_path):
    path, channels = write_passes(tmp_path / "a.exr")
    blurred(path, "--also", "diffuse")
    output = tmp_path / "out.exr"
    assert (read_stored(output, "diffuse.R", "float") != channels["diffuse.R"]).any()
    stored = read_stored(output, "specular.R", "float")
    np.testing.assert_array_equal(stored, channels["specular.R"])
    blurred(path, "--also", "diffuse", "--drop-extra")
    names = exr.inspect(output).channel_names
    assert sorted(names) == sorted(["R", "G", "B", "A", *(f"diffuse.{x}" for x in "RGB")])


def test_passes_in_parts(tmp_path):
    _, channels = write_passes(tmp_path / "a.exr")
    groups = {"rgba": ("R", "G", "B", "A", "Z", "velocity.X", "velocity.Y")}
    groups |= {name: tuple(f"{name}.{x}" for x in "RGB") for name in ("diffuse", "specular")}
    parts = []
    for name, members in groups.items():
        planes = {member.removeprefix(f"{name}."): channels[member] for member in members}
        parts.append((make_spec(planes, name=name), planes))
    path = write_parts(tmp_path / "parts.exr", parts)
    output = tmp_path / "out.exr"
    options = ("--velocity-channels", "rgba.velocity.X,rgba.velocity.Y")
    options = (*options, "--depth-channel", "rgba.Z")
    blurred(path, "--also", "spec*", *options, output=output)
    old, new = (exr.read_channels(p, ["specular.R", "diffuse.R"]) for p in (path, output))
    assert (old[..., 0] != new[..., 0]).any() and (old[..., 1] == new[..., 1]).all()


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ("difuse", "did you mean diffuse?"),
        ("x*", "no other layer of color 'x*'; the layers of color are diffuse, emission, specular"),
        (
            "foo",
            "no other layer of color 'foo'; the layers of color are diffuse, emission, specular",
        ),
        ("crypto*", "CryptoObject00 holds identifiers"),
        ("n*", "'n*' is a pattern, and patterns leave out data; give names"),
        ("CryptoObject00", "holds identifiers"),
    ],
)
def test_wrong_passes(tmp_path, option, words):
    path, _ = write_passes(tmp_path / "a.exr")
    assert words in refused("blur", path, "-o", tmp_path / "x.exr", *BLUR, "--also", option)


def test_a_frame_without_passes(tmp_path):
    path = write_single(tmp_path / "a.exr", frame())
    error = refused("blur", path, "-o", tmp_path / "x.exr", *BLUR, "--all-color")
    assert "no other layer of color than R, G, B" in error


@pytest.mark.slow
def test_passes_of_neighbors(tmp_path):
    (path, _), (before, _) = (write_passes(tmp_path / f"{n}.exr", n, "Y") for n in (11, 10))
    output = tmp_path / "out.exr"
    options = ("--preset", "jaxblur", "--shutter", "1", "--before", before)
    outcome = run("blur", path, "-o", output, *options, "--all-color")
    assert outcome.status == 0, outcome.err
    assert note(output, "jaxblur:neighbors") == "before 10.exr"
    beauty = exr.read_channels(output, ["Y"])
    np.testing.assert_allclose(sum_of_passes(output, "Y"), beauty, atol=1e-5)
    fewer = {
        k: v for k, v in write_passes(before, 10, "Y")[1].items() if not k.startswith("emission")
    }
    write_single(before, fewer)
    outcome = refused("blur", path, "-o", output, "--overwrite", *options, "--all-color")
    assert "has other color passes" in outcome
