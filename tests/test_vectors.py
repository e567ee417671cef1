"""Vector conventions: every preset by hand, recognition, rejection, ranking by warping."""

import numpy as np
import pytest

from jaxblur import exr, vectors
from tests.exr_files import CUBE, CUBE_NEXT

SIZE = (10, 20)


def convert(preset, raw, *, names=None, shutter=0.5, **options):
    """Half-spread and path of one pixel with the given raw channels."""
    layout = next(
        layout for layout in vectors.PRESETS[preset].layouts if 2 * len(layout) == len(raw)
    )
    names = names or [name for pair in layout for name in (pair.x, pair.y)]
    guess = vectors.assign_channels(preset, names)
    values = np.array(raw, np.float32)[None, None]
    displacements = vectors.to_displacements(values, guess, size=SIZE, **options)
    velocity, path = vectors.to_half_spread(displacements, shutter)
    return velocity[0, 0], None if path is None else path[0, 0]


# A point that moves 8 px right and 4 px down per frame in a picture of 20 x 10 pixels, as each
# renderer would store it. The half-spread at shutter 0.5 is a quarter of that.
HAND_CHECKED = {
    "jaxblur": ([8, 4], {}),
    "nuke": ([8, -4], {}),
    "arnold": ([2, -1], {"file_shutter": 0.25}),
    "vray": ([0.5 + 8 / 40, 0.5 - 4 / 40], {"max_displace": 20}),
    "redshift": ([8, -4], {}),
    "renderman": ([4, 2], {"file_shutter": 0.5}),
    "karma": ([0.2, -0.2], {"file_shutter": 0.5}),
    "moonray": ([0.4, -0.4], {"alpha": np.array([[0.5]])}),
    "terragen": ([4, -2], {"file_shutter": 0.5}),
    "unreal": ([0.5 + 0.2, 0.5 - 0.2], {}),
    "unity": ([0.4, -0.4], {}),
    "fsr2": ([-8, -4], {}),
    "falcor": ([-0.4, -0.4], {}),
    "dlss": ([-0.4, -0.4], {}),
    "rsmb8": ([(127 - 127 * 8 / 16) / 255, (127 + 127 * 4 / 16) / 255], {"max_displace": 16}),
    "guertin8": (
        [(128 + 127 * 2 / 16) / 255, (128 + 127 * 1 / 16) / 255],
        {"max_displace": 16, "file_shutter": 0.5},
    ),
    "rsmb16": (
        [(32767 - 32767 * 8 / 16) / 65535, (32767 + 32767 * 4 / 16) / 65535],
        {"max_displace": 16},
    ),
    "toxik": ([8, -4], {}),
    "fusion": ([8, -4], {}),
    "flo": ([8, 4], {}),
    "pixel": ([8, 4], {}),
    "uv": ([0.4, 0.4], {}),
    "ndc": ([0.8, -0.8], {}),
}


@pytest.mark.parametrize("preset", [name for name in vectors.PRESETS if name != "blender"])
def test_a_hand_checked_vector_of_every_preset(preset):
    raw, options = HAND_CHECKED[preset]
    velocity, path = convert(preset, raw, **options)
    np.testing.assert_allclose(velocity, [2, 1], atol=2e-6)
    assert path is None


@pytest.mark.parametrize(
    ("preset", "raw"),
    [
        ("blender", [-8, 4, -8, 4]),
        ("nuke", [-8, 4, 8, -4]),
        ("jaxblur", [-8, -4, 8, 4]),
    ],
)
def test_a_straight_path_from_both_sides(preset, raw):
    velocity, path = convert(preset, raw)
    np.testing.assert_allclose(velocity, [2, 1])
    assert path is not None
    np.testing.assert_allclose(path, [[-2, -1], [2, 1]])


def turned(radius, angle):
    """Displacement of a point right of its center that rotates by an angle; y down."""
    return radius * np.array([np.cos(angle) - 1, np.sin(angle)])


@pytest.mark.parametrize("degrees", [0.01, 20, 60, 90, 119])
def test_the_path_of_a_turning_point_lies_on_its_circle(degrees):
    angle = np.radians(degrees)
    (x, y), (z, w) = turned(40, -angle), turned(40, angle)
    velocity, path = convert("blender", [x, -y, -z, w], shutter=0.5)
    np.testing.assert_allclose(velocity, [0, 10 * np.sin(angle)], atol=1e-5)
    expected = [turned(40, -angle / 4), turned(40, angle / 4)]
    np.testing.assert_allclose(np.asarray(path), expected, rtol=1e-4, atol=1e-4)


