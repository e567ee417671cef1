"""Strength on the command line: mattes, Cryptomatte, cameras, limits; and further color passes."""

import json
import math

import numpy as np
import OpenImageIO as oiio
import pytest
from scipy.spatial.transform import Rotation

from jaxblur import exr
from jaxblur.exr.header import relabel_as_uint
from tests.command_line import refused, run
from tests.exr_files import make_spec, plain_frame, read_raw, read_stored, write_parts, write_single

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


# Cryptomatte.


def test_a_matte_is_read_by_name(tmp_path):
    path = write_crypto(tmp_path / "a.exr")
    np.testing.assert_array_equal(exr.read_cryptomatte(path, "/hero"), np.where(HERO, 0.75, 0))
    ground = exr.read_cryptomatte(path, "/set/*")
    np.testing.assert_array_equal(ground, np.where(HERO, 0.25, 1))
    np.testing.assert_array_equal(exr.read_cryptomatte(path, "CryptoObject:/hero") > 0, HERO)
    (layer,) = exr.cryptomatte_layers(path)
    assert layer.name == "CryptoObject" and list(layer.manifest) == ["/hero", "/set/ground"]


def test_without_a_manifest_the_name_is_hashed(tmp_path):
    notes = {key: value for key, value in crypto_notes().items() if "manifest" not in key}
    for index, given in enumerate((notes, {})):
        path = write_crypto(tmp_path / f"{index}.exr", notes=given)
        np.testing.assert_array_equal(exr.read_cryptomatte(path, "/hero") > 0, HERO)
        with pytest.raises(exr.JaxblurIOError, match="no pixel of CryptoObject is of '/villain'"):
            exr.read_cryptomatte(path, "/villain")


def test_a_manifest_may_be_a_file_beside(tmp_path):
    notes = crypto_notes(manif_file="names.json")
    manifest = notes.pop("cryptomatte/a1b2c3d/manifest")
    path = write_crypto(tmp_path / "a.exr", notes=notes)
    with pytest.raises(exr.JaxblurIOError, match=r"names\.json cannot be read"):
        exr.read_cryptomatte(path, "/hero")
    (tmp_path / "names.json").write_text(manifest)
    assert exr.read_cryptomatte(path, "/hero").max() == 0.75


def test_a_thing_outside_the_frame_covers_nothing(tmp_path):
    path = write_crypto(tmp_path / "a.exr", notes=crypto_notes(("/hero", "/away")))
    assert not exr.read_cryptomatte(path, "/away").any()


@pytest.mark.parametrize(
    ("name", "notes", "match"),
    [
        ("/herro", {}, r"no '/herro' in Cryptomatte CryptoObject \(did you mean /hero\?\)"),
        ("/hero", {"hash": "MD5"}, "hash MD5 with uint32_to_float32 is not known"),
        ("/hero", {"name": "Other"}, r"there are no channels Other00\.R"),
        ("/hero", {"manifest": "{"}, "damaged manifest"),
        ("/hero", {"manifest": '{"/hero": "123456789"}'}, "more than 32 bits"),
        ("/hero", {"manifest": '{"/hero": 1}'}, "damaged manifest"),
    ],
)
def test_wrong_cryptomattes(tmp_path, name, notes, match):
    path = write_crypto(tmp_path / "a.exr", notes=crypto_notes(**notes))
    with pytest.raises(exr.JaxblurIOError, match=match):
        exr.read_cryptomatte(path, name)


def test_identifiers_in_half_are_rejected(tmp_path):
    channels = frame() | ids(("/hero", "/set/ground"))
    types = ["half" if "Crypto" in name else "float" for name in channels]
    path = write_single(tmp_path / "a.exr", channels, types, **crypto_notes())
    with pytest.raises(exr.JaxblurIOError, match="half cannot hold the identifiers"):
        exr.read_cryptomatte(path, "/hero")
    with pytest.raises(exr.JaxblurIOError, match="no Cryptomatte; render with it"):
        exr.read_cryptomatte(write_single(tmp_path / "b.exr", frame()), "/hero")


def test_layers_that_share_a_name_are_told_apart(tmp_path):
    material = {name.replace("Object", "Material"): v for name, v in ids(("/hero", "b")).items()}
    notes = crypto_notes() | {
        key.replace("a1b2c3d", "0000001"): value.replace("Object", "Material")
        for key, value in crypto_notes().items()
    }
    channels = frame() | ids(("/hero", "/set/ground")) | material
    path = write_single(tmp_path / "a.exr", channels, **notes)
    with pytest.raises(exr.JaxblurIOError, match="write CryptoMaterial:/hero or CryptoObject:"):
        exr.read_cryptomatte(path, "/hero")
    assert exr.read_cryptomatte(path, "CryptoMaterial:/hero").max() == 0.75


# Scales.


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
    assert "m.exr has 36x4 pixels" in error


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
        (("--camera", "no.json", "--objects-only"), "cannot be read as JSON"),
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


# Cameras.

TURN, WAY = np.array([0.02, 0.06, 0.01]), np.array([0.1, 0.02, -0.1])
FOCAL = 40.0
Y_UP = np.diag([1.0, -1.0, -1.0, 1.0])
BIG = (60, 90)


