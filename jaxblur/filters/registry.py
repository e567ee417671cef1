"""The registry of filters: everything that the rest of the package must know of a filter.

Loads no jax: the command line lists filters and checks parameters by it. A filter of your own is
one file that ends in `register`; it is found under its name by every function of the package once
the file is imported, by ``--filter path/to/file.py:name`` (see `load_filter`), or as an installed
plug-in: an entry point of the group ``jaxblur.filters`` that names a `FilterInfo`, or a module
that registers its filters.
"""

from __future__ import annotations

import dataclasses
import difflib
import functools
import hashlib
import importlib
import importlib.util
import inspect
import pathlib
import re
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, ClassVar, Protocol, TypeVar, cast, runtime_checkable

from ..settings import Settings
from .parameters import ParameterInfo, check_parameters_type, infos_of

if TYPE_CHECKING:
    import jax
    from jax.typing import ArrayLike

    from ..frame import Frame
    from ..noise import Noise

ENTRY_POINTS = "jaxblur.filters"
T = TypeVar("T")
_NAME = re.compile(r"[A-Za-z]\w*")

_registered: dict[str, FilterInfo] = {}


@runtime_checkable
class Parameters(Protocol):
    """Parameters of a filter: a dataclass that jax knows, such as `jaxblur.GuertinParameters`."""

    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[object]]]


