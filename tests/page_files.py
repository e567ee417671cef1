"""The files that the commands on the pages speak of, small: a folder in which each page can run."""

import json
import shutil
from pathlib import Path

import numpy as np

from jaxblur import exr
from tests.exr_files import CUBE, CUBE_NEXT, DATA, make_spec, read_raw, write_parts, write_single
from tests.hero_files import crypto_notes
from tests.test_cli_layers import back_at, channels_of, front_at
from tests.test_exr_deep import DISCS, SIZE, disc, write_deep
from tests.test_perception import write_votes

PART = np.s_[16 : 16 + SIZE[0], : SIZE[1]]
"""Where the rows of tests/data are cut; the cube passes in front of the wall there."""

HERO = 7
"""Object index of the cube."""


def write_folder(folder: Path) -> Path:
    """Write all files into an empty folder; frame numbers are those of the pages."""
    for name in ("render", "nuke", "arnold", "shots/a", "out", "blurred", "stills", "tests/data"):
        (folder / name).mkdir(parents=True)
    _write_frames(folder)
    _write_other_renderers(folder)
    _write_layers(folder)
    _write_shots(folder)
    for number, order in enumerate(("cab", "acb", "cab")):
        write_votes(folder / f"votes_{number}.csv", f"observer {number}", order)
    return folder


def stored(path):
    """The channels of all parts of a frame of tests/data, cut to `PART`."""
    found = {}
    for part, _ in enumerate(exr.inspect(path).parts):
        spec, pixels = read_raw(path, part, "float")
        assert pixels is not None
        for index, name in enumerate(spec.channelnames):
            found[name] = np.ascontiguousarray(pixels[PART][..., index])
    return found


def beauty(path):
    """A frame of Blender with identifiers, a Cryptomatte and another color pass."""
    channels = stored(path)
    index = channels["ViewLayer.Object Index.X"]
    hero, ground = (
        np.array(exr.identifier_of(name), np.uint32).view(np.float32)
        for name in ("/hero", "/set/ground")
    )
    zero = np.zeros(SIZE, np.float32)
    ranks = {"R": np.where(index == HERO, hero, ground), "G": zero + 1, "B": zero, "A": zero}
    channels |= {f"CryptoObject00.{end}": np.float32(plane) for end, plane in ranks.items()}
    channels |= {f"diffuse.{c}": channels[f"ViewLayer.Combined.{c}"] / 2 for c in "RGB"}
    channels["ViewLayer.Object Index.X"] = np.where(index == HERO, np.float32(3), index)
    return channels


def _write_frames(folder):
    """Blender's frames under every name that the pages give them, and their truth."""
    now, after = beauty(CUBE), beauty(CUBE_NEXT)
    notes = crypto_notes()
    for name in ("beauty", "beauty.0010", "beauty.0011", "aliased.0001", "sub.0001"):
        write_single(folder / f"{name}.exr", now, **notes)
    for name in ("render/shot_0001", "shots/a/beauty.1001"):
        write_single(folder / f"{name}.exr", now, **notes)
    for name in ("beauty.0012", "aliased.0002", "sub.0002"):
        write_single(folder / f"{name}.exr", after, **notes)
    for name in ("render/shot_0002", "shots/a/beauty.1002"):
        write_single(folder / f"{name}.exr", after, **notes)
    for name in ("truth", "truth.0001", "truth.0002", "blurred.0001", "blurred.0002"):
        write_single(folder / f"{name}.exr", _truth("cube_over_crates"))
    camera = {"camera_to_world": np.eye(4).tolist(), "field_of_view": 40.0}
    frames = {str(number): camera for number in (10, 11, 12)}
    (folder / "shot.json").write_text(json.dumps({"frames": frames}))
    # A folder of pictures for each of three methods.
    for method, gain in (("none", 0.5), ("some", 0.8), ("all", 1.0)):
        (folder / "DIR" / method).mkdir(parents=True)
        colors = np.stack([now[f"ViewLayer.Combined.{c}"] for c in "RGB"], axis=-1)
        exr.write_image(folder / "DIR" / method / "still.png", np.clip(gain * colors, 0, 1))


def _truth(scene):
    return stored(DATA / f"{scene}_truth_0011.exr")


def _write_other_renderers(folder):
    """The same frames in the channels of Nuke and Arnold."""
    for number, path in enumerate((CUBE, CUBE_NEXT), 1):
        found = stored(path)
        colors = {name: found[f"ViewLayer.Combined.{name}"] for name in "RGBA"}
        x, y, next_x, next_y = (found[f"ViewLayer.Vector.{axis}"] for axis in "XYZW")
        depth = found["ViewLayer.Depth.Z"]
        nuke = {"forward.u": -next_x, "forward.v": -next_y, "backward.u": x, "backward.v": y}
        write_single(
            folder / f"nuke/precomp.{number:04d}.exr", colors | nuke | {"depth.Z": 1 / depth}
        )
        arnold = {"motionvector.X": -next_x / 2, "motionvector.Y": -next_y / 2, "Z": depth}
        write_single(folder / f"arnold/beauty.{number:04d}.exr", colors | arnold)


def _write_layers(folder):
    """A disc before stripes: as files, as parts of one, as a sequence, and deep."""
    front, back = front_at(0), back_at(0)
    opaque = {"A": np.ones(SIZE, np.float32)}
    write_single(folder / "hero.exr", front)
    write_single(folder / "street.exr", back | opaque)
    parts = [(make_spec(front, name="hero"), front)]
    parts += [(make_spec(back | opaque, name="street"), back | opaque)]
    write_parts(folder / "shot.exr", parts)
    for number in (1, 2):
        write_single(folder / f"hero.{number:04d}.exr", front_at(number))
        write_single(folder / f"street.{number:04d}.exr", back_at(number) | opaque)
    write_single(folder / "plate.exr", {name: back[name] for name in "RGB"})
    write_deep(folder / "smoke_deep.exr", [disc(*parts) for parts in DISCS])
    assert set(channels_of(disc(*DISCS[0])[1])) == set(front)


def _write_shots(folder):
    """Three scenes with their truth, and what stands in tests/data, cut likewise."""
    for scene in ("cube_over_crates", "falling_cubes", "sky_car"):
        (folder / "shots" / scene).mkdir()
        sharp = stored(DATA / f"{scene}_frame_0011.exr")
        for path in (
            folder / "shots" / scene / "frame_0011.exr",
            folder / "tests" / "data" / f"{scene}_frame_0011.exr",
        ):
            write_single(path, sharp)
        for path in (
            folder / "shots" / scene / "truth_0011.exr",
            folder / "tests" / "data" / f"{scene}_truth_0011.exr",
        ):
            write_single(path, _truth(scene))
    write_single(folder / "tests" / "data" / "cube_over_crates_frame_0012.exr", stored(CUBE_NEXT))
    for number in (1, 2, 3, 4):
        shutil.copy(folder / "beauty.exr", folder / f"sub.{number}.exr")