def camera_to_world(number):
    """A camera that turns and goes at a constant rate, in a world of its own; y up, along -z."""
    start = np.eye(4)
    start[:3, :3] = Rotation.from_rotvec([0.4, -1.0, 0.2]).as_matrix()
    start[:3, 3] = 30.0, -7.0, 12.0
    step = np.eye(4)
    step[:3, :3] = Rotation.from_rotvec((number - 11) * TURN).as_matrix()
    step[:3, 3] = (number - 11) * WAY
    return start @ step @ Y_UP


def shot(path, number=11, speed=(4.0, 3.0), **notes):
    """A frame of a static world with a block that moves, its vectors exact to both sides."""
    depth = np.linspace(6, 20, BIG[0])[:, None] + np.zeros(BIG)
    block = np.zeros(BIG, bool)
    block[20:40, 30:50] = True
    depth[block] = 5.0
    row, column = np.mgrid[: BIG[0], : BIG[1]] + 0.5
    ray = np.stack([(column - BIG[1] / 2) / FOCAL, (row - BIG[0] / 2) / FOCAL, np.ones(BIG)], -1)
    channels = plain_frame(BIG)
    del channels["velocity.X"], channels["velocity.Y"]
    channels["Z"] = depth.astype(np.float32)
    for side, name in ((-1, "previous"), (1, "next")):
        points = (depth[..., None] * ray - side * WAY) @ Rotation.from_rotvec(
            side * TURN
        ).as_matrix()
        place = FOCAL * points[..., :2] / points[..., 2:] + (BIG[1] / 2, BIG[0] / 2)
        moved = place - np.stack([column, row], -1) + side * block[..., None] * np.array(speed)
        for index, axis in enumerate("XY"):
            channels[f"velocity.{name}.{axis}"] = moved[..., index].astype(np.float32)
    return write_single(path, channels, **notes), block


def camera_json(path, **changes):
    fov = math.degrees(2 * math.atan(BIG[1] / 2 / FOCAL))
    frames = {str(n): {"camera_to_world": camera_to_world(n).tolist()} for n in (10, 11, 12)}
    path.write_text(json.dumps({"field_of_view": fov, "frames": frames} | changes))
    return path


def header_notes(number, style):
    """Matrices as renderers write them: row vectors, other axes, other screens."""
    to_camera = np.linalg.inv(camera_to_world(number))
    half = np.array([FOCAL / (BIG[1] / 2), FOCAL / (BIG[0] / 2)])
    projection = np.zeros((4, 4))
    projection[2, 2], projection[3, 2] = -1.01, -1
    projection[0, 0], projection[1, 1] = half
    projection[2, 3] = -0.2
    if style == "arnold":
        # The camera looks along z.
        to_camera = np.diag([1.0, 1.0, -1.0, 1.0]) @ to_camera
        projection = projection @ np.diag([1.0, 1.0, -1.0, 1.0])
    if style == "renderman":
        screen = np.array([[0.5, 0, 0, 0.5], [0, -0.5, 0, 0.5], [0, 0, 1, 0], [0, 0, 0, 1.0]])
        projection = screen @ projection
    return to_camera, projection @ to_camera


def with_matrices(path, number, style):
    path, block = shot(path, number)
    spec, pixels = read_raw(path, kind="float")
    names = ("worldToCamera", "worldToNDC")
    for name, matrix in zip(names, header_notes(number, style), strict=True):
        values = tuple(matrix.T.ravel().astype(np.float32).tolist())
        spec.attribute(name, oiio.TypeDesc("matrix"), values)
    output = oiio.ImageOutput.create(str(path))
    assert output is not None and output.open(str(path), spec) and output.write_image(pixels)
    assert output.close()
    return path, block


def moves(before, after):
    return (before != after).any(axis=-1)


def check_objects_only(path, block, *options):
    before, plain = exr.read_image(path), blurred(path, "--shutter", "1")
    assert moves(before, plain).mean() > 0.95
    image = blurred(path, "--shutter", "1", "--objects-only", *options)
    same = blurred(path, "--shutter", "1", "--camera-motion", "0", *options)
    np.testing.assert_array_equal(same, image)
    assert not moves(before, image)[~block].any()
    assert moves(before, image)[block].all()


@pytest.mark.parametrize("style", ["maya", "arnold", "renderman"])
def test_objects_only_by_matrices_of_the_header(tmp_path, style):
    for number in (10, 11, 12):
        path, block = with_matrices(tmp_path / f"a.{number:04d}.exr", number, style)
    path = tmp_path / "a.0011.exr"
    check_objects_only(path, block, "--camera", "header")
    assert note(tmp_path / "out.exr") == "objects only, camera of the headers"
    # At an end of the shot the camera is taken to go on.
    check_objects_only(tmp_path / "a.0010.exr", block)
    assert note(tmp_path / "out.exr") == "objects only, camera of the headers"


