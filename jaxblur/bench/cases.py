"""Cases to measure, each a method with its settings, and grids of them."""

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

from ..filters.registry import FILTERS, FilterInfo, filter_info
from ..settings import Settings, checked_settings

if TYPE_CHECKING:
    import jax

UNBLURRED = "unblurred"
"""The method that leaves the sharp frame as it is."""
RENDERERS = ("accumulate", "stochastic", "motion_paths")
"""Ways to render blur instead of filtering it; ``samples`` is the number of images, of samples per
pixel, and of spatial samples."""
AUTO = "auto"


@dataclasses.dataclass(frozen=True)
class Case:
    """A method with its settings.

    Attributes:
        method: name of a registered filter, one of `RENDERERS`, `UNBLURRED`, or another method that
            `measure` is given.
        settings: of the run; for renderers only the number of samples matters.
        auto_radius: take the radius from the frame, and not from the settings.
    """

    method: str
    settings: Settings = Settings()
    auto_radius: bool = False

    def __post_init__(self):
        if (info := filter_of(self.method)) is not None:
            checked = checked_settings(self.settings, info.kind, info.name)
            object.__setattr__(self, "settings", checked)

    @property
    def has_settings(self) -> bool:
        """Whether all settings matter to the method, as they do to a filter."""
        return self.method not in (*RENDERERS, UNBLURRED)

    @property
    def is_published(self) -> bool:
        """Whether these are the default settings of the filter."""
        known = filter_of(self.method) is not None
        return known and not self.auto_radius and self.settings == usual_settings(self.method)

    @property
    def label(self) -> str:
        """The method and the settings that differ from its defaults, in a few words."""
        if self.method == UNBLURRED:
            return self.method
        words = [f"{self.method} N={self.settings.samples}"]
        if self.has_settings:
            usual = usual_settings(self.method)
            differing = {
                field.name: value
                for field in dataclasses.fields(self.settings)
                if (value := getattr(self.settings, field.name)) != getattr(usual, field.name)
            }
            differing.pop("samples", None)
            radius = differing.pop("radius", None)
            if self.auto_radius or radius is not None:
                words.append(f"r={AUTO if self.auto_radius else radius}")
            words += [f"{name}={value}" for name, value in differing.items()]
        return " ".join(words)


def filter_of(method: str) -> FilterInfo | None:
    """The record of a method that is a filter; None for other methods."""
    return filter_info(method) if method in FILTERS else None


def usual_settings(method: str) -> Settings:
    """The default settings of a method.

    Args:
        method: as in `Case`.

    Returns:
        Those of the filter; plain `Settings` for other methods.
    """
    info = filter_of(method)
    return Settings() if info is None else info.settings


def make_case(method: "str | Callable[..., jax.Array]", **changes: object) -> Case:
    """A case that differs from the defaults.

    Args:
        method: as in `Case`, or the function of a registered filter.
        **changes: fields of the method's settings; ``radius`` may be ``"auto"``.

    Returns:
        The case.

    Raises:
        ValueError: a setting is unknown or out of range.
    """
    automatic = changes.get("radius") == AUTO
    if automatic:
        del changes["radius"]
    name = method if isinstance(method, str) else filter_info(method).name
    info = filter_of(name)
    settings = (
        Settings(**cast(dict[str, Any], changes)) if info is None else info.make_settings(**changes)
    )
    return Case(name, settings, automatic)


Axes = Mapping[str, Sequence[object]]
"""Values to try, by name of the setting."""


def product(methods: Iterable[str], axes: Axes) -> list[Case]:
    """Every method with every combination of the values.

    Args:
        methods: as in `Case`; the unblurred frame is added once, renderers once for each number
            of samples.
        axes: values by setting; those left out take their defaults, and a method that does not
            have a setting is not varied along it.

    Returns:
        The cases, each once.
    """
    cases = []
    for method in methods:
        chosen = _axes_of(method, axes)
        for values in itertools.product(*chosen.values()):
            cases.append(make_case(method, **dict(zip(chosen, values, strict=True))))
    return list(dict.fromkeys(cases))


def one_at_a_time(methods: Iterable[str], axes: Axes) -> list[Case]:
    """Every method with its defaults, and with one setting changed at a time.

    Args:
        methods: as in `product`.
        axes: values by setting.

    Returns:
        The cases, each once.
    """
    cases = []
    for method in methods:
        chosen = _axes_of(method, axes)
        if method not in RENDERERS:
            cases.append(make_case(method))
        cases += [make_case(method, **{name: v}) for name, values in chosen.items() for v in values]
    return list(dict.fromkeys(cases))


def _axes_of(method: str, axes: Axes) -> Axes:
    """The settings among some that a method has."""
    return {name: values for name, values in axes.items() if name in names_of_settings(method)}


def names_of_settings(method: str) -> tuple[str, ...]:
    """The settings that matter to a method.

    Args:
        method: as in `Case`.

    Returns:
        Names of fields of its settings.
    """
    if method in RENDERERS:
        return ("samples",)
    if method == UNBLURRED:
        return ()
    return tuple(field.name for field in dataclasses.fields(usual_settings(method)))
