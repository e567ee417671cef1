# pyright: strict, reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false, reportUnknownLambdaType=false
"""The frame and its conventions: units, axes, signs, shutter, depth.

Every array in jaxblur follows this page; files are converted to it when they are read.

======== ============ =====================================================================
name     shape        meaning
======== ============ =====================================================================
color    (H, W, C)    linear light, not clipped; alpha, if present, is premultiplied
depth    (H, W)       positive distance along the view axis, scene units; ``+inf`` is sky
velocity (H, W, 2)    **half-spread** in pixels, ``(x right, y down)``
path     (H, W, 2, 2) optional: displacement of the point, in pixels ``(x right, y down)``, at
                      shutter opening ``[..., 0, :]`` and at shutter closing ``[..., 1, :]``
valid    (H, W)       optional: False or 0 where the color is unknown; filters leave it out
guide    (H, W, G)    optional: colors that show of which surface a pixel is, where those of
                      ``color`` do not, as in a pass of reflections; `layered` looks at them
======== ============ =====================================================================

Pixels are ``row, column``; row 0 is the top. A surface point at pixel ``p`` covers
``p - velocity .. p + velocity`` while the shutter is open, so

    half-spread = 1/2 * (displacement in pixels per frame) * (shutter in frames),

and a frame at time ``t`` is the image at the center of the exposure ``[t - shutter/2,
t + shutter/2]``. ``velocity`` and ``-velocity`` describe the same blur. A
``path`` knows of bends: half of the way between its ends is ``velocity`` for straight motion, and
longer for what turns by more than the straight displacement between frames shows.

`layered` follows the path of a frame that has one. Its derivative is then in the path, and the one
in the velocity is 0; the other filters know the velocity alone. `Frame.from_motion` makes both from
one source, so that the derivative in that source is right for every filter.
"""

import dataclasses
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, TypeVar

import jax
import jax.export
import jax.numpy as jnp
import numpy as np
from jax import core
from jax.typing import ArrayLike

from .camera import Intrinsics, camera_path

Record = TypeVar("Record", bound=type)


def register_record(kind: Record) -> Record:
    """Make a dataclass of arrays a pytree that `jax.jit` takes and `jax.export` can write.

    Args:
        kind: a frozen dataclass, every field an array or a pytree of arrays.

    Returns:
        The same class, for use as a decorator.
    """
    jax.tree_util.register_dataclass(kind)
    jax.export.register_pytree_node_serialization(
        kind,
        serialized_name=f"{kind.__module__}.{kind.__qualname__}",
        serialize_auxdata=lambda _: b"",
        deserialize_auxdata=lambda _: (),
    )
    return kind


