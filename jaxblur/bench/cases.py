"""What is measured: a method with its settings, and grids of such cases."""

import dataclasses
import itertools
from collections.abc import Iterable, Sequence
from typing import Any

from ..filters import PUBLISHED
from ..settings import Settings

UNBLURRED = "unblurred"
RENDERERS = ("accumulate", "stochastic", "motion_paths")
"""Ways to render blur instead of filtering it; ``samples`` is the number of images, of samples per
pixel, and of spatial samples."""
AUTO = "auto"


@dataclasses.dataclass(frozen=True)
class Case:
    """A method with its settings.

    Attributes:
        method: a key of `jaxblur.FILTERS`, one of `RENDERERS`, `UNBLURRED`, or another method that
            `measure` is given.
        settings: of the run; for renderers only the number of samples matters.
        auto_radius: take the radius from the frame, and not from the settings.
    """

    method: str
    settings: Settings = Settings()
    auto_radius: bool = False

    @property
    def has_settings(self) -> bool:
        """Whether all settings matter to the method, as they do to a filter."""
        return self.method not in (*RENDERERS, UNBLURRED)

    @property
    def is_published(self) -> bool:
        """Whether these are the settings that the authors of the filter published."""
        if self.method not in PUBLISHED or self.auto_radius:
            return False
        return self.settings == published(self.method)

    @property
    def label(self) -> str:
        """The method and what differs from its published settings, in a few words."""
        if self.method == UNBLURRED:
            return self.method
        words = [f"{self.method} N={self.settings.samples}"]
        if self.has_settings:
            usual = published(self.method)
            differing = {
                field.name: value
                for field in dataclasses.fields(Settings)
                if (value := getattr(self.settings, field.name)) != getattr(usual, field.name)
            }
            differing.pop("samples", None)
            radius = differing.pop("radius", None)
            if self.auto_radius or radius is not None:
                words.append(f"r={AUTO if self.auto_radius else radius}")
            words += [f"{name}={value}" for name, value in differing.items()]
        return " ".join(words)


def published(method: str) -> Settings:
    """The settings that a filter was published with.

    Args:
        method: as in `Case`.

    Returns:
        The settings; the defaults for what was not published anywhere.
    """
    return PUBLISHED[method][1] if method in PUBLISHED else Settings()


def make_case(method: str, **changes: Any) -> Case:
    """A case that differs from what was published.

    Args:
        method: as in `Case`.
        **changes: fields of `jaxblur.Settings`; ``radius`` may be ``"auto"``.

    Returns:
        The case.

    Raises:
        ValueError: a setting is out of range.
    """
    automatic = changes.get("radius") == AUTO
    if automatic:
        del changes["radius"]
    return Case(method, dataclasses.replace(published(method), **changes), automatic)


Axes = dict[str, Sequence[Any]]
"""Values to try, by field of `jaxblur.Settings`."""


def product(methods: Iterable[str], axes: Axes) -> list[Case]:
    """Every method with every combination of the values.

    Args:
        methods: as in `Case`; the unblurred frame joins once, renderers once for each number of
            samples.
        axes: values by setting; those left out are as published.

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
    """Every method as published, and with one setting changed at a time.

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
    """The settings that matter to a method."""
    matter = axes if Case(method).has_settings else ("samples",) if method in RENDERERS else ()
    return {name: values for name, values in axes.items() if name in matter}
