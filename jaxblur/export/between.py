"""What a filter does between its passes, made into programs of one pixel.

Arrays of a traced filter have the axes of the frame among theirs. A program of one pixel has the
same arrays with a single element along those axes, NumPy arrays of traced scalars.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..kernels import At, Image, Outcome
from ..kernels.planes import ELEMENTWISE
from ..kernels.tracing import Traced, trace


class Boxed:
    """A traced scalar in a NumPy array, which would take it for an array."""

    def __init__(self, value: Any) -> None:
        self.value = value


class Number(NamedTuple):
    """A number that a pass gets.

    Attributes:
        name: of a parameter, or ``height`` or ``width``; None if it follows from parameters.
        jaxpr: from the parameters in ``of`` to the number, if it has no name.
        of: names of parameters.
    """

    name: str | None
    jaxpr: Any = None
    of: tuple[str, ...] = ()


def number_of(wire: Any, look: Callable[[Any], Any]) -> Number:
    """A number that a pass gets, from the parameters of the filter.

    Args:
        wire: it, or its value.
        look: from a wire to the name of a parameter, or to the step that makes it.

    Returns:
        How to find it.
    """
    names: list[str] = []
    _collect_numbers(wire, look, names)
    if hasattr(wire, "shape") and not isinstance(wire, np.ndarray) and names:
        found = look(wire)
        if isinstance(found, str):
            return Number(found)

    def run(*values: Any) -> Any:
        known = dict(zip(names, values, strict=True))
        found = _evaluate(wire, look, lambda w: known.get(look(w)) if _named(w, look) else None)
        return found.item().value

    closed = jax.make_jaxpr(run)(*[jax.ShapeDtypeStruct((), jnp.float32)] * len(names))
    return Number(None, closed, tuple(names))


def _named(wire: Any, look: Callable[[Any], Any]) -> bool:
    return isinstance(look(wire), str)


def _collect_numbers(wire: Any, look: Callable[[Any], Any], names: list[str]) -> None:
    if isinstance(wire, np.ndarray):
        return
    found = look(wire)
    if isinstance(found, str):
        if found not in names:
            names.append(found)
        return
    for source in found.inputs:
        _collect_numbers(source, look, names)


class Between:
    """The program of one pixel that computes an image from others.

    Attributes:
        number_names: names of the numbers that it gets.
    """

    def __init__(
        self,
        wire: Any,
        look: Callable[[Any], Any],
        buffer_of: Callable[[Any], Any],
        height: int,
        width: int,
        name: str,
    ) -> None:
        """Find out what the image depends on.

        Args:
            wire: the image.
            look: see `number_of`.
            buffer_of: the buffer that holds a wire's elements in their order, or None.
            height: rows of the frame while it is traced.
            width: columns of the frame while it is traced.
            name: of the program.
        """
        self._wire, self._look, self._buffer_of = wire, look, buffer_of
        self._size = height, width
        self._name = name
        self._sources: list[Any] = []
        self.number_names: list[str] = []
        self._collect(wire, set())

    def _collect(self, wire: Any, seen: set[Any]) -> None:
        if isinstance(wire, np.ndarray) or wire in seen:
            return
        seen.add(wire)
        if self._buffer_of(wire) is not None:
            self._sources.append(wire)
            return
        found = self._look(wire)
        if isinstance(found, str):
            if found not in self.number_names:
                self.number_names.append(found)
            return
        for source in found.inputs:
            self._collect(source, seen)

    def traced(self) -> tuple[Traced, list[Any], list[Number]]:
        """The trace of the program, the buffers that it reads, and the numbers that it gets."""

        def program(at: At, images: Any, numbers: Any, _: None) -> Outcome:
            known: dict[Any, Any] = {}
            for wire, image in zip(self._sources, images, strict=True):
                values = np.empty(len(image.here()), object)
                values[:] = list(map(Boxed, image.here()))
                known[wire] = values.reshape(collapsed(wire.shape, self._size))
            named = dict(zip(self.number_names, numbers, strict=True))

            def find(wire: Any) -> Any:
                if wire in known:
                    return known[wire]
                found = self._look(wire)
                return named[found] if isinstance(found, str) else None

            values = _evaluate(self._wire, self._look, find, at, self._size)
            return Outcome(tuple(jnp.asarray(box.value) for box in values.reshape(-1)))

        program.__name__ = self._name
        buffers = [self._buffer_of(wire) for wire in self._sources]
        images = tuple(Image(jnp.zeros((1, 1, b.channels), b.dtype)) for b in buffers)
        numbers = tuple(jnp.float32(0) for _ in self.number_names)
        return trace(program, images, numbers, None), buffers, list(map(Number, self.number_names))


def collapsed(shape: Sequence[int], size: tuple[int, int]) -> tuple[int, ...]:
    """A shape with one element along the axes of the frame."""
    return tuple(1 if side in size else side for side in shape)


def _evaluate(
    wire: Any,
    look: Callable[[Any], Any],
    find: Callable[[Any], Any],
    at: At | None = None,
    size: tuple[int, int] = (0, 0),
) -> np.ndarray:
    """An array of the trace at one pixel.

    Args:
        wire: the array.
        look: see `number_of`.
        find: the values of a wire that is known, or None.
        at: the pixel.
        size: of the frame while it is traced.

    Returns:
        Traced scalars.
    """
    done: dict[Any, np.ndarray] = {}

    def value(one: Any) -> np.ndarray:
        if isinstance(one, np.ndarray):
            if one.size != 1:
                raise ValueError(f"a constant of shape {one.shape} between passes; pass an image.")
            return _boxed(one.reshape(()))
        if one not in done:
            known = find(one)
            if known is not None:
                done[one] = known if isinstance(known, np.ndarray) else _boxed(known)
            else:
                step = look(one)
                inputs = [value(source) for source in step.inputs]
                part = step.outputs.index(one)
                done[one] = _apply(step, part, inputs, collapsed(one.shape, size), at, size)
        return done[one]

    return value(wire)


def _boxed(scalar: Any) -> np.ndarray:
    box = np.empty((), object)
    box[()] = Boxed(scalar)
    return box


def _apply(
    step: Any,
    part: int,
    inputs: list[np.ndarray],
    shape: tuple[int, ...],
    at: At | None,
    size: tuple[int, int],
) -> np.ndarray:
    """One of the results of an equation, on arrays of traced scalars."""
    name, params = step.primitive.name, step.params
    if name in ELEMENTWISE:
        return _elementwise(step.primitive, params, inputs, shape)
    if name in _MOVES and not (name in _CUTS and step.inputs[0].shape[params["axis"]] in size):
        return _MOVES[name](inputs, params, shape, part)
    if name == "slice":
        return _slice(step, inputs[0], size)
    if name == "iota" and at is not None:
        return _iota(step, at, size, shape)
    if name == "reduce_sum":
        if any(step.inputs[0].shape[axis] in size for axis in params["axes"]):
            raise ValueError("a sum over a frame between passes; compute it in `each_pixel`.")
        return _boxed_sum(inputs[0], tuple(params["axes"]), shape)
    raise ValueError(
        f"the operation {name} between passes has no printed form; compute it in `each_pixel`."
    )


def _reshaped(inputs: list[np.ndarray], _: Any, shape: tuple[int, ...], __: int) -> np.ndarray:
    if inputs[0].size != np.prod(shape):
        raise ValueError("a reshape of a frame's rows and columns between passes.")
    return inputs[0].reshape(shape)


def _broadcast(inputs: list[np.ndarray], params: Any, shape: Any, _: int) -> np.ndarray:
    sides = [1] * len(shape)
    for axis, side in zip(params["broadcast_dimensions"], inputs[0].shape, strict=True):
        sides[axis] = side
    return np.broadcast_to(inputs[0].reshape(sides), shape)


def _part_of_split(inputs: list[np.ndarray], params: Any, _: Any, part: int) -> np.ndarray:
    ends = np.cumsum(params["sizes"])[:-1]
    return np.split(inputs[0], ends, axis=params["axis"])[part]


_MOVES: dict[str, Callable[..., np.ndarray]] = {
    "reshape": _reshaped,
    "squeeze": _reshaped,
    "expand_dims": _reshaped,
    "broadcast_in_dim": _broadcast,
    "transpose": lambda inputs, params, *_: np.transpose(inputs[0], params["permutation"]),
    "concatenate": lambda inputs, params, *_: np.concatenate(inputs, axis=params["dimension"]),
    "stack": lambda inputs, params, *_: np.stack(inputs, axis=params["axis"]),
    "unstack": lambda inputs, params, _, part: np.moveaxis(inputs[0], params["axis"], 0)[part],
    "split": _part_of_split,
}
"""Operations that move values without changing them."""

_CUTS = ("unstack", "split")


def _slice(step: Any, values: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    whole, params = step.inputs[0].shape, step.params
    starts, limits = params["start_indices"], params["limit_indices"]
    strides = params["strides"] or (1,) * len(whole)
    cuts = []
    for side, start, limit, stride in zip(whole, starts, limits, strides, strict=True):
        if side in size and (start, limit, stride) != (0, side, 1):
            raise ValueError("a part of a frame between passes; compute it in `each_pixel`.")
        cuts.append(slice(None) if side in size else slice(start, limit, stride))
    return values[tuple(cuts)]


def _elementwise(
    primitive: Any, params: Any, inputs: list[np.ndarray], shape: tuple[int, ...]
) -> np.ndarray:
    result = np.empty(shape, object)
    for place, values in zip(
        np.ndindex(*shape),
        zip(*(array.reshape(-1) for array in np.broadcast_arrays(*inputs)), strict=True),
        strict=True,
    ):
        result[place] = Boxed(primitive.bind(*(jnp.asarray(box.value) for box in values), **params))
    return result


def _iota(step: Any, at: At, size: tuple[int, int], shape: tuple[int, ...]) -> np.ndarray:
    side = step.outputs[0].shape[step.params["dimension"]]
    if side not in size:
        raise ValueError("an iota along channels between passes.")
    result = np.empty(shape, object)
    place = at.row if side == size[0] else at.column
    result.fill(Boxed(place.astype(step.params["dtype"])))
    return result


def _boxed_sum(values: np.ndarray, axes: tuple[int, ...], shape: tuple[int, ...]) -> np.ndarray:
    result = np.empty(shape, object)
    moved = np.moveaxis(values, axes, range(len(axes)))
    moved = moved.reshape(-1, *moved.shape[len(axes) :])
    for place in np.ndindex(*shape):
        terms = [box.value for box in moved[(slice(None), *place)]]
        result[place] = Boxed(functools.reduce(jnp.add, terms))
    return result