@runtime_checkable
class Filter(Protocol):
    """A filter: a function of a frame that gives its blurred color, (H, W, C)."""

    def __call__(
        self,
        frame: Frame,
        parameters: object,
        *,
        settings: Settings = ...,
        noise: Noise | None = None,
    ) -> jax.Array:
        """Blur a frame."""
        ...


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class FilterInfo:
    """A filter, and what the rest of the package must know of it.

    Functions may be given as ``"module:attribute"``, which is imported on first use.

    Attributes:
        name: a Python name; `jaxblur.FILTERS` has the filter under it.
        summary: one line for the help.
        function: the filter, ``(frame, parameters, *, settings, noise=None) -> (H, W, C)``, jitted
            or at least traceable. Settings are static for `jax.jit`, without ``static_argnames``.
        parameters: a frozen dataclass registered by ``jax.tree_util.register_dataclass``, each
            field made by `jaxblur.parameter`; None if the filter has none.
        settings: the default settings. Their class says which choices the filter has: `Settings`,
            or a subclass with further ones.
        check: raises ValueError if the filter cannot run with some settings; called with them
            before anything is compiled.
        outcomes: for a filter that draws one of K outcomes at a pixel: a function of the same
            arguments that gives all of them, colors (K, H, W, C) and probabilities (K, H, W). Fits
            minimize the error expected over them.
        smooth: the differentiable form of some settings, for fits: the same result on average,
            without a random choice.
        check_fit: raises ValueError if a fit cannot determine something; called with the names of
            the free parameters, the settings, and the values that they start from.
        row_reach: how far the filter looks, a function of parameters, settings and whether the
            frame has paths: ``(alignment, reach)``, rows from one tile to the next (1 without
            tiles) and rows to either side of a tile that its result may depend on.
            `jaxblur.devices.blur_rows` needs it.
        reads_color: whether the weights depend on color. The result is then not linear in color:
            `jaxblur.show.texel_weights` rejects such a filter.
        takes_neighbors: whether the filter also takes the frames ``before`` and ``after``, each a
            `Frame` or None, and ``shutter``, the exposure in frames that relates them.
        takes_shutter: whether the filter also takes ``exposure``, a `jaxblur.Shutter` or None. The
            others know the nominal exposure alone, a box that is centered on the frame.
        takes_lens: whether the filter also takes ``lens``, a `jaxblur.posts.Lens` or None, and then
            blurs what it has out of focus too.
    """

    name: str
    summary: str
    function: Callable[..., jax.Array] | str
    parameters: type | None = None
    settings: Settings = Settings()
    check: Callable[..., None] | None = None
    outcomes: Callable[..., tuple[jax.Array, jax.Array]] | str | None = None
    smooth: Callable[..., Settings] | None = None
    check_fit: Callable[..., None] | None = None
    row_reach: Callable[..., tuple[int, int]] | None = None
    reads_color: bool = False
    takes_neighbors: bool = False
    takes_shutter: bool = False
    takes_lens: bool = False

    @functools.cached_property
    def call(self) -> Filter:
        """The filter, imported now if it was not yet; it rejects arguments of other types.

        Raises:
            ValueError: the parameters are not registered with jax.
        """
        from ._arguments import checking

        function = _resolve(self.function)
        if self.parameters is not None:
            import jax

            if jax.tree_util.all_leaves([self.parameters()]):
                raise ValueError(
                    f"`FilterInfo.parameters` of {self.name} must be known to jax; put "
                    f"@jax.tree_util.register_dataclass above {self.parameters.__name__}."
                )
        return cast("Filter", checking(function, self))

    @functools.cached_property
    def call_outcomes(self) -> Callable[..., tuple[jax.Array, jax.Array]] | None:
        """The function `outcomes`, imported now if it was not yet; None if there is none."""
        return None if self.outcomes is None else _resolve(self.outcomes)

    @property
    def kind(self) -> type[Settings]:
        """The class of the settings, which says what choices there are."""
        return type(self.settings)

    @functools.cached_property
    def parameter_infos(self) -> dict[str, ParameterInfo]:
        """The `ParameterInfo` of each parameter, by name; empty if there are none."""
        return infos_of(self.parameters)

    @property
    def defaults(self) -> dict[str, float]:
        """The default of each parameter, by name; empty if there are none."""
        return {name: float(info.default) for name, info in self.parameter_infos.items()}

    @property
    def bounds(self) -> dict[str, tuple[float, float]]:
        """Lowest and highest value of each parameter, by name; infinite where there is no end.

        The record in `parameter_infos` says whether the lowest one itself is allowed.

        Examples:
            >>> from jaxblur import filter_info
            >>> filter_info("mcguire2012").bounds
            {'soft_z_extent': (0.0, inf)}
        """
        return {name: (info.low, info.high) for name, info in self.parameter_infos.items()}

    def make_parameters(self, **values: ArrayLike) -> Parameters | None:
        """The parameters as the filter takes them.

        Args:
            **values: parameters by name; the others take their defaults.

        Returns:
            An object of the class `parameters`, or None for a filter without parameters.

        Raises:
            ValueError: there is no such parameter.
        """
        for name in values:
            if name not in self.parameter_infos:
                known = ", ".join(self.parameter_infos) or "none"
                raise ValueError(f"`{name}` must be a parameter of {self.name}; it has {known}.")
        # Loading the filter makes its parameters known to jax.
        return self.parameters(**values) if self.call and self.parameters else None

    def checked_parameters(
        self, parameters: object, argument: str = "parameters"
    ) -> Parameters | None:
        """Parameters as the filter takes them; None stands for the defaults.

        Args:
            parameters: of the class `parameters`, or None.
            argument: name of the argument, for the message.

        Returns:
            The same object, or the defaults.

        Raises:
            ValueError: they are of another class, or one of them is no number.
        """
        if parameters is None:
            return self.make_parameters()
        check_parameters_type(parameters, self.parameters, self.name, argument)
        return cast("Parameters", parameters)

    def smooth_settings(self, settings: Settings) -> Settings:
        """The differentiable form of some settings; the same ones if the filter has no other."""
        return settings if self.smooth is None else self.smooth(settings)

    def make_settings(self, **changes: object) -> Settings:
        """The default settings with changes.

        Args:
            **changes: fields of the class of `settings`.

        Returns:
            An object of that class.

        Raises:
            ValueError: there is no such choice, or a value is out of range.
        """
        known = [field.name for field in dataclasses.fields(self.settings)]
        for name in changes:
            if name not in known:
                raise ValueError(
                    f"`{name}` must be a setting of {self.name}; it has {', '.join(known)}."
                )
        return dataclasses.replace(self.settings, **changes)


