"""Trace a program once, and cut it into stages at its sum.

The trace is a jaxpr of scalars that knows neither the size of the grid nor of any image. Other
targets than XLA and C++ start from here too.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core
from jaxtyping import Array

from .inlining import inlined
from .keys import Keyed, key_of, key_of_jaxpr
from .places import results_of
from .planes import evaluate
from .program import At, Image, Outcome, check_outcome, marks_primitive, sum_primitive
from .reads import place_primitive
from .stages import Kind, Place, Prepared, Sample, Stages, table_shape

Program = Callable[[At, Any, Any, Any], Outcome]


class UnsupportedProgram(ValueError):
    """A program does something that the engine has no stage for."""


@dataclasses.dataclass(frozen=True, eq=False)
class Traced:
    """A traced program.

    Attributes:
        name: of the program.
        jaxpr: of scalars: row, column, then for each scalar itself and for each image its table,
            rows, columns and own channels.
        kinds: of the inputs.
        local: numbers of the inputs that a pixel uses as they are.
        tables: numbers of the images that are read anywhere.
        stages: the program cut at its sum.
        results: types of the results.
        keeps: whether pixels that the condition leaves out keep those of an image.
    """

    name: str
    jaxpr: Any
    kinds: tuple[Kind, ...]
    local: tuple[int, ...]
    tables: tuple[int, ...]
    stages: Stages
    results: tuple[str, ...]
    keeps: bool


def flatten(images: Any, parameters: Any) -> tuple[list[Image | jax.Array], Any]:
    """The inputs of a program one after the other, and their structure."""
    is_image = functools.partial(_is_a, Image)
    leaves, structure = jax.tree.flatten((images, parameters), is_leaf=is_image)
    return [leaf if isinstance(leaf, Image) else jnp.asarray(leaf) for leaf in leaves], structure


def _is_a(kind: type, leaf: Any) -> bool:
    return isinstance(leaf, kind)


def trace(program: Program, images: Any, parameters: Any, settings: Any) -> Traced:
    """Trace a program for inputs of these types; equal ones are traced once.

    Args:
        program: see `program`.
        images: NamedTuple of `Image`; a None stays None.
        parameters: pytree of scalars.
        settings: hashable.

    Returns:
        The trace.

    Raises:
        UnsupportedProgram: it has two sums, or uses a value where the engine cannot carry it.
        ValueError: an input is neither an image nor a scalar, or it returns no `Outcome`.
    """
    leaves, structure = flatten(images, parameters)
    kinds = tuple(_kind(leaf) for leaf in leaves)
    return _trace(program, structure, kinds, settings, jnp.result_type(float) == jnp.float64)


def _kind(leaf: Image | jax.Array) -> Kind:
    if isinstance(leaf, Image):
        return Kind(leaf.values.dtype.name, leaf.channels)
    if leaf.ndim:
        raise ValueError(
            f"an input of a program must be an Image or a scalar, got shape {leaf.shape}."
        )
    return Kind(leaf.dtype.name)


@functools.lru_cache(maxsize=512)
def _trace(
    program: Program, structure: Any, kinds: tuple[Kind, ...], settings: Any, _x64: bool
) -> Traced:
    def on_scalars(*numbers: Array) -> list[Array]:
        rest = iter(numbers)
        at = At(next(rest), next(rest))
        leaves = [_leaf(kind, rest) for kind in kinds]
        images, parameters = jax.tree.unflatten(structure, leaves)
        outcome = program(at, images, parameters, settings)
        check_outcome(outcome, name)
        where = jnp.ones((), bool) if outcome.where is None else outcome.where
        shape[:] = [len(outcome.values), outcome.otherwise is not None]
        keeps[:] = [outcome.where is not None and outcome.otherwise is None]
        return [where, *outcome.values, *(outcome.otherwise or ())]

    name = getattr(program, "__name__", type(program).__name__)
    shape: list[Any] = []
    keeps: list[bool] = []
    whole = jax.ShapeDtypeStruct((), jnp.int32)
    inputs = [whole, whole]
    for kind in kinds:
        inputs += _shapes(kind)
    jaxpr = inlined(jax.make_jaxpr(on_scalars)(*inputs))
    cut = _Cut(jaxpr, kinds, *shape)
    results = tuple(variable.aval.dtype.name for variable in cut.values)
    return Traced(name, jaxpr.jaxpr, kinds, cut.local, cut.tables, cut.stages(), results, keeps[0])


def _shapes(kind: Kind) -> list[jax.ShapeDtypeStruct]:
    scalar = jax.ShapeDtypeStruct((), kind.dtype)
    if not kind.channels:
        return [scalar]
    size = jax.ShapeDtypeStruct((), jnp.int32)
    return [table_shape(kind), size, size, *[scalar] * kind.channels]


def _leaf(kind: Kind, numbers: Any) -> Any:
    if not kind.channels:
        return next(numbers)
    table, size = next(numbers), (next(numbers), next(numbers))
    return Image.inside(table, tuple(next(numbers) for _ in range(kind.channels)), size)


class _Cut:
    """The equations of a trace by stage."""

    def __init__(self, closed: Any, kinds: Sequence[Kind], results: int, otherwise: bool) -> None:
        self.jaxpr = closed.jaxpr
        self.key = key_of_jaxpr(closed.jaxpr, closed.consts)
        if self.key is not None:
            self.key = key_of((self.key, *map(repr, kinds), results, otherwise))
        self.constants = dict(zip(self.jaxpr.constvars, closed.consts, strict=True))
        self.where, *rest = self.jaxpr.outvars
        self.values, self.otherwise = rest[:results], rest[results:] if otherwise else None
        self.made_by = {v: k for k, e in enumerate(self.jaxpr.eqns) for v in e.outvars}
        self.loop = self._find_loop()
        self._name_inputs(kinds)
        self.varying = self._find_varying()
        self._assign()

    def _find_loop(self) -> int | None:
        loops = [
            k
            for k, equation in enumerate(self.jaxpr.eqns)
            if equation.primitive in (sum_primitive, marks_primitive)
        ]
        if len(loops) > 1:
            raise UnsupportedProgram("a program may hold one `sum_over` or `mark_over`, got two.")
        return loops[0] if loops else None

    def _name_inputs(self, kinds: Sequence[Kind]) -> None:
        """Which variable is what: of the place, a scalar, a table, a channel at the pixel."""
        variables = iter(self.jaxpr.invars)
        self.place = [next(variables), next(variables)]
        self.own: list[list[Any]] = []
        self.table: list[Any] = []
        for kind in kinds:
            if not kind.channels:
                self.own.append([next(variables)])
                self.table.append(None)
                continue
            self.table.append(next(variables))
            self.place += [next(variables), next(variables)]
            self.own.append([next(variables) for _ in range(kind.channels)])
        used = self._used(range(len(self.jaxpr.eqns)))
        used |= {v for v in self.jaxpr.outvars if not _is_literal(v)}
        self.local = tuple(k for k, own in enumerate(self.own) if used & set(own))
        self.tables = tuple(k for k, table in enumerate(self.table) if table in used)

    def _find_varying(self) -> set[Any]:
        """The variables that depend on where the pixel is, or on an image there."""
        images = (o for o, t in zip(self.own, self.table, strict=True) if t is not None)
        varying = {*self.place[:2], *(variable for own in images for variable in own)}
        _add_depending(self.jaxpr.eqns, varying)
        return varying

    def _needed(self, variables: Iterable[Any], known: Iterable[Any] = ()) -> list[int]:
        """Numbers of the equations that make the variables from the known ones and the inputs."""
        known, wanted, found = set(known), list(variables), set()
        while wanted:
            variable = wanted.pop()
            if _is_literal(variable) or variable in known:
                continue
            number = self.made_by.get(variable)
            if number is not None and number not in found:
                found.add(number)
                wanted += self.jaxpr.eqns[number].invars
        return sorted(found)

    def _made(self, numbers: Iterable[int]) -> set[Any]:
        return {v for k in numbers for v in self.jaxpr.eqns[k].outvars}

    def _used(self, numbers: Iterable[int]) -> set[Any]:
        return {v for k in numbers for v in self.jaxpr.eqns[k].invars if not _is_literal(v)}

    def _assign(self) -> None:
        """Sort equations into those of the condition, before the sum, and after it."""
        eqns = self.jaxpr.eqns
        self.in_where = self._needed([self.where])
        if self.loop in self.in_where:
            raise UnsupportedProgram("`Outcome.where` must not depend on the sum.")
        known = self._made(self.in_where)
        if self.loop is None:
            self.before = self._needed(self.values, known)
            self.after: list[int] = []
            ends = self.values
        else:
            loop = eqns[self.loop]
            self.after = self._after(loop)
            ends = [*loop.invars, *self._used(self.after), *self.values]
            skip = {*loop.outvars, *self._made(self.after)}
            self.before = self._needed(
                [v for v in ends if not _is_literal(v) and v not in skip], known
            )
        self.rest = [] if self.otherwise is None else self._needed(self.otherwise, known)
        used = self._used([*self.before, *self.rest])
        used |= {v for v in [*ends, *(self.otherwise or ())] if not _is_literal(v)}
        self.found = _ordered(known & used, eqns)
        self._choose_prepared()

    def _after(self, loop: Any) -> list[int]:
        """Numbers of the equations that depend on the sums."""
        touched, numbers = set(loop.outvars), []
        for number in self._needed(self.values, loop.outvars):
            equation = self.jaxpr.eqns[number]
            if any(not _is_literal(v) and v in touched for v in equation.invars):
                touched |= set(equation.outvars)
                numbers.append(number)
        return numbers

    def _choose_prepared(self) -> None:
        """The values that lie between the stages, and how whole numbers get across."""
        if self.loop is None:
            self.prepared: list[Any] = []
            return
        loop = self.jaxpr.eqns[self.loop]
        made = self._made([*self.in_where, *self.before])
        own = {v for group in self.own for v in group}
        late = self._used(self.after) | {v for v in self.values if not _is_literal(v)}
        wanted = [v for v in loop.invars if not _is_literal(v) and (v in made or v in own)]
        wanted += _ordered(late & made, self.jaxpr.eqns)
        # Scalars get to the finish this way too, so that their derivatives are carried along.
        wanted += [
            own[0]
            for own, table in zip(self.own, self.table, strict=True)
            if table is None and own[0] in late
        ]
        self.again = [v for v in dict.fromkeys(wanted) if self._is_of_the_place(v)]
        self.prepared = [v for v in dict.fromkeys(wanted) if v not in self.again]
        for variable in self.prepared:
            if np.issubdtype(variable.aval.dtype, np.integer):
                raise UnsupportedProgram(
                    "a whole number that depends on the pixel's values is computed before the sum "
                    "and used in it or after it; compute it there, or convert it to a float."
                )
        self.repeated = self._needed(self.again)

    def _is_of_the_place(self, variable: Any) -> bool:
        """Whether a whole number depends on nothing but the place, and can be computed again."""
        if not np.issubdtype(variable.aval.dtype, np.integer):
            return False
        numbers = self._needed([variable])
        used = self._used(numbers) - self._made(numbers)
        return bool(numbers) and used <= set(self.place) | set(self.constants)

    def stages(self) -> Stages:
        """The stages as functions."""
        if self.loop is None:
            otherwise = None
            if self.otherwise is not None:
                rest = functools.partial(self._results, self.rest, self.otherwise)
                otherwise = self._keyed("otherwise", rest)
            values = functools.partial(self._results, self.before, self.values)
            return Stages(
                where=self._keyed("where", self._where),
                prepare=self._keyed("values", values),
                otherwise=otherwise,
                prepared=self._chosen(),
            )
        if self.otherwise is not None:
            raise UnsupportedProgram("`Outcome.otherwise` is for programs without a sum.")
        loop = self.jaxpr.eqns[self.loop]
        return Stages(
            where=self._keyed("where", self._where),
            prepare=self._keyed("prepare", self._prepare),
            sample=Sample(
                self._sample,
                self._key_of("sample"),
                [variable.aval.dtype.name for variable in loop.outvars],
            ),
            finish=self._keyed("finish", self._finish),
            limit=self._keyed("limit", self._limit) if loop.params["limited"] else None,
            counts=self._keyed("counts", self._counts) if loop.params.get("where") else None,
            samples=loop.params["count"],
            prepared=tuple(
                Prepared(_real(variable.aval.dtype), variable in self.varying)
                for variable in self.prepared
            ),
        )

    def _chosen(self) -> tuple[Prepared, ...]:
        """What the results of a program without a sum are."""
        pairs = [self.values] if self.otherwise is None else [self.values, self.otherwise]
        ends = [] if self.otherwise is None else [self.where]
        return tuple(
            Prepared(
                values[0].aval.dtype.name,
                any(not _is_literal(v) and v in self.varying for v in [*ends, *values]),
            )
            for values in zip(*pairs, strict=True)
        )

    def _keyed(self, stage: str, function: Callable[..., Any]) -> Keyed:
        """A stage, with the key of the program and its own name."""
        return Keyed(function, self._key_of(stage))

    def _key_of(self, stage: str) -> str | None:
        return None if self.key is None else key_of((self.key, stage))

    def _inputs(self, place: Place, local: Any, tables: Any) -> dict[Any, Any]:
        """Values of the inputs."""
        values = dict(self.constants)
        values |= zip(self.place, [place.row, place.column, *place.sizes], strict=True)
        for number, own in zip(self.local if local is not None else (), local or (), strict=True):
            values |= zip(self.own[number], own, strict=True)
        for number, table in zip(
            self.tables if tables is not None else (), tables or (), strict=True
        ):
            values[self.table[number]] = table
        return values

    def _run(self, numbers: Sequence[int], values: dict[Any, Any], wanted: Any) -> list[Any]:
        """Evaluate equations for the values of these variables."""
        return results_of([self.jaxpr.eqns[number] for number in numbers], values, wanted)

    def _where(self, place: Place, local: Any, tables: Any) -> Any:
        values = self._inputs(place, local, tables)
        where, *found = self._run(self.in_where, values, [self.where, *self.found])
        return where, found

    def _with_found(self, place: Place, local: Any, tables: Any, found: Any) -> dict[Any, Any]:
        return self._inputs(place, local, tables) | dict(zip(self.found, found, strict=True))

    def _results(
        self,
        numbers: Sequence[int],
        results: Any,
        place: Place,
        local: Any,
        tables: Any,
        found: Any,
    ) -> list[Any]:
        return self._run(numbers, self._with_found(place, local, tables, found), results)

    def _prepare(self, place: Place, local: Any, tables: Any, found: Any) -> list[Any]:
        values = self._with_found(place, local, tables, found)
        return [_as_real(value) for value in self._run(self.before, values, self.prepared)]

    def _late(self, place: Place, prepared: Any, local: Any, tables: Any) -> dict[Any, Any]:
        """Inputs of what comes after the preparation."""
        values = self._inputs(place, local, tables)
        for variable, value in zip(self.prepared, prepared, strict=True):
            values[variable] = value != 0 if variable.aval.dtype == bool else value
        return values | dict(
            zip(self.again, self._run(self.repeated, values, self.again), strict=True)
        )

    def _sample(self, index: Any, place: Place, prepared: Any, tables: Any) -> list[Any]:
        equation = self.jaxpr.eqns[self.loop or 0]
        values = self._late(place, prepared, None, tables)
        return _of_sample(equation.params["jaxpr"], equation.invars, values, index)

    def _counts(self, index: Any, place: Place, prepared: Any, tables: Any) -> Any:
        equation = self.jaxpr.eqns[self.loop or 0]
        values = self._late(place, prepared, None, tables)
        operands = equation.invars[len(equation.params["jaxpr"].constvars) :]
        (counts,) = _of_sample(equation.params["where"], operands, values, index)
        return counts

    def _limit(self, prepared: Any) -> Any:
        limit = self.jaxpr.eqns[self.loop or 0].invars[-1]
        if _is_literal(limit):
            return limit.val
        return dict(zip(self.prepared, prepared, strict=True))[limit]

    def _finish(self, place: Place, sums: Any, prepared: Any, local: Any) -> list[Any]:
        loop = self.jaxpr.eqns[self.loop or 0]
        values = self._late(place, prepared, local, None)
        values |= zip(loop.outvars, sums, strict=True)
        return self._run(self.after, values, self.values)


def _of_sample(
    inner: Any, operands: Sequence[Any], values: dict[Any, Any], index: Any
) -> list[Any]:
    """The results of a jaxpr for the number of a sample; the first operands are its constants."""
    look = evaluate([], values)
    operands = operands[: len(inner.constvars)]
    known = {v: look(o) for v, o in zip(inner.constvars, operands, strict=True)}
    return results_of(inner.eqns, known | {inner.invars[0]: index}, inner.outvars)


def _add_depending(equations: Iterable[Any], varying: set[Any]) -> None:
    """Add the variables that depend on varying ones, and refuse arrays among them."""
    for equation in equations:
        is_still = equation.primitive is place_primitive and equation.params["still"]
        if is_still or varying.isdisjoint(v for v in equation.invars if not _is_literal(v)):
            continue
        _refuse_array(equation)
        varying.update(equation.outvars)
        if equation.primitive in (sum_primitive, marks_primitive):
            inner = equation.params["jaxpr"]
            pairs = zip(inner.constvars, equation.invars, strict=False)
            _add_depending(inner.eqns, {v for v, o in pairs if not _is_literal(o) and o in varying})


def _refuse_array(equation: Any) -> None:
    """Refuse an equation that makes an array of a pixel's values."""
    shape = next((v.aval.shape for v in equation.outvars if v.aval.size != 1), None)
    if shape is not None:
        raise UnsupportedProgram(
            f"a program computes with scalars, but its operation {equation.primitive} makes an "
            f"array of shape {shape}; write the channels one by one, such as "
            "`[2 * value for value in color]`."
        )


def _is_literal(variable: Any) -> bool:
    return isinstance(variable, core.Literal)


def _ordered(variables: set[Any], equations: Sequence[Any]) -> list[Any]:
    """Variables in the order in which they are made."""
    return [v for equation in equations for v in equation.outvars if v in variables]


def _real(dtype: Any) -> str:
    """The type in which a value gets to the samples."""
    return "float32" if dtype.name == "bool" else dtype.name


def _as_real(value: Any) -> Any:
    return value.astype(jnp.float32) if value.dtype == bool else value
