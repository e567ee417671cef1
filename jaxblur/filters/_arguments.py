"""What a filter accepts: its own parameters and settings, a frame, noise; and errors for the rest.

The checks of types work while a filter is traced, and accept subclasses; values are looked at only
where they are known.
They stand before `jax.jit`, whose errors for a foreign object name neither argument nor remedy.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ParamSpec, TypeVar

import jax
import jax.export
import jax.numpy as jnp
import numpy as np
from jax import core

from ..frame import Frame, check_frame, check_frame_type, check_parameters
from ..noise import Noise
from ..nonfinite import refuse
from ..settings import (
    GuertinSettings,
    LayeredSettings,
    McGuireSettings,
    Settings,
    checked_settings,
)
from .parameters import check_parameters_type, infos_of
from .registry import FilterInfo, filter_info, names

P = ParamSpec("P")
R = TypeVar("R")
Kind = TypeVar("Kind")

_BY_POSITION = ("frame", "parameters")


_CHECKED = "__jaxblur_takes__"
"""Attribute of a filter that `takes` has decorated."""


def takes(
    parameters: type | None, settings: type[Settings] = Settings, more: Sequence[str] = ()
) -> Callable[..., Any]:
    """Make a filter check the types of its arguments, and its motion for NaN, before all else.

    It stands above `jax.jit`, and works on a filter of one's own as on those of the package.

    Args:
        parameters: the class of its parameters, or None if it has none.
        settings: the class of its settings. The filter is given an object of this class, also
            where plain `Settings` were passed: see `checked_settings`.
        more: names of further arguments, which the filter checks itself.

    Returns:
        A decorator of a filter ``(frame, parameters, *, settings, noise)``. The decorated filter
        raises ValueError for an argument of another type, and TypeError for one that is missing,
        unknown, or given by position though it has a name.
    """
    for kind in settings.__mro__:
        if issubclass(kind, Settings):
            _make_static(kind)

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        name = getattr(function, "__name__", "the filter")

        @functools.wraps(function)
        def checked(*given: P.args, **options: P.kwargs) -> R:
            known = {k: v for k, v in options.items() if k not in more}
            _check_form(name, parameters, settings, given, known)
            values: dict[str, Any] = dict(zip(_BY_POSITION, given, strict=False)) | known
            _check_types(name, parameters, values)
            if "settings" in options:
                # The filter finds every setting of its class, whichever class it was given.
                options["settings"] = checked_settings(values["settings"], settings, name)
            refuse_nan_motion(values["frame"])
            return function(*given, **options)

        setattr(checked, _CHECKED, True)
        return checked

    return decorate


@functools.cache
def _make_static(kind: type[Settings]) -> None:
    """Let `jax.jit`, `jax.vmap` and others take settings by name, fixed when they trace.

    Raises:
        ValueError: jax knows the class already, and not as static.
    """
    try:
        jax.tree_util.register_static(kind)
    except ValueError:
        if jax.tree.leaves(kind()):
            raise ValueError(
                f"`{kind.__name__}` must be static, but its fields are registered with jax as "
                f"arrays; remove @jax.tree_util.register_dataclass above {kind.__name__}."
            ) from None


def _known_to_jax(kind: type[Settings]) -> None:
    """Make settings of the package static, and let `jax.export` write them."""
    _make_static(kind)
    jax.export.register_pytree_node_serialization(
        kind,
        serialized_name=f"{kind.__module__}.{kind.__qualname__}",
        serialize_auxdata=lambda settings: json.dumps(dataclasses.asdict(settings)).encode(),
        deserialize_auxdata=lambda written: kind(**json.loads(written)),
    )


# The public names of these classes load this module, so that settings are static from the first.
for _kind in (Settings, GuertinSettings, McGuireSettings, LayeredSettings):
    _known_to_jax(_kind)


def checked_inputs(frame: Frame, parameters: Kind, kind: type[Kind]) -> tuple[Frame, Kind]:
    """Frame and parameters in one dtype, inside a jitted filter.

    Args:
        frame: as it was given.
        parameters: likewise.
        kind: class of the parameters.

    Returns:
        The same as floating-point arrays.

    Raises:
        ValueError: shapes disagree, or a parameter is not a scalar.
    """
    check_parameters(parameters, kind)
    frame = check_frame(frame)
    return frame, jax.tree.map(lambda p: jnp.asarray(p, frame.color.dtype), parameters)


def checking(function: Callable[..., Any], info: FilterInfo) -> Callable[..., Any]:
    """A filter that checks its arguments by `takes`: itself, if it does so already.

    Args:
        function: the filter.
        info: its record. Arguments that its signature has besides those of every filter are its
            own to check.
    """
    if hasattr(function, _CHECKED):
        return function
    known = (*_BY_POSITION, "settings", "noise")
    more = [name for name in inspect.signature(function).parameters if name not in known]
    return takes(info.parameters, info.kind, more)(function)


def _check_form(
    name: str,
    parameters: type | None,
    settings: type[Settings],
    given: tuple[Any, ...],
    options: Mapping[str, Any],
) -> None:
    """Reject arguments that are missing, unknown, or given by position though they have a name."""
    example = "frame" if parameters is None else f"frame, {parameters.__name__}()"
    if any(isinstance(value, Settings) for value in given):
        raise TypeError(
            f"`settings` of {name} must be given by name: {name}({example}, settings=...)."
        )
    if len(given) > len(_BY_POSITION):
        raise TypeError(
            f"{name} takes `frame` and `parameters` by position and the rest by name, got "
            f"{len(given)} by position: {name}({example}, settings=..., noise=...)."
        )
    for option in options:
        if option not in (*_BY_POSITION, "settings", "noise"):
            raise TypeError(_unknown_option(name, option, parameters, settings))
    there = (*_BY_POSITION[: len(given)], *options)
    if "frame" not in there:
        raise TypeError(f"`frame` of {name} is missing: {name}({example}).")
    if "parameters" not in there and parameters is not None:
        raise TypeError(
            f"`parameters` of {name} are missing: {name}({example}); {parameters.__name__}() are "
            "the defaults."
        )


def _check_types(name: str, kind: type | None, values: Mapping[str, Any]) -> None:
    """Reject values of another type."""
    check_frame_type(values["frame"])
    _check_arrays(values["frame"])
    parameters = values.get("parameters")
    check_parameters_type(parameters, kind, name)
    if parameters is not None and jax.tree_util.all_leaves([parameters]):
        given = type(parameters).__name__
        raise ValueError(
            f"`parameters` must be known to jax, but {given} is not; put "
            f"@jax.tree_util.register_dataclass above {given}."
        )
    refuse_out_of_range(parameters)
    noise = values.get("noise")
    if noise is not None and not isinstance(noise, Noise):
        raise ValueError(
            f"`noise` must be a jaxblur.Noise or None, got {type(noise).__name__}; pass "
            "jaxblur.Noise(tap, tile)."
        )


def _check_arrays(frame: Any) -> None:
    """Reject buffers that are no arrays of NumPy or JAX, as those of other libraries."""
    for name, buffer in vars(frame).items():
        if buffer is None or isinstance(buffer, jax.Array):
            continue
        if not isinstance(buffer, np.ndarray | np.generic):
            raise ValueError(
                f"`frame.{name}` must be an array of NumPy or JAX, got {type(buffer).__name__}; "
                "pass np.asarray(...)."
            )
        if not buffer.dtype.isnative:
            raise ValueError(
                f"`frame.{name}` must have the byte order of this machine, got {buffer.dtype}; "
                "pass buffer.astype(buffer.dtype.newbyteorder('='))."
            )


def _unknown_option(
    name: str, option: str, parameters: type | None, settings: type[Settings]
) -> str:
    if option in {field.name for field in dataclasses.fields(settings)}:
        return (
            f"`{option}` is a setting of {name}: pass settings={settings.__name__}({option}=...)."
        )
    if parameters is not None and option in {f.name for f in dataclasses.fields(parameters)}:
        return (
            f"`{option}` is a parameter of {name}: pass {parameters.__name__}({option}=...) as "
            "`parameters`."
        )
    if option == "exposure":
        able = " or ".join(each for each in names() if filter_info(each).takes_shutter)
        return (
            f"`exposure`: {name} knows only a box centered on the frame, as long as its velocity "
            f"says (for another one scale the velocity); {able} takes any shutter."
        )
    if option == "lens":
        able = " or ".join(each for each in names() if filter_info(each).takes_lens)
        return (
            f"`lens`: {name} blurs by motion alone (jaxblur.posts.defocus blurs its result by a "
            f"lens); {able} takes a lens."
        )
    return f"{name} takes frame, parameters, settings and noise, not `{option}`; leave it out."


def refuse_out_of_range(parameters: Any) -> None:
    """Reject parameters outside their range, and NaN; traced ones cannot be looked at.

    Args:
        parameters: of a filter, or None.

    Raises:
        ValueError: a value is known, and out of range.
    """
    infos = {} if parameters is None else infos_of(type(parameters))
    for name, info in infos.items():
        value = getattr(parameters, name)
        is_known = isinstance(value, int | float | np.generic) or _is_known(value)
        if is_known and not np.shape(value) and not info.allows(float(value)):
            raise ValueError(f"`parameters.{name}` must be {info.range}, got {float(value):g}.")


def refuse_nan_motion(frame: Any) -> None:
    """Reject NaN in depth, velocity or path, which would leave a frame sharp without a word.

    Filters call it. NaN in color stays visible in the result and is not looked for; a buffer that
    is traced, as under ``jax.jit``, cannot be looked at.

    Args:
        frame: as given to a filter.

    Raises:
        ValueError: there is NaN.
    """
    for name in ("depth", "velocity", "path"):
        buffer = getattr(frame, name)
        if _is_known(buffer) and _has_nan(buffer):
            where = np.isnan(np.asarray(buffer))
            where = np.asarray(where.reshape(*where.shape[:2], -1).any(axis=-1))
            refuse(name, where, "NaN", 'pass jaxblur.finite_frame(frame, "ignore")[0]')


def refuse_nan_motion_of_any(frames: Any) -> None:
    """`refuse_nan_motion` for frames that are stacked on a leading axis.

    Args:
        frames: a `jaxblur.Frame` whose buffers have that axis.

    Raises:
        ValueError: there is NaN; it names the first frame that has it.
    """
    buffers = [getattr(frames, name) for name in ("depth", "velocity", "path")]
    known = [buffer for buffer in buffers if buffer is not None and _is_known(buffer)]
    if not any(map(_has_nan, known)):
        return
    for number in range(len(frames.color)):
        try:
            refuse_nan_motion(jax.tree.map(lambda buffer, k=number: buffer[k], frames))
        except ValueError as error:
            raise ValueError(f"frame {number} of `frames`: {error}") from None


def _is_known(buffer: object) -> bool:
    """Whether the values of a buffer can be read here."""
    if isinstance(buffer, jax.Array):
        return not isinstance(buffer, core.Tracer) and buffer.is_fully_addressable
    return isinstance(buffer, np.ndarray)


def _has_nan(buffer: Any) -> bool:
    if not buffer.size:
        return False
    if isinstance(buffer, jax.Array) and any(d.platform != "cpu" for d in buffer.devices()):
        # On the device; also while something else is traced.
        with jax.ensure_compile_time_eval():
            return bool(jax.numpy.isnan(buffer).any())
    # A minimum is NaN if anything is, and needs no second array.
    return bool(np.isnan(np.asarray(buffer).min()))