def register(info: FilterInfo) -> FilterInfo:
    """Make a filter known to the package.

    Args:
        info: the filter. Registering it twice is harmless; a function that is defined again, by a
            notebook's cell or a module that is loaded again, takes the place of the former.

    Returns:
        The same object.

    Raises:
        ValueError: another filter has the name, the record is wrong, or the function lacks an
            argument that every filter has.
    """
    if not isinstance(info, FilterInfo):
        raise ValueError(f"`info` must be a jaxblur.FilterInfo, got {info!r}.")
    if not _NAME.fullmatch(info.name):
        raise ValueError(
            f"`name` must be a word of letters, digits and underscores, got {info.name!r}."
        )
    known = _registered.get(info.name)
    if known not in (None, info) and _home(known.function) != _home(info.function):
        raise ValueError(
            f"`name` must be new, but there is a filter {info.name!r}; choose another name, or "
            "call jaxblur.filters.unregister first."
        )
    for name in ("function", "outcomes"):
        value = getattr(info, name)
        if not (callable(value) or _is_reference(value) or (value is None and name == "outcomes")):
            raise ValueError(f"`{name}` must be a function or 'module:attribute', got {value!r}.")
    if callable(info.function):
        _check_signature(info)
    if not isinstance(info.settings, Settings):
        raise ValueError(f"`settings` must be a jaxblur.Settings, got {info.settings!r}.")
    if info.check is not None:
        info.check(info.settings)
    infos_of(info.parameters)
    _registered[info.name] = info
    return info


def _home(function: Callable[..., object] | str) -> str:
    """Where a function is defined, as ``module:name``."""
    if isinstance(function, str):
        return function
    name = getattr(function, "__qualname__", repr(function))
    return f"{function.__module__}:{name}"


def _check_signature(info: FilterInfo) -> None:
    """Reject a filter that lacks an argument that every filter has, or that its record promises."""
    wanted = ["settings", "noise"]
    wanted += ["before", "after", "shutter"] if info.takes_neighbors else []
    wanted += ["exposure"] if info.takes_shutter else []
    wanted += ["lens"] if info.takes_lens else []
    assert callable(info.function)
    arguments = inspect.signature(info.function).parameters
    takes_more = any(argument.kind is argument.VAR_KEYWORD for argument in arguments.values())
    lacking = [name for name in wanted if name not in arguments]
    if lacking and not takes_more:
        form = "(frame, parameters, *, settings=jaxblur.Settings(), noise=None"
        more = "".join(f", {name}=None" for name in wanted[2:])
        raise ValueError(
            f"`function` must take {' and '.join(lacking)} by name, as its record says: "
            f"{form}{more})."
        )


def unregister(name: str) -> None:
    """Forget a filter of one's own, so that its name can be registered anew.

    Args:
        name: of the filter.

    Raises:
        ValueError: there is no such filter, or it is one of the package.
    """
    from .builtin import BUILTIN

    info = filter_info(name)
    if info in BUILTIN:
        raise ValueError(f"`name` must be a filter of your own, got {name!r}.")
    del _registered[info.name]


def filter_info(filter: str | Callable[..., jax.Array]) -> FilterInfo:
    """The record of a registered filter.

    Args:
        filter: its name, or the function itself.

    Returns:
        The record that was registered.

    Raises:
        ValueError: no such filter is registered; the message lists those that are.
    """
    info = _find(filter, _registered) or _find(filter, _with_plugins())
    if info is not None:
        return info
    hint = _hint(filter) if isinstance(filter, str) else ""
    raise ValueError(
        f"`filter` must be one of {', '.join(names())}, or one of these functions, got "
        f"{filter!r}{hint}; filters of your own are made known by jaxblur.register, at the command "
        "line by --filter FILE.py:NAME."
    )


def _hint(name: str) -> str:
    """The name of a filter that is near another one, in words; empty if none is."""
    near = difflib.get_close_matches(name, names(), n=1)
    return f" (did you mean {near[0]}?)" if near else ""


def _find(
    filter: str | Callable[..., jax.Array], filters: Mapping[str, FilterInfo]
) -> FilterInfo | None:
    if isinstance(filter, str):
        return filters.get(filter)
    for info in filters.values():
        if not isinstance(info.function, str):
            known = info.function
        else:
            module, _, attribute = info.function.partition(":")
            # A function that somebody holds is of a module that is loaded.
            known = getattr(sys.modules.get(module), attribute, None)
        # `call` is there once it was asked for.
        if filter is known or filter is vars(info).get("call", known):
            return info
    return None


def names() -> tuple[str, ...]:
    """The names of all filters: those of the package, then others, plug-ins included."""
    return tuple(_with_plugins())


