"""Values that are read: depth of every kind, NaN and infinity, speeds, lossy compression."""

import numpy as np
import pytest

from jaxblur import exr
from jaxblur.nonfinite import Ignored
from tests.exr_files import plain_frame, write_single


@pytest.mark.parametrize(
    ("kind", "stored", "distance"),
    [
        ("z", [2, 1e9, 1e10, np.inf, 0], [2, *[np.inf] * 4]),
        ("-z", [-2, -1e10, -np.inf, 0], [2, *[np.inf] * 3]),
        ("1/z", [0.5, 0, 4], [2, np.inf, 0.25]),
        ("-1/z", [-0.5, 0, -4], [2, np.inf, 0.25]),
        ("normalized-near1", [1, 0.25, 0], [1, 1.75, np.inf]),
    ],
)
def test_depth_becomes_a_positive_distance(tmp_path, kind, stored, distance):
    channels = plain_frame((1, len(stored)))
    channels["Z"][0] = stored
    path = write_single(tmp_path / "a.exr", channels)
    np.testing.assert_array_equal(exr.read_buffers(path, depth=kind).depth[0], distance)


@pytest.mark.parametrize(
    ("kind", "value", "message"),
    [
        ("z", -3, "Z: 1 of 24 pixels are negative .first at row 1, column 2.; pass depth='-z'"),
        ("-z", 3, "negative .*pass depth='z'"),
        ("1/z", -1, "Z: 1 of 24 pixels are negative .*pass depth='-1/z'"),
        ("-1/z", 1, "Z: 1 of 24 pixels are negative .*pass depth='1/z'"),
        ("1/z", 1e10, "1e9 or more .*pass depth='z'"),
        ("normalized-near1", 1.5, "above 1 .*pass depth='z'"),
    ],
)
def test_depth_that_contradicts_its_kind_is_rejected(tmp_path, kind, value, message):
    channels = plain_frame()
    channels["Z"] = np.full((4, 6), -0.5 if kind.startswith("-") else 0.5, np.float32)
    channels["Z"][1, 2] = value
    path = write_single(tmp_path / "a.exr", channels)
    with pytest.raises(exr.JaxblurIOError, match=message):
        exr.read_buffers(path, depth=kind)


