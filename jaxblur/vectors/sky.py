"""Estimate the sky's velocity from the camera's rotation, for files without vectors there.

Blender writes zero vectors for the sky even when the camera rotates, so that clouds stay sharp in a
pan. The motion of the camera can be estimated from the surfaces: the velocity that a rotating and
translating camera gives the pixel at (x, y) with depth z is linear in eight unknowns
[Longuet-Higgins and Prazdny 1980],

    u = a + c y + d x^2 + e x y + (t_x + t_z x) / z
    v = b - c x + d x y + e y^2 + (t_y + t_z y) / z

and the velocity of the sky, at infinity, depends only on the first five. They are fitted to the
farthest surfaces first, then to all surfaces; surfaces that move on their own get a small weight.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ..frame import Frame, check_frame

UNKNOWNS, TURN = 8, 5
STEP = 3
"""Stride in rows and columns of the pixels that are used."""
FAR = 0.3
"""Share of the surfaces, the farthest ones, from which the rotation is found and judged."""
ROUNDS, FAR_ROUNDS = 20, 6
STRAY = 0.25
"""Deviation in pixels at which a surface counts as moving on its own."""
AGREEMENT = 0.9
"""Share of the far surfaces that must agree with the camera's motion. On scenes of the
catalogue and on rendered ones it is 0.93 or more where the rotation is right, and 0.36 or less
where it is wrong."""
LEAST_SPEED = 0.5
"""Largest velocity in pixels that filters do not blur."""
FEWEST = 100


def turning_sky(frame: Frame) -> Frame:
    """Give the sky the velocity of the camera's rotation, where its vectors are zero.

    The frame is returned unchanged if there is no sky or the sky has its own vectors, if the
    camera's rotation moves the sky by at most half a pixel, or if less than nine in ten of the far
    surfaces move as one rigid world. Runs in NumPy; not differentiable.

    Args:
        frame: depth (H, W), ``+inf`` for sky; velocity (H, W, 2) half-spread in pixels.

    Returns:
        The frame with velocities, and straight paths if it has paths, for the sky.

    Raises:
        ValueError: shapes disagree.

    Source: the motion field of Longuet-Higgins and Prazdny 1980, by reweighted least squares.
    """
    depth, velocity = np.asarray(frame.depth, float), np.array(check_frame(frame).velocity)
    sky = np.isposinf(depth)
    empty = sky & ~velocity.any(axis=-1)
    seen = np.zeros_like(sky)
    seen[::STEP, ::STEP] = True
    seen &= ~sky
    if empty.sum() < AGREEMENT * sky.sum() or not empty.any() or seen.sum() < FEWEST:
        return frame
    # In units of the median depth, so that the unknowns have similar scales.
    inverse = np.where(sky, 0, np.median(depth[seen]) / np.where(sky, 1, depth))
    basis = _motion_field(inverse)
    far = depth[seen] >= np.quantile(depth[seen], 1 - FAR)
    unknowns, agreement = _fit(basis[seen], velocity[seen].astype(float), far)
    turn = basis[empty][..., :TURN] @ unknowns[:TURN]
    if agreement < AGREEMENT or np.linalg.norm(turn, axis=-1).max() <= LEAST_SPEED:
        return frame
    velocity[empty] = turn
    return _moved(frame, velocity, empty)


@dataclasses.dataclass(frozen=True)
class CameraFit:
    """The motion of the camera as the surfaces show it.

    Attributes:
        velocity: (H, W, 2) half-spread in pixels that the camera gives a scene at rest.
        path: (H, W, 2, 2) likewise the displacement at opening and closing, or None for a frame
            without paths.
        agreement: share of the farthest surfaces that move by the velocity, to a quarter of a
            pixel.
    """

    velocity: Float[np.ndarray, "height width 2"]
    path: Float[np.ndarray, "height width 2 2"] | None
    agreement: float

    @property
    def motion(self) -> Float[np.ndarray, "height width ..."]:
        """The path, or the velocity where there is none, as `jaxblur.split_motion` takes it."""
        return self.velocity if self.path is None else self.path


def fit_camera_motion(frame: Frame) -> CameraFit:
    """Find the motion that the camera gives a scene at rest, from the frame's own motion.

    The motion field of a rotating and translating camera (see the module) is fitted to the farthest
    surfaces first, then to all; surfaces that move on their own get a small weight. Where sky has
    vectors, it counts as a surface, the farthest of all. A path is fitted at opening and closing
    apart, so that its bend is found too. Runs in NumPy; not differentiable.

    Args:
        frame: depth (H, W), ``+inf`` for sky; velocity (H, W, 2) half-spread in pixels, and perhaps
            a path.

    Returns:
        The motion, and how well the far surfaces agree with it: above 0.9 where it is right.

    Raises:
        ValueError: shapes disagree, or less than a hundred of the pixels that are looked at have
            vectors.
    """
    depth, velocity = np.asarray(frame.depth, float), np.asarray(check_frame(frame).velocity, float)
    sky = np.isposinf(depth)
    seen = np.zeros_like(sky)
    seen[::STEP, ::STEP] = True
    seen &= ~(sky & ~velocity.any(axis=-1))
    if seen.sum() < FEWEST:
        raise ValueError(
            f"`frame` must show surfaces at {FEWEST} or more of every ninth pixel, got "
            f"{seen.sum()}."
        )
    surfaces = depth[seen & ~sky]
    unit = np.median(surfaces) if surfaces.size else 1.0
    basis = _motion_field(np.where(sky, 0, unit / np.where(sky, 1, depth)))
    far = depth[seen] >= np.sort(depth[seen])[int((1 - FAR) * seen.sum())]

    def fitted(motion: np.ndarray) -> tuple[np.ndarray, float]:
        unknowns, agreement = _fit(basis[seen], motion[seen], far)
        return (basis @ unknowns).astype(np.float32), agreement

    fit, agreement = fitted(velocity)
    if frame.path is None:
        return CameraFit(fit, None, agreement)
    ends = [fitted(np.asarray(frame.path[..., side, :], float))[0] for side in (0, 1)]
    return CameraFit(fit, np.stack(ends, axis=-2), agreement)


def _motion_field(
    inverse_depth: Float[np.ndarray, "height width"],
) -> Float[np.ndarray, "height width 2 8"]:
    """Compute the velocity that each unknown gives the pixels; positions in half widths."""
    height, width = inverse_depth.shape
    row, column = np.mgrid[:height, :width] + 0.5
    x, y = 2 * column / width - 1, (2 * row - height) / width
    one, none, near = np.ones_like(x), np.zeros_like(x), inverse_depth
    across = [one, none, y, x * x, x * y, near, none, x * near]
    down = [none, one, -x, x * y, y * y, none, near, y * near]
    return np.stack([np.stack(across, -1), np.stack(down, -1)], axis=-2)


def _fit(
    basis: Float[np.ndarray, "n 2 8"],
    velocity: Float[np.ndarray, "n 2"],
    far: Bool[np.ndarray, " n"],
) -> tuple[Float[np.ndarray, " 8"], float]:
    """Fit the unknowns; return them and the share of the far surfaces that agree with them."""
    weights, unknowns, stray = far.astype(float), np.zeros(UNKNOWNS), np.zeros(len(far))
    # If all depths are equal, rotation and translation look the same: take the smallest unknowns.
    ridge = 1e-6 * len(basis) * np.eye(UNKNOWNS)
    for turn in range(ROUNDS):
        scaled = basis * weights[:, None, None]
        normal = np.einsum("nia,nib->ab", scaled, basis) + ridge
        unknowns = np.linalg.solve(normal, np.einsum("nia,ni->a", scaled, velocity))
        stray = np.linalg.norm(basis @ unknowns - velocity, axis=-1)
        weights = np.where(far | (turn >= FAR_ROUNDS), 1 / np.square(1 + (stray / STRAY) ** 2), 0)
    return unknowns, float((stray[far] < STRAY).mean())


def _moved(
    frame: Frame,
    velocity: Float[np.ndarray, "height width 2"],
    where: Bool[np.ndarray, "height width"],
) -> Frame:
    """Return the frame with other velocities, and with straight paths where they changed."""
    path = frame.path
    if path is not None:
        straight = np.stack([-velocity, velocity], axis=2)
        path = jnp.asarray(np.where(where[..., None, None], straight, path), velocity.dtype)
    return dataclasses.replace(frame, velocity=jnp.asarray(velocity), path=path)