def load_filter(reference: str) -> FilterInfo:
    """Import a file that registers a filter.

    Args:
        reference: ``path/to/file.py:name``, the name being that of the `FilterInfo`.

    Returns:
        What the file registered under that name. A file is imported once in a process.

    Raises:
        ValueError: there is no such file, importing it fails, or it does not register the name.
    """
    path, _, name = reference.rpartition(":")
    if reference.endswith(".py"):
        path, name = reference, ""
    if not path.endswith(".py"):
        raise ValueError(f"`filter` must be a name, or path/to/file.py:name, got {reference!r}.")
    file = pathlib.Path(path).resolve()
    if not file.is_file():
        raise ValueError(f"{path}: there is no such file; give the path of a Python file.")
    module = f"_jaxblur_filter_{hashlib.sha256(str(file).encode()).hexdigest()[:16]}"
    if module not in sys.modules:
        _import_file(file, module, path)
    registered = sys.modules[module].__dict__[_REGISTERED_BY_FILE]
    if name not in registered:
        if not registered:
            raise ValueError(f"{path}: registers no filter; it must call jaxblur.register.")
        ways = " or ".join(f"{path}:{known}" for known in registered)
        lacks = f"registers no filter {name!r}" if name else "is a file, not a filter in it"
        raise ValueError(f"{path}: {lacks}; give {ways}.")
    return register(registered[name])


_REGISTERED_BY_FILE = "__jaxblur_filters__"


def _import_file(file: pathlib.Path, module: str, path: str) -> None:
    """Import a file under a name of its own, and keep in it what it registered."""
    spec = importlib.util.spec_from_file_location(module, file)
    assert spec is not None and spec.loader is not None
    loaded = importlib.util.module_from_spec(spec)
    before = dict(_registered)
    sys.modules[module] = loaded
    try:
        spec.loader.exec_module(loaded)
    except Exception as error:
        del sys.modules[module]
        for name in _registered.keys() - before.keys():
            del _registered[name]
        raise ValueError(
            f"{_last_place(error, file, path)}: cannot be imported: {type(error).__name__}: {error}"
        ) from error
    new = {name: info for name, info in _registered.items() if name not in before}
    setattr(loaded, _REGISTERED_BY_FILE, new)


def _last_place(error: Exception, file: pathlib.Path, path: str) -> str:
    """The path of a file, with the line where an error arose if it did in a function of it."""
    frames = traceback.walk_tb(error.__traceback__)
    lines = [line for frame, line in frames if frame.f_code.co_filename == str(file)]
    return f"{path}:{lines[-1]}" if lines else path


def _with_plugins() -> dict[str, FilterInfo]:
    """All filters, those of installed plug-ins among them."""
    _load_plugins()
    return _registered


@functools.cache
def _load_plugins() -> None:
    """Import installed plug-ins, once; one that fails gives a warning that names it."""
    # Not needed to run a filter of this package, and slow to import.
    from importlib.metadata import entry_points

    for point in entry_points(group=ENTRY_POINTS):
        try:
            loaded = point.load()
            if isinstance(loaded, FilterInfo):
                register(loaded)
        except Exception as error:
            source = point.dist.name if point.dist else "an unknown package"
            warnings.warn(
                f"the filter plug-in {point.name!r} of {source} ({point.value}) cannot be loaded: "
                f"{type(error).__name__}: {str(error).rstrip('.')}; update or uninstall {source}.",
                stacklevel=2,
            )


def _is_reference(value: object) -> bool:
    return isinstance(value, str) and re.fullmatch(r"[\w.]+:\w+", value) is not None


def _resolve(function: Callable[..., T] | str) -> Callable[..., T]:
    if not isinstance(function, str):
        return function
    module, _, attribute = function.partition(":")
    return getattr(importlib.import_module(module), attribute)


class _Filters(Mapping[str, Filter]):
    """The functions of all registered filters, by name; read-only, always current."""

    def __getitem__(self, name: str) -> Filter:
        known = _registered if name in _registered else _with_plugins()
        if name not in known:
            raise KeyError(f"no filter {name!r}{_hint(name)}; there are {', '.join(known)}")
        return known[name].call

    def __iter__(self) -> Iterator[str]:
        return iter(names())

    def __len__(self) -> int:
        return len(names())

    def __contains__(self, name: object) -> bool:
        return name in _registered or name in _with_plugins()

    def __repr__(self) -> str:
        return f"<filters {', '.join(self)}>"


FILTERS: Mapping[str, Filter] = _Filters()
"""The registered filters by name, those of other packages included."""