@pytest.mark.parametrize("name", ["G", "velocity.Y"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_non_finite_values_are_refused_or_left_out(tmp_path, name, value):
    channels = plain_frame()
    channels[name][2, 3] = channels[name][3, 0] = value
    path = write_single(tmp_path / "a.exr", channels)
    message = rf"a.exr: {name}: 2 of 24 pixels are NaN or infinite \(first at row 2, column 3\)"
    with pytest.raises(exr.JaxblurIOError, match=message):
        exr.read_frame(path)
    names, taken = (
        ("R, G, B", "left out") if name == "G" else ("velocity.X, velocity.Y", "taken as")
    )
    words = f"{names}: 2 of 24 pixels are NaN or infinite, and are {taken}"
    with pytest.warns(exr.JaxblurIOWarning, match=words):
        buffers = exr.read_buffers(path, nonfinite="ignore")
    assert np.isfinite(buffers.color).all() and np.isfinite(buffers.velocity).all()
    if name == "G":
        assert buffers.ignored == Ignored(color=2)
        assert buffers.valid is not None and np.argwhere(~buffers.valid).tolist() == [
            [2, 3],
            [3, 0],
        ]
    else:
        assert buffers.ignored == Ignored(velocity=2) and buffers.valid is None
        assert (buffers.velocity[2, 3] == 0).all()
    kept = exr.read_buffers(path, nonfinite="keep")
    kept_target = kept.color[..., 1] if name == "G" else kept.velocity[..., 1]
    assert (~np.isfinite(kept_target)).sum() == 2


def test_unknown_vectors_are_at_rest_whatever_the_raw_value_of_rest(tmp_path):
    channels = {name: plain_frame()[name] for name in "RGBZ"}
    channels |= {f"Velocity.{c}": np.full((4, 6), 0.75, np.float32) for c in "RG"}
    channels["Velocity.R"][1, 1] = np.nan
    path = write_single(tmp_path / "a.exr", channels)
    with pytest.warns(exr.JaxblurIOWarning):
        frame = exr.read_frame(path, max_displace=8, depth="z", nonfinite="ignore")
    velocity = np.asarray(frame.velocity)
    assert (velocity[1, 1] == 0).all()
    assert (np.delete(velocity.reshape(-1, 2), 7, axis=0) != 0).all()


@pytest.mark.parametrize(
    ("value", "sign", "kind"), [(np.nan, 1, "z"), (-np.inf, 1, "z"), (np.inf, -1, "-z")]
)
def test_unknown_depth_is_refused_or_sky(tmp_path, value, sign, kind):
    channels = plain_frame()
    channels["Z"] *= sign
    channels["Z"][1, 2] = value
    path = write_single(tmp_path / "a.exr", channels)
    with pytest.raises(exr.JaxblurIOError, match=r"a.exr: Z: 1 of 24 pixels are NaN"):
        exr.read_frame(path, depth=kind)
    with pytest.warns(exr.JaxblurIOWarning, match="Z: 1 of 24 .* and are taken as sky"):
        buffers = exr.read_buffers(path, depth=kind, nonfinite="ignore")
    assert np.isposinf(buffers.depth[1, 2]) and buffers.ignored == Ignored(depth=1)


def test_impossible_speeds_are_refused(tmp_path):
    channels = plain_frame()
    channels["velocity.X"][0, 5] = 1e20
    path = write_single(tmp_path / "a.exr", channels)
    message = r"velocity.X, velocity.Y: 1 of 24 pixels are faster .*check the preset \(jaxblur\)"
    with pytest.raises(exr.JaxblurIOError, match=message):
        exr.read_frame(path)


@pytest.mark.parametrize(
    ("compression", "types", "lossy"),
    [
        ("pxr24", "float", ["velocity.X", "velocity.Y", "Z"]),
        ("pxr24", "half", []),
        ("b44", "half", ["velocity.X", "velocity.Y", "Z"]),
        ("b44", "float", []),
        ("dwaa", "float", ["velocity.Y"]),
        ("zip", "float", []),
    ],
)
def test_lossy_compression_of_vectors_is_reported_if_values_change(
    tmp_path, recwarn, compression, types, lossy
):
    plain = plain_frame((64, 64))
    if types == "half":
        plain = {name: v.astype(np.float16).astype(np.float32) for name, v in plain.items()}
    path = write_single(tmp_path / "a.exr", plain, types, compression=compression)
    data = ["velocity.X", "velocity.Y", "Z"]
    stored = exr.read_channels(path, data)
    changed = [name for i, name in enumerate(data) if (stored[..., i] != plain[name]).any()]
    assert changed == lossy
    exr.read_buffers(path)
    reported = [str(warning.message) for warning in recwarn]
    assert len(reported) == (1 if lossy else 0), "one warning for all channels"
    are = "are" if len(lossy) > 1 else "is"
    words = f"a.exr: {', '.join(lossy)} {are} stored with lossy compression ({compression})"
    assert all(words in text for text in reported)


def cropped(tmp_path, velocity, origin, alpha=True):
    """A frame of 6x4 pixels in a picture of 12x8; one pixel, at row 1 and column 4, moves so far in
    half an exposure of two frames."""
    channels = plain_frame()
    for axis, part in zip("XY", velocity, strict=True):
        channels[f"velocity.{axis}"][:] = 0
        channels[f"velocity.{axis}"][1, 4] = part
    if alpha:
        channels["A"] = np.ones_like(channels["R"])
        channels["A"][0, 0] = 0.5
    return write_single(tmp_path / "a.exr", channels, origin=origin, display=(0, 0, 12, 8))


@pytest.mark.parametrize(
    ("velocity", "sides"),
    [
        ((1.6, 0), "right"),
        ((0, 1.6), "top"),
        ((5, 0), "left, right"),
        ((0, 2.6), "top, bottom"),
    ],
)
def test_an_element_whose_blur_leaves_its_data_window_is_reported(tmp_path, velocity, sides):
    path = cropped(tmp_path, velocity, origin=(3, 2))
    words = rf"6x4 at \(3, 2\), across its edges \({sides}\).*--croptofull"
    with pytest.warns(exr.JaxblurIOWarning, match=words):
        exr.read_frame(path, shutter=2)


@pytest.mark.parametrize(
    ("velocity", "origin", "alpha"),
    [((1.4, 0), (3, 2), True), ((1.6, 0), (6, 2), True), ((1.6, 0), (3, 2), False)],
)
def test_blur_that_stays_within_or_leaves_the_picture_is_not(tmp_path, velocity, origin, alpha):
    exr.read_frame(cropped(tmp_path, velocity, origin, alpha), shutter=2)