def test_the_path_of_an_accelerated_point_is_its_parabola():
    # Along a line: previous position (-6, -3), next (10, 5), so l = (8, 4) and c = (2, 1).
    velocity, path = convert("blender", [-6, 3, -10, 5], shutter=1.0)
    np.testing.assert_allclose(velocity, [4, 2])
    np.testing.assert_allclose(np.asarray(path), [[-3.5, -1.75], [4.5, 2.25]], rtol=1e-5)


@pytest.mark.parametrize(("x", "y", "z", "w"), [(-6, -1, -10, 3), (4, 5, -4, 5), (0, 0, 0, 0)])
def test_the_path_goes_through_the_positions_in_the_file(x, y, z, w):
    _, path = convert("blender", [x, y, z, w], shutter=2.0)
    np.testing.assert_allclose(np.asarray(path), [[x, -y], [-z, w]], atol=1e-5)


@pytest.mark.parametrize("shutter", [0.25, 0.5, 1.0])
def test_a_path_gives_back_the_displacements_that_it_came_from(shutter):
    generator = np.random.default_rng(3)
    previous, following = generator.normal(size=(2, 40, 1, 2)).astype(np.float32) * 20
    following[:20] = -previous[:20] + generator.normal(size=(20, 1, 2)) * 2
    path = vectors.to_half_spread(vectors.Displacements(previous, following), shutter)[1]
    assert path is not None
    again = vectors.from_path(path, shutter)
    back = vectors.to_half_spread(again, shutter)[1]
    assert back is not None and again.next is not None and again.previous is not None
    np.testing.assert_allclose(back, path, atol=1e-3)
    np.testing.assert_allclose(again.next[:20], following[:20], atol=2e-2)
    np.testing.assert_allclose(again.previous[:20], previous[:20], atol=2e-2)


@pytest.mark.parametrize("preset", ["fsr2", "unreal", "rsmb8"])
def test_past_motion_stands_in_for_future_motion(preset):
    raw, options = HAND_CHECKED[preset]
    layout = vectors.PRESETS[preset].layouts[0]
    assert [pair.time for pair in layout] == [-1]
    guess = vectors.assign_channels(preset, ["a", "b"])
    raw = np.array(raw, np.float32)[None, None]
    displacements = vectors.to_displacements(raw, guess, size=SIZE, **options)
    assert displacements.next is None and displacements.previous is not None
    np.testing.assert_allclose(displacements.previous[0, 0], [-8, -4], atol=1e-5)


def test_each_component_moves_alone_and_the_right_way():
    for raw, expected in (([1, 0], [0.25, 0]), ([0, 1], [0, 0.25])):
        np.testing.assert_array_equal(convert("pixel", raw)[0], expected)
        np.testing.assert_array_equal(convert("fusion", raw)[0], expected * np.array([1, -1]))


def test_the_half_spread_is_proportional_to_the_shutter():
    for shutter in (0.0, 0.25, 1.0, 2.0):
        np.testing.assert_allclose(
            convert("pixel", [8, 4], shutter=shutter)[0], [4 * shutter, 2 * shutter]
        )


def test_moonray_vectors_without_coverage_are_still():
    velocity, _ = convert("moonray", [0.4, -0.4], alpha=np.array([[0.0]]))
    np.testing.assert_array_equal(velocity, [0, 0])


def test_float32_stays_float32():
    velocity, path = convert("blender", [-8, 4, -8, 4])
    assert velocity.dtype == np.float32
    assert path is not None and path.dtype == np.float32


@pytest.mark.parametrize(
    ("preset", "options", "message"),
    [
        ("rsmb8", {}, "`rsmb8` needs `max_displace`"),
        ("vray", {"max_displace": -1}, "`vray` needs `max_displace`"),
        ("arnold", {}, "exposure in frames as `file_shutter`; got None"),
        ("moonray", {}, "there is no alpha channel"),
        ("pixel", {"shutter": -0.5}, "`shutter` must be a fraction of a frame"),
        ("pixel", {"shutter": float("nan")}, "got nan"),
    ],
)
def test_missing_arguments_are_refused(preset, options, message):
    with pytest.raises(ValueError, match=message):
        convert(preset, [0, 0], **options)


def test_displacements_without_a_side_are_refused():
    with pytest.raises(ValueError, match="previous or the next side"):
        vectors.to_half_spread(vectors.Displacements(None, None), 0.5)


BLENDER = [f"ViewLayer.Vector.{axis}" for axis in "XYZW"]
NUKE = ["backward.u", "backward.v", "forward.u", "forward.v"]