@register_record
@dataclasses.dataclass(frozen=True, repr=False)
class Frame:
    """One sharp frame: color, depth and velocity buffers, optionally curved paths and a mask.

    A pytree of arrays without a batch axis; batch with ``jax.vmap``. Units, axes and signs are
    those of the module docstring. To differentiate in a motion make the frame with `from_motion`:
    where a frame has a path, `layered` follows it, and its derivative in ``velocity`` is 0.

    Attributes:
        color: (H, W, C) linear light.
        depth: (H, W) positive planar depth, ``+inf`` for sky.
        velocity: (H, W, 2) half-spread in pixels, x right, y down.
        path: (H, W, 2, 2) displacement at shutter opening and closing in pixels, or None.
        valid: (H, W) False or 0 where the color is unknown, or None: such a sample contributes
            neither color nor weight, see `jaxblur.finite_frame`.
        guide: (H, W, G) colors that a filter whose weights depend on color looks at instead of
            ``color``, or None. Passes of one picture that have its beauty as their guide are all
            blurred by the same weights, and add up to the blurred beauty.
    """

    color: jax.Array
    depth: jax.Array
    velocity: jax.Array
    path: jax.Array | None = None
    valid: jax.Array | None = None
    guide: jax.Array | None = None

    if TYPE_CHECKING:
        # NumPy arrays are taken too; filters return JAX arrays.
        def __init__(
            self,
            color: ArrayLike,
            depth: ArrayLike,
            velocity: ArrayLike,
            path: ArrayLike | None = None,
            valid: ArrayLike | None = None,
            guide: ArrayLike | None = None,
        ) -> None: ...

    @classmethod
    def from_motion(
        cls,
        color: ArrayLike,
        depth: ArrayLike,
        *,
        path: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        twist: ArrayLike | Sequence[float] | None = None,
        intrinsics: Intrinsics | None = None,
        shutter: ArrayLike = 1.0,
        valid: ArrayLike | None = None,
    ) -> "Frame":
        """Make a frame from one source of motion, in which every filter is differentiable.

        A frame from a velocity has no path. One from a path has the velocity ``(path at closing -
        path at opening) / 2``, so that filters that know no paths depend on it too. One from the
        twist of the camera has the path and velocity of a static scene, see `camera_path`.

        Args:
            color: (H, W, C) linear light.
            depth: (H, W) positive planar depth, ``+inf`` for sky.
            path: (H, W, 2, 2) displacement at shutter opening and closing in pixels.
            velocity: (H, W, 2) half-spread in pixels.
            twist: (6,) motion of the camera per frame, or, with the default shutter, during the
                exposure; see `camera_path`.
            intrinsics: focal lengths and center in pixels; with `twist` only.
            shutter: exposure time in frames; with `twist` only.
            valid: (H, W) mask of known colors, or None.

        Returns:
            The frame.

        Raises:
            ValueError: there is not exactly one of path, velocity and twist, `intrinsics` is
                missing or left over, or a shape is wrong.
        """
        sources = {"path": path, "velocity": velocity, "twist": twist}
        given = [name for name, value in sources.items() if value is not None]
        if len(given) != 1:
            raise ValueError(
                "`path`, `velocity` and `twist` must be exactly one source of motion, got "
                f"{' and '.join(given) or 'none'}."
            )
        if (twist is None) != (intrinsics is None):
            raise ValueError(
                "`intrinsics` must be given with `twist` and only then, for instance "
                "jaxblur.Intrinsics.from_field_of_view(degrees, (height, width))."
            )
        if twist is not None and intrinsics is not None:
            path = camera_path(depth, twist, intrinsics, shutter)
        if path is not None:
            path, expected = jnp.asarray(path), (*jnp.shape(depth), 2, 2)
            if path.shape != expected:
                raise ValueError(
                    f"`path` must have shape {expected} to match `depth`, got {path.shape}."
                )
            velocity = (path[..., 1, :] - path[..., 0, :]) / 2
        return check_frame(cls(color, depth, jnp.asarray(velocity), path, valid))

    def replace(self, **changes: ArrayLike | None) -> "Frame":
        """The frame with some buffers replaced.

        Args:
            **changes: buffers by name; None removes a path or a mask.

        Returns:
            A new frame.

        Raises:
            ValueError: a frame has no such buffer.
        """
        names = [field.name for field in dataclasses.fields(self)]
        for name in changes:
            if name not in names:
                raise ValueError(f"`{name}` must be a buffer of a frame: {', '.join(names)}.")
        return dataclasses.replace(self, **changes)

    def __repr__(self) -> str:
        parts = []
        for field in dataclasses.fields(self):
            buffer = getattr(self, field.name)
            if buffer is not None:
                parts.append(f"{field.name}={_in_short(buffer)}")
        return f"Frame({', '.join(parts)})"


def _in_short(buffer: object) -> str:
    """Type, shape and range of a buffer; without a range while it is traced."""
    shape = getattr(buffer, "shape", None)
    if shape is None:
        return repr(buffer)
    text = f"{getattr(buffer, 'dtype', '?')}{list(shape)}"
    if isinstance(buffer, core.Tracer) or not isinstance(buffer, jax.Array | np.ndarray):
        return text
    values = np.asarray(buffer)
    if not values.size:
        return text
    if np.isnan(values).any():
        return f"{text} with NaN"
    return f"{text} {values.min():.4g} to {values.max():.4g}"


def check_frame_type(frame: object, argument: str = "frame") -> None:
    """Reject what is not a frame, and say how to make one of it.

    Args:
        frame: as given.
        argument: name of the argument, for the message.

    Raises:
        ValueError: it is no `Frame`.
    """
    if isinstance(frame, Frame):
        return
    given, remedy = type(frame).__name__, "pass jaxblur.Frame(color, depth, velocity)"
    if isinstance(frame, type):
        given = f"the class {frame.__name__} itself"
    elif isinstance(frame, tuple | list) and frame and isinstance(frame[0], Frame):
        remedy = "pass the first entry alone"
    elif isinstance(frame, str | os.PathLike):
        remedy = "read the file: jaxblur.read_frame(path)"
    elif isinstance(frame, np.ndarray | jax.Array):
        given = f"an array {tuple(frame.shape)}"
    raise ValueError(f"`{argument}` must be a jaxblur.Frame, got {given}; {remedy}.")