def test_objects_only_by_a_file_and_by_the_fit(tmp_path):
    path, block = shot(tmp_path / "a.0011.exr")
    cameras = camera_json(tmp_path / "cam.json")
    check_objects_only(path, block, "--camera", cameras)
    assert note(tmp_path / "out.exr") == "objects only, camera of cam.json"
    check_objects_only(path, block)
    assert note(tmp_path / "out.exr") == "objects only, camera fitted"


def alike(image, other):
    """Equal but for some reads of the nearest texel, which jump to the next one."""
    assert np.abs(image - other).mean() < 2e-3 < 0.05 < image.std()


def test_camera_only_and_shares(tmp_path):
    path, _ = shot(tmp_path / "a.0011.exr")
    still, _ = shot(tmp_path / "still.0011.exr", speed=(0, 0))
    by_file = ("--camera", camera_json(tmp_path / "cam.json"))
    options = ("--shutter", "1")
    camera = blurred(path, *options, "--camera-only", *by_file)
    alike(camera, blurred(still, *options))
    # 30 % of the camera's motion of a world at rest is 30 % of the exposure.
    share = blurred(still, *options, "--camera-motion", "30%", *by_file)
    alike(share, blurred(still, "--shutter", "0.3"))
    whole = blurred(path, *options, "--camera-motion", "1", *by_file)
    np.testing.assert_allclose(whole, blurred(path, *options), atol=1e-5)


def test_cameras_that_explain_nothing_are_reported(tmp_path):
    path, _ = shot(tmp_path / "a.0011.exr")
    fine, wrong = camera_json(tmp_path / "cam.json"), tmp_path / "wrong.json"
    camera_json(wrong, axes="y-down")
    arguments = ("blur", path, "-o", tmp_path / "x.exr", "--overwrite", *BLUR, "--objects-only")
    assert "explain none" not in run(*arguments, "--camera", fine).err
    assert "cameras explain none of its vectors" in run(*arguments, "--camera", wrong).err


def test_sky_without_vectors_stays(tmp_path):
    path, _ = shot(tmp_path / "a.0011.exr")
    spec, pixels = read_raw(path, kind="float")
    assert isinstance(pixels, np.ndarray)
    names = list(spec.channelnames)
    for name in names:
        if name.startswith("velocity"):
            pixels[:6, :, names.index(name)] = 0
    pixels[:6, :, names.index("Z")] = np.inf
    write_parts(path, [(spec, dict(zip(names, np.moveaxis(pixels, -1, 0), strict=True)))])
    image = blurred(path, "--shutter", "1", "--camera-motion", "0.5")
    np.testing.assert_array_equal(image[:6], exr.read_image(path)[:6])
    image = blurred(path, "--shutter", "1", "--camera-motion", "0.5", "--sky", "camera")
    assert moves(image, exr.read_image(path))[:6].mean() > 0.9


def test_a_world_without_a_common_motion_is_refused(tmp_path):
    velocity = np.random.default_rng(0).normal(scale=9, size=(*SIZE, 2))
    path = write_single(tmp_path / "a.exr", frame(velocity))
    error = refused("blur", path, "-o", tmp_path / "x.exr", *BLUR, "--objects-only")
    assert "cannot be fitted" in error and "--camera FILE.json" in error


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"axes": "z-up"}, "axes: must be y-up or y-down"),
        ({"frames": {}}, "add frame 11"),
        ({"frames": {"x": {}}}, "must be a whole number"),
        ({"frames": {"11": {}}}, "needs either camera_to_world or world_to_camera"),
        ({"field_of_view": 400}, "field_of_view must be above 0 and below 180"),
        ({"fov": 40}, "unknown 'fov'"),
        ({"frames": {"11": {"camera_to_world": [1, 2]}}}, "finite numbers of shape (4, 4)"),
        (
            {"frames": {"11": {"camera_to_world": camera_to_world(11).T.tolist()}}},
            "transpose it if",
        ),
    ],
)
def test_wrong_camera_files(tmp_path, changes, words):
    path, _ = shot(tmp_path / "a.0011.exr")
    cameras = camera_json(tmp_path / "cam.json", **changes)
    options = ("--objects-only", "--camera", cameras)
    assert words in refused("blur", path, "-o", tmp_path / "x.exr", *BLUR, *options)


# Sequences.


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


def test_a_sequence_depends_on_its_file_of_cameras(tmp_path):
    for number in (10, 11, 12):
        shot(tmp_path / f"a.{number:04d}.exr", number)
    cameras = camera_json(tmp_path / "cam.json")
    names = tmp_path / "a.####.exr", "-o", tmp_path / "o.####.exr"
    options = (*BLUR, "--objects-only", "--camera", cameras)
    assert "3 written" in run("blur", *names, *options).out
    assert "3 kept" in run("blur", *names, *options).out
    camera_json(cameras, field_of_view=50)
    assert "made with other parameters" in refused("blur", *names, *options)


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


# Color passes.


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
    assert run("blur", path, "-o", alone, *options).status == 0
    outcome = run("blur", path, "-o", together, *options, *option, "--png")
    assert outcome.status == 0, outcome.err
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
        ("x*", "no other layer of color 'x*'"),
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