@pytest.mark.parametrize(
    ("names", "preset", "channels"),
    [
        (["R", *BLENDER], "blender", BLENDER),
        (["View Layer.Vector.W", *(f"View Layer.Vector.{a}" for a in "ZYX")], "blender", None),
        (["Vector.W", "Vector.X", "Vector.Y", "Vector.Z"], "blender", None),
        (["My.Layer.001.Vector.W", *(f"My.Layer.001.Vector.{a}" for a in "XYZ")], "blender", None),
        (["R", "G", "B", *NUKE], "nuke", NUKE),
        (["motion.forward.u", "motion.forward.v"], "nuke", None),
        (["motionvector.X", "motionvector.Y"], "arnold", None),
        (["velocity.R", "velocity.G", "velocity.B"], "vray", ["velocity.R", "velocity.G"]),
        (["MotionVectors.R", "MotionVectors.G"], "redshift", None),
        (["motionBack.x", "motionBack.y"], "renderman", None),
        (["motionvec.R", "motionvec.G"], "moonray", None),
        (["tgSurf2dMotion.R", "tgSurf2dMotion.G"], "terragen", None),
        (
            [
                "FinalImageMovieRenderQueue_MotionVectors.R",
                "FinalImageMovieRenderQueue_MotionVectors.G",
            ],
            "unreal",
            None,
        ),
        (["mv2DToxik.R", "mv2DToxik.G"], "toxik", None),
        (["velocity.X", "velocity.Y"], "jaxblur", None),
        (
            [f"velocity.{s}.{a}" for s in ("next", "previous") for a in "XY"],
            "jaxblur",
            [f"velocity.{s}.{a}" for s in ("previous", "next") for a in "XY"],
        ),
    ],
)
def test_channel_names_identify_the_convention(names, preset, channels):
    guess = vectors.guess_preset(names)
    assert guess.preset.name == preset
    assert set(guess.channels) <= set(names)
    if channels:
        assert list(guess.channels) == channels
    assert guess.reason.startswith(f"{preset}: found {guess.channels[0]}")
    assert ("unverified" in guess.reason) == (not vectors.PRESETS[preset].verified)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["R", "G", "B"], "no motion vectors recognized among R, G, B"),
        ([], "among no channels"),
        (["Vector.X", "Vector.Y", "Vector.Z"], "no motion vectors recognized"),
        (
            [f"{v}.Vector.{a}" for v in ("A", "B") for a in "XYZW"],
            "blender with A.Vector.X.*; blender with B",
        ),
        ([*BLENDER, *NUKE], "blender with .*; nuke with .*choose with `preset`"),
        (["dPdtime.R", "dPdtime.G", "dPdtime.B"], "no motion vectors recognized"),
    ],
)
def test_unknown_and_ambiguous_names_are_refused(names, message):
    with pytest.raises(ValueError, match=message):
        vectors.guess_preset(names)


def test_a_given_preset_resolves_an_ambiguity():
    assert vectors.match_preset("nuke", [*BLENDER, *NUKE]).channels == tuple(NUKE)


def test_refusals_of_given_presets():
    with pytest.raises(
        ValueError, match=r"`preset` must be auto or one of jaxblur, .*; got 'maya'"
    ):
        vectors.match_preset("maya", ["R"])
    with pytest.raises(ValueError, match=r"no channels of preset `nuke` .* among R, G"):
        vectors.match_preset("nuke", ["R", "G"])
    with pytest.raises(ValueError, match="must name 4 channels for preset `blender`, got 2"):
        vectors.assign_channels("blender", ["a", "b"])
    with pytest.raises(ValueError, match="must name 2 or 4 channels for preset `nuke`, got 3"):
        vectors.assign_channels("nuke", ["a", "b", "c"])


def test_presets_are_consistent_data():
    for name, preset in vectors.PRESETS.items():
        assert preset.name == name and preset.source.endswith((".", ")"))
        for layout in preset.layouts:
            assert [pair.time for pair in layout] in ([-1], [1], [-1, 1])
            assert all({pair.sign_x, pair.sign_y} <= {-1, 1} for pair in layout)
        assert not preset.named or all(
            "." in pair.x for layout in preset.layouts for pair in layout
        ), "bare names identify nothing"


def pan(shift, shape=(40, 60), seed=3):
    """A smooth random picture and the same moved by whole pixels ``(x, y)``."""
    noise = np.random.default_rng(seed).random((*shape, 3))
    shifts = [(i, j) for i in range(3) for j in range(3)]
    smooth = np.mean([np.roll(noise, shift, (0, 1)) for shift in shifts], axis=0)
    return smooth, np.roll(smooth, (shift[1], shift[0]), (0, 1))


