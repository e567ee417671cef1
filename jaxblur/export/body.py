"""The statements of a pass, the same for all languages but for the dialect and the host."""

from typing import NamedTuple, Protocol

from jax.extend import core

from ..kernels.program import marks_primitive
from .between import Number
from .expressions import ATOM, PRODUCT, SUM, Dialect, NotExpressible, Value
from .graph import Buffer, Node, Size, View
from .names import Names
from .printer import Printer, Table, needed_for


class Host(Protocol):
    """What a language does around the arithmetic.

    Attributes:
        dialect: of the expressions.
        leave: the statement that ends the work on a pixel.
        taken: names that no variable may have; if there are any, buffers keep their own names,
            otherwise they have those of the program.
    """

    dialect: Dialect
    leave: str
    taken: tuple[str, ...]

    def read(self, table: Table, index: Value) -> str:
        """The text of a read of a buffer."""
        ...

    def store(self, node: Node, channel: int, code: str) -> str:
        """A statement that writes a channel of the pixel."""
        ...

    def mark(self, node: Node, place: str, mark: str) -> str:
        """A statement that keeps the larger of a mark and what is at its place."""
        ...

    def parameter(self, name: str) -> str:
        """The text of a uniform."""
        ...


class Binding(NamedTuple):
    """A buffer that a pass reads, under its name there."""

    name: str
    buffer: Buffer


class Body(NamedTuple):
    """A printed pass.

    Attributes:
        head: statements about sizes and numbers, the same for all pixels.
        pixel: statements of a pixel, in which ``row``, ``column`` and ``pixel_index`` are known.
        bindings: buffers that it reads.
    """

    head: list[str]
    pixel: list[str]
    bindings: list[Binding]


GLOBAL = ("row", "column", "pixel_index", "height", "width", "rows", "columns", "parameters")


def bindings_of(node: Node, names: Names | None = None) -> dict[Buffer, str]:
    """The buffers that a pass reads, with the names that its program has for them, or their own."""

    def name_of(wanted: str, buffer: Buffer) -> str:
        return buffer.name if names is None else names.new(wanted)

    found: dict[Buffer, str] = {}
    for k, (name, operand) in enumerate(zip(node.run.names, node.inputs, strict=True)):
        used = k in node.run.traced.local or k in node.run.traced.tables
        if isinstance(operand, View) and used and operand.buffer not in found:
            found[operand.buffer] = name_of(name, operand.buffer)
    if node.kept is not None and node.run.traced.keeps and node.kept not in found:
        found[node.kept] = name_of("kept", node.kept)
    return found


def write_body(node: Node, host: Host, depth: int, step: str = "") -> Body:
    """Print a pass.

    Args:
        node: the pass.
        host: the language.
        depth: of the indentation of a pixel's statements.
        step: the number of the one mark that is written, of a pass that leaves marks; all if empty.

    Returns:
        Its text.

    Raises:
        NotExpressible: the language has no form for something in it.
    """
    names = Names((*GLOBAL, node.output.name, *host.taken))
    bound = bindings_of(node, None if host.taken else names)
    head = Printer(host.dialect, names, host.read, 1)
    sizes = _Sizes(head)
    for name, axis in (("rows", "height"), ("columns", "width")):
        value = sizes.of(node.size, axis)
        pattern, kind = host.dialect.constant, host.dialect.type_of("int32")
        head.add(pattern.format(type=kind, name=name, value=value.code))
    printer = Printer(host.dialect, names, host.read, depth, node.run.traced.name)
    jaxpr = node.run.traced.jaxpr
    inputs: list[Value | Table] = [Value("row", "int32"), Value("column", "int32")]
    own = []
    pixel = Value("pixel_index", "int32")
    needed = needed_for(jaxpr.eqns, jaxpr.outvars)
    used = {v for e in needed for v in map(id, e.invars)} | set(map(id, jaxpr.outvars))
    for kind, name, operand in zip(node.run.traced.kinds, node.run.names, node.inputs, strict=True):
        if isinstance(operand, Number):
            variable = jaxpr.invars[len(inputs)]
            inputs.append(_number(operand, name, head, host, id(variable) in used))
            continue
        table = Table(bound.get(operand.buffer, "unused"), kind.channels, kind.dtype)
        inputs.append(table)
        for axis in ("height", "width"):
            known = id(jaxpr.invars[len(inputs)]) in used
            inputs.append(sizes.of(operand.size, axis) if known else pixel)
        for channel in range(kind.channels):
            variable = jaxpr.invars[len(inputs)]
            if id(variable) in used:
                code = host.read(table, index_of(pixel, kind.channels, channel))
                value = Value(code, kind.dtype)
                own.append((variable, value, f"own_{_channel_name(table, channel)}"))
            inputs.append(pixel)
    printer.unnamed = node.output.name if node.name.startswith("make_") else "value"
    printer.begin(jaxpr, inputs, own)
    _write_outcome(node, host, printer, bound, step)
    return Body(head.lines, printer.lines, [Binding(n, b) for b, n in bound.items()])