def check_frame(frame: Frame) -> Frame:
    """Check shapes and return the frame as floating-point JAX arrays of one dtype.

    Half-precision, integer and boolean buffers become float32; float64 buffers stay float64 where
    JAX has 64-bit types enabled. Values are not looked at (that is done where files are read, and
    by `jaxblur.finite_frame`).

    Args:
        frame: buffers as NumPy or JAX arrays.

    Returns:
        The frame with every buffer in the widest of the buffers' dtypes, at least float32.

    Raises:
        ValueError: it is no frame, a buffer is missing or has the wrong number of axes, or sizes
            disagree.
    """
    check_frame_type(frame)
    for name in ("color", "depth", "velocity"):
        if getattr(frame, name) is None:
            raise ValueError(f"`frame.{name}` must be an array, got None.")
    buffers = {
        field.name: jnp.asarray(value)
        for field in dataclasses.fields(frame)
        if (value := getattr(frame, field.name)) is not None
    }
    color = buffers["color"]
    if color.ndim != 3:
        raise ValueError(
            f"`frame.color` must have shape (height, width, channels), got {color.shape}; "
            "add a channel axis (color[..., None]), or apply jax.vmap over a batch axis."
        )
    size = color.shape[:2]
    expected = {"depth": size, "velocity": (*size, 2), "path": (*size, 2, 2), "valid": size}
    if "guide" in buffers:
        # Any number of channels will do.
        expected["guide"] = (*size, buffers["guide"].shape[-1] if buffers["guide"].ndim == 3 else 1)
    for name, shape in expected.items():
        if name in buffers and buffers[name].shape != shape:
            without_channels = name == "guide" and buffers[name].shape == size
            remedy = "; pass guide[..., None]" if without_channels else ""
            raise ValueError(
                f"`frame.{name}` must have shape {shape} to match `frame.color`, "
                f"got {buffers[name].shape}{remedy}."
            )
    if 0 in color.shape:
        raise ValueError(f"`frame.color` must not be empty, got shape {color.shape}.")
    dtype = jnp.result_type(jnp.float32, *(b.dtype for b in buffers.values()))
    return Frame(**{name: buffer.astype(dtype) for name, buffer in buffers.items()})


def without_alpha(frame: Frame, truth: ArrayLike, what: str = "`truth`") -> tuple[Frame, jax.Array]:
    """Check a frame and its true image, and keep the color channels of both.

    Alpha is no light: files hold it beside three channels, and not always in both.

    Args:
        frame: as `check_frame` takes it.
        truth: (H, W, C) true image.
        what: the truth, for messages.

    Returns:
        The checked frame and the truth in its dtype, the first three channels of each if it has
        more.

    Raises:
        ValueError: the frame is wrong, or the truth has another size or other channels.
    """
    frame = check_frame(frame)
    image = jnp.asarray(truth, frame.color.dtype)
    if image.ndim != 3 or image.shape[:2] != frame.color.shape[:2]:
        raise ValueError(
            f"{what} must have shape (height, width, channels) like the frame "
            f"{frame.color.shape}, got {image.shape}; render both with the same data window."
        )
    color, image = (a[..., :3] if a.shape[-1] > 3 else a for a in (frame.color, image))
    if color.shape != image.shape:
        raise ValueError(
            f"{what} must have {color.shape[-1]} color channels like the frame, got "
            f"{image.shape[-1]}."
        )
    return frame.replace(color=color), image


def check_parameters(parameters: object, kind: type) -> None:
    """Reject the parameters of another filter, and maps of parameters.

    Args:
        parameters: as given to the filter.
        kind: the class that it takes.

    Raises:
        ValueError: they are of another class, or one of them is not a scalar.
    """
    if not isinstance(parameters, kind):
        name, given = kind.__name__, type(parameters).__name__
        raise ValueError(f"`parameters` must be {name}, got {given}; pass {name}().")
    for name, value in vars(parameters).items():
        if jnp.shape(value):
            raise ValueError(
                f"`parameters.{name}` must be a scalar, got shape {jnp.shape(value)}; a value for "
                "each pixel is not supported. For a batch of values use jax.vmap."
            )