@pytest.mark.parametrize(
    ("raw", "expected", "preset"),
    [
        ((6, -4), (1, 1, "px", 0.0, 1.0), "pixel"),
        ((6, 4), (1, -1, "px", 0.0, 1.0), "fusion"),
        ((-6, 4), (-1, -1, "px", 0.0, 1.0), "fsr2"),
        ((3, 2), (1, -1, "px", 0.0, 0.5), "arnold"),
        ((6 / 60, -4 / 40), (1, 1, "uv", 0.0, 1.0), "uv"),
        ((12 / 60, 8 / 40), (1, -1, "ndc", 0.0, 1.0), "ndc"),
        ((0.5 + 3 / 60, 0.5 + 2 / 40), (1, -1, "uv", 0.5, 1.0), "unreal"),
    ],
)
def test_ranking_finds_the_convention_of_a_pan(raw, expected, preset):
    now, following = pan((6, -4))
    vector = np.broadcast_to(np.float32(raw), (40, 60, 2)).copy()
    ranking = vectors.rank_conventions(now, following, vector)
    best = ranking.candidates[0]
    assert (best.sign_x, best.sign_y, best.unit, best.offset, best.span) == expected
    assert preset in best.presets
    assert best.error < 0.5 * ranking.still_error
    assert ranking.moving_share == 1


def test_encoded_vectors_that_are_not_clamped_are_found():
    """A square that is faster than what 0..1 holds, on a plate at rest at 0.5."""
    now, following = pan((12, -6))
    inside = np.zeros((40, 60), bool)
    inside[14:32, 8:30] = True
    moved = np.roll(inside, (-6, 12), (0, 1))
    following = np.where(moved[..., None], following, now)
    raw = np.where(inside[..., None], np.float32(0.5) + np.array((12, 6)) / 16, np.float32(0.5))
    assert raw.max() > 1
    ranking = vectors.rank_conventions(now, following, raw, max_displace=8)
    best = ranking.candidates[0]
    assert ranking.is_explained and best.presets == ("vray",)
    assert (best.sign_x, best.sign_y, best.unit, best.offset) == (1, -1, "displace", 0.5)
    assert ranking.moving_share == inside.mean()


@pytest.mark.parametrize(
    ("shift", "undecided"), [((6, 0), ("the sign of y",)), ((0, -5), ("the sign of x",))]
)
def test_motion_along_one_axis_leaves_the_sign_of_the_other_undecided(shift, undecided):
    now, following = pan(shift)
    vector = np.broadcast_to(np.float32(shift), (40, 60, 2)).copy()
    ranking = vectors.rank_conventions(now, following, vector)
    assert ranking.candidates[0].error < 0.5 * ranking.still_error
    assert ranking.undecided == undecided
    now, following = pan((6, -4))
    vector = np.broadcast_to(np.array((6, -4), np.float32), (40, 60, 2)).copy()
    assert vectors.rank_conventions(now, following, vector).undecided == ()


def test_a_candidate_that_points_outside_the_picture_gains_nothing():
    # A disk on black: a candidate that moves it out of the picture must not win by reading black.
    rows, columns = np.indices((40, 60))
    disks = [np.hypot(rows - 20 - 3 * k, columns - 50 - 6 * k) < 8 for k in (0, 1)]
    now, following = (np.repeat(disk[..., None].astype(float), 3, axis=-1) for disk in disks)
    dark = 0.01 * np.random.default_rng(1).random((40, 60, 3))
    vector = np.where(disks[0][..., None], np.array((6, 3), np.float32), np.float32(0))
    ranking = vectors.rank_conventions(1e-3 * now + dark, 1e-3 * following + dark, vector)
    best = ranking.candidates[0]
    outside = [c for c in ranking.candidates if c.unit != "px"]
    assert all(c.error == pytest.approx(ranking.still_error) for c in outside)
    ranking = vectors.rank_conventions(now, following, vector)
    best = ranking.candidates[0]
    assert (best.sign_x, best.sign_y, best.unit, best.span) == (1, 1, "px", 1.0)
    assert ranking.undecided == () and ranking.is_explained


def test_candidates_that_leave_most_of_the_difference_explain_nothing():
    rng = np.random.default_rng(2)
    now, following = rng.random((2, 40, 60, 3))
    vector = np.full((40, 60, 2), (6, 3), np.float32)
    assert not vectors.rank_conventions(now, following, vector).is_explained