def index_of(pixel: Value, channels: int, channel: int) -> Value:
    """The place of a channel of a pixel."""
    code = pixel.code if channels == 1 else f"{channels} * {pixel.code}"
    code = f"{code} + {channel}" if channel else code
    return Value(code, "int32", SUM, place=(pixel, channels, channel))


def _channel_name(table: Table, channel: int) -> str:
    letters = {1: ("",), 2: ("_x", "_y"), 3: ("_r", "_g", "_b"), 4: ("_r", "_g", "_b", "_a")}
    known = letters.get(table.channels)
    if known is None or (table.channels > 2 and "color" not in table.name):
        return f"{table.name}_{channel}"
    return f"{table.name}{known[channel]}"


class _Sizes:
    """Sizes of buffers as values, those of tiles computed once."""

    def __init__(self, head: Printer) -> None:
        self._head = head
        self._known: dict[tuple[Size, str], Value] = {}

    def of(self, size: Size, axis: str) -> Value:
        """Rows or columns, for the axis ``height`` or ``width``."""
        side = Value(axis, "int32")
        if size.of == "frame" or (size.of == "stack" and axis == "width"):
            return side
        if size.of == "stack":
            return Value(f"{size.factor} * {axis}", "int32", PRODUCT)
        if (size, axis) not in self._known:
            code = f"({axis} + {size.factor - 1}) / {size.factor}"
            name = {"height": "tile_rows", "width": "tile_columns"}[axis]
            self._known[size, axis] = self._head.define(Value(code, "int32", PRODUCT), name)
        return self._known[size, axis]


def _number(number: Number, name: str, head: Printer, host: Host, used: bool) -> Value:
    """A number that the pass gets, in a variable of its own."""
    if number.name in ("height", "width"):
        return Value(number.name, "int32")
    if not used:
        return Value("0", "float32")
    if number.name is not None:
        return head.define(Value(host.parameter(number.name), "float32"), name)
    jaxpr = number.jaxpr.jaxpr
    inputs = [Value(host.parameter(parameter), "float32") for parameter in number.of]
    head.unnamed = name
    head.begin(jaxpr, inputs)
    (value,) = head.write(jaxpr.eqns, jaxpr.outvars)
    return value if value.code.isidentifier() else head.define(value, name)


def _write_outcome(
    node: Node, host: Host, printer: Printer, bound: dict[Buffer, str], step: str
) -> None:
    """The condition, what other pixels get, and the values."""
    traced, jaxpr = node.run.traced, node.run.traced.jaxpr
    where, *rest = jaxpr.outvars
    count = len(traced.results)
    values, otherwise = rest[:count], rest[count:]
    (condition,) = printer.write(jaxpr.eqns, [where])
    always = condition.number is not None and bool(condition.number)
    if not always:
        negated = f"!{condition.within(ATOM)}"
        with printer.block(f"if ({negated}) {{"):
            if node.run.kind != "marks":
                for channel, code in enumerate(_others(node, host, printer, bound, otherwise)):
                    printer.add(host.store(node, channel, code))
            printer.add(host.leave)
    if node.run.kind == "marks":
        _write_marks(node, host, printer, step)
        return
    for channel, value in enumerate(printer.write(jaxpr.eqns, values)):
        printer.add(host.store(node, channel, host.dialect.cast(value, node.output.dtype).code))


def _others(
    node: Node, host: Host, printer: Printer, bound: dict[Buffer, str], otherwise: list
) -> list[str]:
    """Results of the pixels that the condition leaves out."""
    if otherwise:
        found = printer.write(node.run.traced.jaxpr.eqns, otherwise)
        return [value.code for value in found]
    zero = host.dialect.cast(Value("0.0", "float32"), "float32").code + host.dialect.suffix
    if node.kept is None:
        return [zero] * node.output.channels
    pixel, channels = Value("pixel_index", "int32"), node.kept.channels
    table = Table(bound[node.kept], channels, node.kept.dtype)
    return [
        host.read(table, index_of(pixel, channels, k)) if k < channels else zero
        for k in range(node.output.channels)
    ]


def _write_marks(node: Node, host: Host, printer: Printer, step: str) -> None:
    jaxpr = node.run.traced.jaxpr
    (equation,) = (e for e in jaxpr.eqns if e.primitive is marks_primitive)
    made = {v for e in jaxpr.eqns for v in e.outvars}
    operands = [v for v in equation.invars if not isinstance(v, core.Literal)]
    printer.write(jaxpr.eqns, [v for v in operands if v in made])
    if equation.params["count"]:
        raise NotExpressible(f"{host.dialect.name}: marks with a fixed number of steps.")
    printer.write_marks(equation, lambda place, mark: host.mark(node, place.code, mark.code), step)
