"""The camera's share of the motion on the command line: matrices, files of cameras, the fit."""

import json
import math

import numpy as np
import OpenImageIO as oiio
import pytest
from scipy.spatial.transform import Rotation

from jaxblur import exr
from tests.command_line import refused, run
from tests.exr_files import plain_frame, read_raw, write_parts, write_single
from tests.hero_files import BLUR, SIZE, blurred, frame, note

TURN = np.array([0.02, 0.06, 0.01])

WAY = np.array([0.1, 0.02, -0.1])

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
        ({"axes": []}, "axes: must be y-up or y-down, got []"),
        ({"frames": {}}, "add frame 11"),
        ({"frames": {"x": {}}}, "must be a whole number"),
        ({"frames": {5000 * "1": {}}}, "must be a whole number"),
        ({"frames": {"11": {}}}, "needs either camera_to_world or world_to_camera"),
        ({"field_of_view": 400}, "field_of_view must be above 0.001 and below 180"),
        ({"field_of_view": 1e-300}, "field_of_view must be above 0.001 and below 180"),
        ({"field_of_view": 10**400}, "field_of_view must be finite numbers of shape ()"),
        ({"frames": {"11": {"camera_to_world": [[1e300] * 4] * 4}}}, "below 1e+15"),
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


def test_cameras_that_are_scaled_are_refused_by_the_name_of_their_file(tmp_path):
    path, _ = shot(tmp_path / "a.0011.exr")
    frames = {str(n): {"camera_to_world": camera_to_world(n).tolist()} for n in (10, 11, 12)}
    scaled = camera_to_world(12) @ np.diag([2.0, 1.0, 1.0, 1.0])
    frames["12"] = {"camera_to_world": scaled.tolist()}
    cameras = camera_json(tmp_path / "cam.json", frames=frames)
    options = ("--objects-only", "--camera", cameras)
    error = refused("blur", path, "-o", tmp_path / "x.exr", *BLUR, *options)
    assert f"error: {cameras}: its cameras of neighboring frames must differ by a rotation" in error


def test_a_long_value_of_a_camera_file_is_cut(tmp_path):
    path, _ = shot(tmp_path / "a.0011.exr")
    cameras = camera_json(tmp_path / "cam.json", field_of_view="9" * 5000)
    options = ("--objects-only", "--camera", cameras)
    error = refused("blur", path, "-o", tmp_path / "x.exr", *BLUR, *options)
    assert "field_of_view must be finite numbers" in error and len(error) < 1000


def test_a_camera_file_that_is_nested_too_deep(tmp_path):
    path, _ = shot(tmp_path / "a.0011.exr")
    cameras = tmp_path / "cam.json"
    cameras.write_text(3000 * "[")
    options = ("--objects-only", "--camera", cameras)
    error = refused("blur", path, "-o", tmp_path / "x.exr", *BLUR, *options)
    assert "cam.json: cannot be read as JSON" in error


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