def test_the_difference_that_vectors_leave():
    y, x = np.mgrid[:40, :60].astype(np.float32)
    now, following = (np.sin((x - s) / 3 + y / 5)[..., None] + 1 for s in (0, 2))
    motion = np.zeros((40, 60, 2), np.float32)
    assert vectors.difference_left(now, following, motion) is None
    motion[5:30, 10:50, 0] = 2
    assert vectors.difference_left(now, following, motion) == pytest.approx(0, abs=1e-3)
    against = vectors.difference_left(now, following, -motion)
    assert against is not None and against > 1.5
    assert vectors.difference_left(now, now, motion) is None


def test_ranking_finds_blender_vectors_in_a_rendered_pair():
    guess = vectors.guess_preset(exr.inspect(CUBE).channel_names)
    raw = exr.read_channels(CUBE, guess.channels)
    ranking = vectors.rank_conventions(
        exr.read_image(CUBE), exr.read_image(CUBE_NEXT), raw, guess.channels
    )
    best, second, third = ranking.candidates[:3]
    assert best.channels == ("ViewLayer.Vector.Z", "ViewLayer.Vector.W")
    assert second.channels == ("ViewLayer.Vector.X", "ViewLayer.Vector.Y")
    for candidate in (best, second):
        assert (candidate.sign_x, candidate.sign_y, candidate.unit) == (-1, 1, "px")
        assert candidate.presets == ("blender",)
    assert best.error < 0.4 * third.error < ranking.still_error


def test_both_blender_sides_point_to_the_neighboring_frames():
    """The next frame's X, Y must point back to this frame, as this frame's Z, W point forward."""
    guess = vectors.guess_preset(exr.inspect(CUBE).channel_names)
    raw = exr.read_channels(CUBE_NEXT, guess.channels)
    size = (raw.shape[0], raw.shape[1])
    back = vectors.to_displacements(raw, guess, size=size).previous
    assert back is not None
    ranking = vectors.rank_conventions(exr.read_image(CUBE_NEXT), exr.read_image(CUBE), back)
    best = ranking.candidates[0]
    assert (best.sign_x, best.sign_y, best.unit, best.span) == (1, 1, "px", 1.0)
    assert best.error < 0.5 * ranking.still_error


@pytest.mark.parametrize("number", [10, 11])
def test_ranking_of_whole_rendered_frames(reference_data, number):
    now, following = (
        reference_data / "cube_over_crates" / f"frame_{n:04d}.exr" for n in (number, number + 1)
    )
    guess = vectors.guess_preset(exr.inspect(now).channel_names)
    raw = exr.read_channels(now, guess.channels)
    ranking = vectors.rank_conventions(
        exr.read_image(now), exr.read_image(following), raw, guess.channels
    )
    best, _, third = ranking.candidates[:3]
    assert best.channels == ("ViewLayer.Vector.Z", "ViewLayer.Vector.W")
    assert best.presets == ("blender",)
    assert best.error < 0.2 * third.error


def test_ranking_refusals():
    now, following = pan((1, 1))
    zero = np.zeros((40, 60, 2))
    with pytest.raises(ValueError, match="nothing moves"):
        vectors.rank_conventions(now, following, zero)
    with pytest.raises(ValueError, match="one shape"):
        vectors.rank_conventions(now, following[:-1], zero)
    with pytest.raises(ValueError, match="pairs of components"):
        vectors.rank_conventions(now, following, zero[..., :1])
    with pytest.raises(ValueError, match="`shutter` must be above 0"):
        vectors.rank_conventions(now, following, zero, shutter=0)
    with pytest.raises(ValueError, match="must name 2 components"):
        vectors.rank_conventions(now, following, zero, ["x"])


def test_speed_statistics_of_a_known_field():
    velocity = np.zeros((4, 5, 2), np.float32)
    velocity[0, 0] = [3, 4]
    velocity[0, 1] = [30, 40]
    velocity[0, 2] = [np.nan, 1]
    velocity[0, 3] = [np.inf, 1]
    figures = vectors.speed_statistics(velocity, radius=40)
    assert figures.percentiles[100.0] == 50 and figures.percentiles[50.0] == 0
    assert figures.zero_share == 16 / 20
    assert figures.non_finite_share == 2 / 20
    assert figures.suggested_radius == 5, "not beyond the image"
    still = vectors.speed_statistics(np.zeros((4, 5, 2)))
    assert still.suggested_radius == 5 and still.zero_share == 1
    wide = np.full((1, 20_000, 2), 1e30, np.float32)
    assert vectors.speed_statistics(wide).suggested_radius == 4000


def test_beyond_radius_counts_finite_vectors_only():
    velocity = np.zeros((2, 2, 2))
    velocity[0, 0, 0], velocity[1, 1, 0] = 41, np.inf
    assert vectors.speed_statistics(velocity, radius=40).beyond_share == 1 / 4
