"""Frames with a hero before a ground, and their blur: for tests of strength, passes and mattes."""

import json

import numpy as np

from jaxblur import exr
from tests.command_line import run
from tests.exr_files import plain_frame, write_single

SIZE = (24, 36)

HERO = np.zeros(SIZE, bool)
HERO[6:16, 8:22] = True

# No noise, and no neighbors: a pixel that rests is returned bit for bit.
BLUR = ("--preset", "jaxblur", "--filter", "pixel_velocity", "--noise", "none")


def frame(velocity=(6.0, 0.0), seed=0):
    """Color, depth and one velocity in pixels per frame, or one for each pixel."""
    channels = plain_frame(SIZE, seed)
    vectors = np.broadcast_to(np.asarray(velocity, np.float32), (*SIZE, 2))
    channels["velocity.X"], channels["velocity.Y"] = vectors[..., 0].copy(), vectors[..., 1].copy()
    channels["Z"] = np.where(HERO, 4, 9).astype(np.float32)
    return channels


def ids(names):
    """Channels of a Cryptomatte of two ranks: hero covers 3/4 of its pixels, ground the rest."""
    hero, ground = (np.array(exr.identifier_of(name), np.uint32).view(np.float32) for name in names)
    share = np.where(HERO, 0.75, 0).astype(np.float32)
    planes = {
        "00.R": np.where(HERO, hero, ground),
        "00.G": np.where(HERO, share, 1),
        "00.B": np.where(HERO, ground, 0),
        "00.A": np.where(HERO, 1 - share, 0),
    }
    return {f"CryptoObject{end}": plane.astype(np.float32) for end, plane in planes.items()}


def crypto_notes(listed=("/hero", "/set/ground"), **changes):
    notes = {
        "name": "CryptoObject",
        "hash": "MurmurHash3_32",
        "conversion": "uint32_to_float32",
        "manifest": json.dumps({name: f"{exr.identifier_of(name):08x}" for name in listed}),
    } | changes
    return {f"cryptomatte/a1b2c3d/{key}": value for key, value in notes.items()}


def write_crypto(path, names=("/hero", "/set/ground"), notes=None, **changes):
    channels = frame(**changes) | ids(names)
    return write_single(path, channels, **(crypto_notes() if notes is None else notes))


def blurred(source, *options, output=None):
    output = output or source.parent / "out.exr"
    outcome = run("blur", source, "-o", output, "--overwrite", *BLUR, *options)
    assert outcome.status == 0, outcome.err
    return exr.read_image(output)


def note(path, name="jaxblur:motion"):
    return str(exr.inspect(path).parts[0].attributes.get(name))
