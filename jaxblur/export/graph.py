"""The passes of a filter, what each of them reads and writes, and what lies between them.

The whole filter is traced once, with every pass as one equation (`passes_as_equations`). What lies
between the passes, such as the clamp of velocities in `pixel_velocity`, becomes passes of its own
(`.between`), so that a target prints passes and nothing else.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core

from ..filters import FilterInfo, Parameters
from ..frame import Frame
from ..kernels import Pass, passes_as_equations
from ..kernels.inlining import opened
from ..kernels.passes import pass_primitive
from ..kernels.tracing import trace
from ..noise import Noise
from ..settings import Settings
from .between import Between, Number, number_of
from .names import Names
from .noise import tap_noise, tile_noise

HEIGHT, WIDTH = 5003, 20011
"""Rows and columns while a filter is traced: primes that no number of channels is equal to."""

LARGEST_RADIUS = 2000
"""Larger tiles could not be told from one another at those sizes."""

_IDENTITY = {"stop_gradient", "copy", "copy_p", "optimization_barrier"}
_RESHAPES = {"reshape", "squeeze", "expand_dims", "broadcast_in_dim"}


class Size(NamedTuple):
    """Rows and columns of a buffer, from those of the frame.

    Attributes:
        of: the frame's, those of its tiles, or so many frames below one another.
        factor: side of a tile, or number of frames.
    """

    of: Literal["frame", "tiles", "stack"]
    factor: int = 1


@dataclasses.dataclass(eq=False)
class Buffer:
    """An image that passes read or write, row-major, channels together.

    Attributes:
        name: of it, unique in its graph.
        dtype: name of its type.
        channels: values of a pixel.
        size: rows and columns.
        role: an input of the filter, its output, or something between.
    """

    name: str
    dtype: str
    channels: int
    size: Size
    role: Literal["input", "work", "output"] = "work"

    def elements(self, height: int, width: int) -> int:
        """The number of its elements for a frame."""
        rows, columns = self.rows_and_columns(height, width)
        return rows * columns * self.channels

    def rows_and_columns(self, height: int, width: int) -> tuple[int, int]:
        """Its size for a frame."""
        if self.size.of == "tiles":
            return -(-height // self.size.factor), -(-width // self.size.factor)
        return height * self.size.factor, width


class View(NamedTuple):
    """A buffer as a pass reads it, and its size as the pass knows it."""

    buffer: Buffer
    size: Size


@dataclasses.dataclass(frozen=True, eq=False)
class Node:
    """A pass and its operands.

    Attributes:
        name: of it, unique in its graph.
        run: the pass.
        inputs: in the order of ``run.names``: views of buffers and numbers.
        kept: the image that pixels keep which the program leaves out; None if there is none.
        output: what it writes.
        size: of the grid on which it runs.
        text: what it does, as its docstring says.
    """

    name: str
    run: Pass
    inputs: tuple[View | Number, ...]
    kept: Buffer | None
    output: Buffer
    size: Size
    text: str

    @property
    def images(self) -> list[Buffer]:
        """The buffers among its inputs."""
        return [operand.buffer for operand in self.inputs if isinstance(operand, View)]


@dataclasses.dataclass(frozen=True, eq=False)
class Graph:
    """A filter as passes.

    Attributes:
        filter: its record.
        settings: that are fixed.
        parameters: name and default of each uniform.
        channels: of color.
        buffers: all, inputs first, output last.
        nodes: the passes in their order.
    """

    filter: FilterInfo
    settings: Settings
    parameters: dict[str, float]
    channels: int
    buffers: list[Buffer]
    nodes: list[Node]

    @property
    def inputs(self) -> list[Buffer]:
        """Buffers that the caller fills."""
        return [buffer for buffer in self.buffers if buffer.role == "input"]

    @property
    def work(self) -> list[Buffer]:
        """Buffers between passes."""
        return [buffer for buffer in self.buffers if buffer.role == "work"]

    @property
    def output(self) -> Buffer:
        """The blurred color."""
        return self.nodes[-1].output


def graph_of(
    info: FilterInfo,
    parameters: Parameters | None = None,
    settings: Settings | None = None,
    *,
    channels: int = 4,
    has_path: bool = False,
) -> Graph:
    """Trace a filter as passes.

    Args:
        info: the filter.
        parameters: as the filter takes them; their values become defaults. None for its own.
        settings: of the filter; None for its own.
        channels: of color.
        has_path: whether frames have curved paths.

    Returns:
        The passes.

    Raises:
        ValueError: ``fetch="blend"``, the radius is too large, channels are below 1, or what lies
            between two passes has no form of its own.
    """
    settings = info.settings if settings is None else settings
    if settings.fetch == "blend":
        raise ValueError(
            "`fetch` must be nearest or bilinear to be exported, got 'blend': its mix of four "
            "results has no printed form yet."
        )
    if settings.radius > LARGEST_RADIUS:
        raise ValueError(
            f"`radius` must be at most {LARGEST_RADIUS} to be exported, got {settings.radius}."
        )
    if channels < 1:
        raise ValueError(f"`channels` must be at least 1, got {channels}.")
    if info.check is not None:
        info.check(settings)
    values = info.checked_parameters(parameters)
    names = list(info.parameter_infos)
    defaults = {name: float(getattr(values, name)) for name in names}

    def plane(*more: int) -> jax.ShapeDtypeStruct:
        return jax.ShapeDtypeStruct((HEIGHT, WIDTH, *more), jnp.float32)

    fields = {"color": plane(channels), "depth": plane(), "velocity": plane(2)}
    fields |= {"path": plane(2, 2)} if has_path else {}
    if settings.noise != "none":
        fields |= {"noise_tap": plane(), "noise_tile": plane(2)}
    scalars = [jax.ShapeDtypeStruct((), jnp.float32)] * len(names)

    def run(planes: dict[str, Any], numbers: list[Any]) -> jax.Array:
        noise = None
        if "noise_tap" in planes:
            noise = Noise(planes["noise_tap"], planes["noise_tile"])
        frame = Frame(planes["color"], planes["depth"], planes["velocity"], planes.get("path"))
        given = info.make_parameters(**dict(zip(names, numbers, strict=True)))
        return info.call(frame, given, settings=settings, noise=noise)

    with passes_as_equations():
        closed = jax.make_jaxpr(lambda p, n: run(dict(zip(fields, p, strict=True)), n))(
            list(fields.values()), scalars
        )
    return _Builder(info, settings, defaults, channels, list(fields)).build(closed)


class Wire:
    """A value between equations, unlike a variable of a jaxpr different in each call of it."""

    def __init__(self, aval: Any) -> None:
        self.shape, self.dtype = tuple(aval.shape), np.dtype(aval.dtype)


class Step(NamedTuple):
    """An equation."""

    primitive: Any
    params: dict[str, Any]
    inputs: list[Any]
    outputs: list[Wire]


class _Builder:
    """A graph that is being built."""

    def __init__(
        self,
        info: FilterInfo,
        settings: Settings,
        defaults: dict[str, float],
        channels: int,
        fields: list[str],
    ) -> None:
        self.info, self.settings, self.defaults = info, settings, defaults
        self.channels, self.fields = channels, fields
        self.made_by: dict[Wire, Step] = {}
        self.buffers: dict[Wire, Buffer] = {}
        self.numbers: dict[Wire, str] = {}
        self.nodes: list[Node] = []
        self.sizes = {(HEIGHT, WIDTH): Size("frame")}

    def build(self, closed: Any) -> Graph:
        """The graph of a traced filter."""
        wires = [Wire(variable.aval) for variable in closed.jaxpr.invars]
        inputs: list[Buffer] = []
        for name, wire in zip(self.fields, wires, strict=False):
            channels = math.prod(wire.shape[2:])
            buffer = Buffer(name, "float32", channels, Size("frame"), "input")
            self.buffers[wire] = buffer
            inputs.append(buffer)
        self.numbers = dict(zip(wires[len(self.fields) :], self.defaults, strict=True))
        (result,) = self._flattened(closed.jaxpr, closed.consts, wires)
        output = self._buffer_of(result, "blurred")
        if output.role == "input":
            raise ValueError(f"{self.info.name} returns an input; there is nothing to export.")
        output.role, output.name = "output", "blurred"
        inputs = self._with_noise(inputs)
        used = {buffer for node in self.nodes for buffer in node.images}
        used |= {node.kept for node in self.nodes if node.kept is not None}
        work = [node.output for node in self.nodes if node.output is not output]
        buffers = [*(b for b in inputs if b in used), *work, output]
        _make_unique(buffers)
        names = Names()
        self.nodes = [dataclasses.replace(n, name=names.new(n.name)) for n in self.nodes]
        return Graph(self.info, self.settings, self.defaults, self.channels, buffers, self.nodes)

    def _with_noise(self, inputs: list[Buffer]) -> list[Buffer]:
        """Built-in noise becomes passes; other noise stays an input."""
        if self.settings.noise != "ign":
            return inputs
        left = []
        for buffer in inputs:
            program = {"noise_tap": tap_noise, "noise_tile": tile_noise}.get(buffer.name)
            if program is None:
                left.append(buffer)
                continue
            if not any(buffer in node.images for node in self.nodes):
                continue
            buffer.role = "work"
            traced = trace(program, (), None, None)
            text = _first_paragraph(program.__doc__)
            run = Pass("pixel", traced, program=program)
            self.nodes.insert(0, Node(program.__name__, run, (), None, buffer, buffer.size, text))
        return left

    def _flattened(self, jaxpr: Any, constants: Sequence[Any], inputs: Sequence[Any]) -> list[Any]:
        """Walk through the equations, calls inlined; the results."""
        known: dict[Any, Any] = dict(zip(jaxpr.constvars, map(np.asarray, constants), strict=True))
        known |= zip(jaxpr.invars, inputs, strict=True)

        def look(atom: Any) -> Any:
            if isinstance(atom, core.Literal):
                return np.asarray(atom.val, getattr(atom.aval, "dtype", None))
            return known[atom]

        for equation in jaxpr.eqns:
            found = [look(atom) for atom in equation.invars]
            inner, operands = _called(equation, found)
            if inner is not None:
                results = self._flattened(*opened(inner), operands)
            elif equation.primitive.name in _IDENTITY:
                results = found
            else:
                results = [Wire(variable.aval) for variable in equation.outvars]
                step = Step(equation.primitive, equation.params, found, results)
                self.made_by |= dict.fromkeys(results, step)
                if equation.primitive is pass_primitive:
                    self._add_pass(step)
            known.update(zip(equation.outvars, results, strict=True))
        return [look(atom) for atom in jaxpr.outvars]

    def _add_pass(self, step: Step) -> None:
        """Add a pass, and before it what its operands need."""
        run: Pass = step.params["run"]
        (result,) = step.outputs
        size = self._size_of_result(run, result.shape, step)
        inputs: list[View | Number] = []
        sizes = iter(("height", "width") if run.kind == "tiles" else ())
        operands = list(step.inputs)
        kept = operands.pop() if len(operands) > len(run.names) else None
        for kind, name, operand in zip(run.traced.kinds, run.names, operands, strict=True):
            short = name or "image"
            if not kind.channels:
                size_name = next(sizes, None)
                number = Number(size_name) if size_name else number_of(operand, self._look())
                inputs.append(number)
                continue
            view_size = self._size(operand.shape[:2])
            inputs.append(View(self._buffer_of(operand, short, run), view_size))
        kept_buffer = None if kept is None else self._kept(kept, run)
        name = run.traced.name if run.kind != "tiles" else f"{_name_of(run.program)}_of_tiles"
        marks = run.kind == "marks"
        buffer = Buffer(
            name,
            "int32" if marks else run.traced.results[0],
            1 if marks else result.shape[-1],
            size,
        )
        self.buffers[result] = buffer
        grid = Size("frame") if marks else size
        text = _first_paragraph(getattr(run.program, "__doc__", None))
        if run.kind == "tiles":
            text += " Kept is the pixel of each tile where this is largest; at a tie the first."
        node = Node(name, run, tuple(inputs), kept_buffer, buffer, grid, text)
        self.nodes.append(node)

    def _size_of_result(self, run: Pass, shape: tuple[int, ...], step: Step) -> Size:
        if run.kind == "tiles":
            self.sizes.setdefault((shape[0], shape[1]), Size("tiles", run.side))
        if run.kind == "marks":
            count = shape[0] // (HEIGHT * WIDTH)
            if count * HEIGHT * WIDTH != shape[0]:
                raise ValueError(f"`{run.traced.name}` leaves marks in a table that is no image.")
            return Size("stack", count) if count > 1 else Size("frame")
        return self._size(shape[:2])

    def _size(self, shape: tuple[int, ...]) -> Size:
        if shape in self.sizes:
            return self.sizes[shape[0], shape[1]]
        if shape[1] == WIDTH and shape[0] % HEIGHT == 0:
            return Size("stack", shape[0] // HEIGHT)
        raise ValueError(f"a buffer of {shape} at a frame of {HEIGHT, WIDTH} has no known size.")

    def _look(self) -> Callable[[Wire], Any]:
        """From a wire to the name of the number it is, or the step that makes it."""
        return lambda wire: self.numbers.get(wire) or self.made_by[wire]

    def _whole(self, wire: Any) -> Any:
        """The wire that holds the same elements in the same order, as early as possible."""
        while isinstance(wire, Wire) and wire not in self.buffers:
            step = self.made_by.get(wire)
            if step is None:
                break
            name, source = step.primitive.name, step.inputs[0] if step.inputs else None
            if not isinstance(source, Wire):
                break
            if name in _RESHAPES and math.prod(source.shape) == math.prod(wire.shape):
                wire = source
                continue
            before = self.made_by.get(source)
            if name == "transpose" and before and before.primitive.name == "transpose":
                first, second = before.params["permutation"], step.params["permutation"]
                if [first[k] for k in second] == list(range(len(second))):
                    wire = before.inputs[0]
                    continue
            break
        return wire

    def _found(self, wire: Any) -> Buffer | None:
        """The buffer that a wire is in, if there is one."""
        return self.buffers.get(self._whole(wire))

    def _buffer_of(self, wire: Any, name: str, run: Pass | None = None) -> Buffer:
        """The buffer of a wire; a pass that fills it is added if there is none yet."""
        whole = self._whole(wire)
        if isinstance(whole, Wire) and whole in self.buffers:
            buffer = self.buffers[whole]
            if buffer.role == "work" and buffer.name in {n.name for n in self.nodes}:
                buffer.name = name
            return buffer
        size = self._size(wire.shape[:2])
        between = Between(wire, self._look(), self._found, HEIGHT, WIDTH, f"make_{name}")
        traced, sources, numbers = between.traced()
        for source in sources:
            if source.size != size:
                raise ValueError(f"what makes `{name}` mixes images of several sizes.")
        inputs = (*(View(source, source.size) for source in sources), *numbers)
        names = (*(source.name for source in sources), *between.number_names)
        buffer = Buffer(name, traced.results[0], len(traced.results), size)
        of = f" of `{run.traced.name}`" if run is not None else ""
        text = f"Between passes: the image `{name}`{of}."
        made = Pass("pixel", traced, names=names)
        self.nodes.append(Node(f"make_{name}", made, inputs, None, buffer, size, text))
        self.buffers |= {wire: buffer, whole: buffer}
        return buffer

    def _kept(self, wire: Any, run: Pass) -> Buffer | None:
        """The image that pixels keep; None for one of zeros."""
        whole = self._whole(wire)
        step = self.made_by.get(whole) if isinstance(whole, Wire) else None
        if step is not None and step.primitive.name == "broadcast_in_dim":
            value = step.inputs[0]
            if not isinstance(value, Wire) and not np.any(value):
                return None
        return self._buffer_of(wire, "kept", run)


def _called(equation: Any, operands: list[Any]) -> tuple[Any, list[Any]]:
    """The jaxpr that an equation calls with its operands, if it does nothing else."""
    name, params = equation.primitive.name, equation.params
    if name in ("jit", "pjit", "closed_call", "core_call", "custom_jvp_call", "custom_vjp_call"):
        inner = params.get("jaxpr") or params.get("call_jaxpr") or params.get("fun_jaxpr")
        return inner, operands
    if name == "cond":
        # A conditional between passes is a shortcut, see `cond_of_values`.
        usual = [branch for branch in params["branches"] if _has_pass(opened(branch)[0])]
        if len(usual) != 1:
            raise ValueError("a filter with a conditional other than `cond_of_values`.")
        return usual[0], operands[1:]
    return None, []


def _has_pass(jaxpr: Any) -> bool:
    for equation in jaxpr.eqns:
        if equation.primitive is pass_primitive:
            return True
        for value in equation.params.values():
            for one in value if isinstance(value, tuple | list) else (value,):
                if isinstance(one, core.Jaxpr | core.ClosedJaxpr) and _has_pass(opened(one)[0]):
                    return True
    return False


def _name_of(program: Any) -> str:
    return getattr(program, "__name__", type(program).__name__)


def _first_paragraph(text: str | None) -> str:
    return " ".join((text or "").strip().split("\n\n")[0].split()).replace("``", "`")


def _make_unique(buffers: list[Buffer]) -> None:
    seen: dict[str, int] = {}
    for buffer in buffers:
        seen[buffer.name] = seen.get(buffer.name, 0) + 1
        if seen[buffer.name] > 1:
            buffer.name = f"{buffer.name}_{seen[buffer.name]}"
