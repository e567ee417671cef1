"""The result of a fit, as a record and as a TOML file. Loads no jax.

The file holds everything needed to use, judge and repeat the fit. It has a schema number; unknown
keys, missing keys and values of another type are errors. A setting that is newer than the file
takes its default. A file may hold filter, parameters and settings alone, as the page of
`jaxblur play` writes them: see `load_choice`.
"""

import dataclasses
import json
import math
import os
import tomllib
import types
import typing
from collections.abc import Mapping, Sequence
from typing import Any

from .._util.atomic import replacing
from .._util.small_files import read_text
from .._util.text import nearest
from ..filters.registry import Parameters, filter_info
from ..settings import GuertinSettings, Settings

SCHEMA = 1


@dataclasses.dataclass(frozen=True)
class Score:
    """Errors of one image pair under one set of parameters, averaged over draws of noise.

    Attributes:
        pair: name of the pair.
        part: ``train`` or ``held-out``.
        parameters: ``published``, which are the defaults of the filter, or ``fitted``.
        region: ``whole`` image, or ``moving`` for the pixels that motion reaches.
        mse: mean squared error in linear light.
        relative_mse: see `jaxblur.metrics.relative_mse`.
        psnr: dB after the display transform.
        ssim: after the display transform.
        flip: after the display transform.
        psnr_error: standard error of the mean over draws of noise; 0 if there is one draw alone.
        ssim_error: the same of `ssim`.
        flip_error: the same of `flip`.
    """

    pair: str
    part: str
    parameters: str
    region: str
    mse: float
    relative_mse: float
    psnr: float
    ssim: float
    flip: float
    psnr_error: float = 0.0
    ssim_error: float = 0.0
    flip_error: float = 0.0


Kind = typing.TypeVar("Kind", bound="FilterChoice")

BEYOND_NOISE = 2.0
"""Standard errors by which scores differ that are told apart."""
_FIGURES = {"psnr": (" in dB", 2, 1), "ssim": ("", 4, 1), "flip": ("", 4, -1)}
"""Unit, digits that are printed, and 1 if larger is better."""


@dataclasses.dataclass(frozen=True)
class Sensitivity:
    """Standard errors of the fitted parameters; see `jaxblur.fitting.sensitivity`.

    Attributes:
        names: of the free parameters, the order of all that follows.
        standard_error: in the units of the parameters; infinite where the data leaves one free,
            NaN where the frames have too few blocks.
        relative_error: the same as a share of the fitted value.
        correlation: of the errors, names x names.
        curvature: second derivatives of the loss in the unconstrained parameters, names x names.
        flags: warnings in words, empty if all is well.
        blocks: number of blocks of pixels that the errors are estimated from.
        profile_changes: by which share of itself the loss changes between half and double the
            value, or over an interval; the larger change of the two.
        undetermined: names of the parameters that are not determined, each with a flag that says
            why.
    """

    names: tuple[str, ...]
    standard_error: tuple[float, ...]
    relative_error: tuple[float, ...]
    correlation: tuple[tuple[float, ...], ...]
    curvature: tuple[tuple[float, ...], ...]
    flags: tuple[str, ...]
    blocks: int
    profile_changes: tuple[float, ...] = ()
    undetermined: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Data:
    """One image pair that took part.

    Attributes:
        name: of the pair.
        part: ``train`` or ``held-out``.
        sha256: of frame and truth as the fit saw them.
    """

    name: str
    part: str
    sha256: str


@dataclasses.dataclass(frozen=True)
class FilterChoice:
    """A filter with its parameters and settings.

    Attributes:
        filter: name of a registered filter.
        parameters: all parameters of the filter, including the fitted ones.
        settings: of the filter run, by name.
    """

    filter: str
    parameters: dict[str, float]
    settings: dict[str, str | int | float]

    @property
    def filter_parameters(self) -> Parameters | None:
        """The parameters as the filter takes them."""
        return filter_info(self.filter).make_parameters(**self.parameters)

    @property
    def filter_settings(self) -> Settings:
        """The settings of the run, as the filter takes them."""
        return filter_info(self.filter).kind(**typing.cast(dict[str, Any], self.settings))


@dataclasses.dataclass(frozen=True)
class FitResult(FilterChoice):
    """Result of a fit: the parameters, how well they are determined, and how they were found.

    Attributes:
        initial: where the fit started.
        published: the default parameters of the filter.
        free: names of the fitted parameters.
        minimized: the objective in one sentence.
        objective: its choices: loss, pixel, mask, noise, noise_draws, seed, prior.
        notes: additions of the caller, such as how the frames were read.
        steps: number of steps done.
        interrupted: ctrl-C ended the fit; it has no scores and no sensitivity.
        history: ``loss`` and the free parameters before each step.
        scores: of the defaults (``published``) and the fitted parameters, on the training and the
            held-out pairs.
        sensitivity: None if interrupted.
        data: the pairs.
        versions: of the software.
        plateau: number of steps after which the descent stopped because it no longer improved;
            None if it took all of them.
        warnings: what a reader of the result must know, in words: the flags of the sensitivity, and
            scores that the fit made worse. Empty if all is well.
    """

    initial: dict[str, float]
    published: dict[str, float]
    free: tuple[str, ...]
    minimized: str
    objective: dict[str, str | int | float]
    notes: dict[str, str | int | float]
    steps: int
    interrupted: bool
    history: dict[str, tuple[float, ...]]
    scores: tuple[Score, ...]
    sensitivity: Sensitivity | None
    data: tuple[Data, ...]
    versions: dict[str, str]
    plateau: int | None = None
    warnings: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """The parameters, the loss and the number of warnings, in a line."""
        values = ", ".join(f"{name}={value:.4g}" for name, value in self.parameters.items())
        words = [f"{self.filter}: {values}", f"fitted {', '.join(self.free)}"]
        if losses := self.history.get("loss"):
            words.append(f"loss {losses[0]:.4g} to {losses[-1]:.4g} in {self.steps} steps")
        if self.interrupted:
            words.append("interrupted")
        if self.warnings:
            words.append(f"see {len(self.warnings)} in .warnings")
        return f"<FitResult {'; '.join(words)}>"

    def mean_score(self, figure: str, part: str, parameters: str, region: str = "whole") -> float:
        """Mean of one figure over the pairs.

        Args:
            figure: a field of `Score`, such as ``psnr``.
            part: ``train`` or ``held-out``.
            parameters: ``published`` or ``fitted``.
            region: ``whole`` or ``moving``.

        Returns:
            The mean; NaN if there is no such pair.
        """
        found = self._figures(figure, part, parameters, region)
        return math.fsum(found) / len(found) if found else math.nan

    def _figures(self, figure: str, part: str, parameters: str, region: str) -> list[float]:
        """One figure of every pair."""
        wanted = (part, parameters, region)
        return [
            getattr(score, figure)
            for score in self.scores
            if (score.part, score.parameters, score.region) == wanted
        ]

    def _noise(self, figure: str, part: str, region: str) -> float:
        """Standard error of the difference of two mean scores, by the draws of noise."""
        errors = [
            self._figures(f"{figure}_error", part, label, region)
            for label in ("published", "fitted")
        ]
        return math.hypot(*(math.hypot(*each) / max(len(each), 1) for each in errors))

    def losses_by_fitting(self) -> tuple[str, ...]:
        """Scores that are worse with the fitted parameters than with the defaults, in words.

        Over the pixels that motion reaches, where anything moves, else over whole images; training
        and held-out pairs apart. Differences that vanish when they are printed, or that the draws
        of noise explain, do not count.
        """
        found = []
        for part in dict.fromkeys(score.part for score in self.scores):
            moving = any((s.part, s.region) == (part, "moving") for s in self.scores)
            region = "moving" if moving else "whole"
            for figure, (unit, digits, sign) in _FIGURES.items():
                before, after = (
                    self.mean_score(figure, part, parameters, region)
                    for parameters in ("published", "fitted")
                )
                loss = sign * round(before - after, digits)
                if loss > BEYOND_NOISE * self._noise(figure, part, region):
                    found.append(
                        f"{part}: {figure.upper()}{unit} is worse with the fitted parameters than "
                        f"with the defaults, {after:.{digits}f} against {before:.{digits}f}"
                    )
        return tuple(found)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the result as TOML, whole or not at all.

        Args:
            path: file to write; an older one is replaced.

        Raises:
            JaxblurIOError: it cannot be written.
        """
        with replacing(path) as temporary, open(temporary, "w", encoding="utf-8") as file:
            file.write(to_toml({"schema": SCHEMA} | dataclasses.asdict(self)))

    @staticmethod
    def load(path: str | os.PathLike[str]) -> "FitResult":
        """Read a result that `save` wrote.

        Args:
            path: TOML file.

        Returns:
            The result.

        Raises:
            ValueError: the file is not TOML, of another schema, has unknown or missing keys or
                values of another type, or its filter is not registered; the message names file
                and key.
            JaxblurIOError: the file cannot be read as text.
        """
        return _record(FitResult, _content(path), path)


def load_choice(path: str | os.PathLike[str]) -> FilterChoice:
    """Read a file that says which filter runs, with which parameters and settings.

    Args:
        path: TOML file that `FitResult.save` wrote, or that was copied from a page of
            `jaxblur play`.

    Returns:
        A `FitResult` if the file holds one.

    Raises:
        ValueError: as `FitResult.load`.
        JaxblurIOError: the file cannot be read as text.
    """
    content = _content(path)
    alone = {field.name for field in dataclasses.fields(FilterChoice)}
    return _record(FilterChoice if content.keys() <= alone else FitResult, content, path)


def _content(path: str | os.PathLike[str]) -> dict[str, Any]:
    """What a file of this schema holds."""
    text = read_text(path, "give a file that `jaxblur fit` wrote.")
    try:
        content = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: is not TOML: {error}.") from error
    schema = content.pop("schema", None)
    if schema != SCHEMA:
        raise ValueError(
            f"{path}: 'schema' must be {SCHEMA}, got {schema}; fit again, or use the version "
            "of jaxblur that wrote it."
        )
    return content


def _record(kind: type[Kind], content: dict[str, Any], path: str | os.PathLike[str]) -> Kind:
    """The content of a file as a record."""
    try:
        result = _decode(kind, content, "")
        _check_parameters(result)
        return dataclasses.replace(result, settings=_completed(result))
    except (ValueError, OverflowError) as error:
        # Plain quotes: these are keys of the file, not arguments of a caller.
        raise ValueError(f"{path}: {str(error).replace('`', chr(39))}") from error


def _check_parameters(choice: FilterChoice) -> None:
    """Reject parameters that the filter has not, or that are out of range."""
    infos = filter_info(choice.filter).parameter_infos
    for name, value in choice.parameters.items():
        if name not in infos:
            known = ", ".join(infos) or "none"
            raise ValueError(
                f"unknown key `parameters.{name}`{nearest(name, infos)}; {choice.filter} has "
                f"{known}."
            )
        if not infos[name].allows(value):
            raise ValueError(f"`parameters.{name}` must be {infos[name].range}, got {value:g}.")


def to_toml(table: Mapping[str, Any]) -> str:
    """Write a nested mapping as TOML; entries that are None are left out.

    Args:
        table: values, mappings, and sequences of mappings.

    Returns:
        Text that `tomllib` reads back.
    """
    return "\n".join(_lines(table, "")) + "\n"


def _lines(table: Mapping[str, Any], prefix: str) -> list[str]:
    table = {key: value for key, value in table.items() if value is not None}
    nested = {key for key, value in table.items() if _is_table(value) or _is_table_array(value)}
    lines = [f"{_key(key)} = {_value(v)}" for key, v in table.items() if key not in nested]
    for key in table:
        if key not in nested:
            continue
        name, value = prefix + _key(key), table[key]
        single = _is_table(value)
        for entry in [value] if single else value:
            lines += ["", f"[{name}]" if single else f"[[{name}]]", *_lines(entry, f"{name}.")]
    return lines


def _completed(result: FilterChoice) -> dict[str, str | int | float]:
    """The settings of a file, with defaults for those that are newer than the file.

    Version 0.1 wrote the choices of guertin2014 for every filter; the others ignored them.
    """
    info = filter_info(result.filter)
    known = dataclasses.asdict(info.settings)
    ignored = {field.name for field in dataclasses.fields(GuertinSettings)} - known.keys()
    settings = {name: v for name, v in result.settings.items() if name not in ignored}
    for name, value in settings.items():
        if name not in known:
            raise ValueError(f"unknown key `settings.{name}`; remove it.")
        _decode(type(known[name]), value, f"settings.{name}")
    info.kind(**typing.cast(dict[str, Any], known | settings))
    return known | settings


def _is_table(value: Any) -> bool:
    return isinstance(value, Mapping)


def _is_table_array(value: Any) -> bool:
    return isinstance(value, list | tuple) and bool(value) and all(map(_is_table, value))


def _key(name: str) -> str:
    plain = name.isascii() and name.replace("_", "").replace("-", "").isalnum()
    return name if plain else _value(name)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        # JSON escapes are those of TOML, but for DEL, which TOML wants escaped.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, Sequence):
        return f"[{', '.join(map(_value, value))}]"
    return repr(value)


def _decode(kind: Any, value: Any, where: str) -> Any:
    """Turn parsed TOML into the annotated type, strictly."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        return _decode_union(arguments, value, where)
    if dataclasses.is_dataclass(kind):
        return _decode_record(kind, value, where)
    if origin is tuple:
        entries = _expect(list, value, where)
        return tuple(_decode(arguments[0], v, f"{where}[{k}]") for k, v in enumerate(entries))
    if origin is dict:
        entries = _expect(dict, value, where)
        return {k: _decode(arguments[1], v, f"{where}.{k}") for k, v in entries.items()}
    if kind is float and type(value) is int:
        return float(value)
    return _expect(kind, value, where)


def _decode_union(kinds: Sequence[Any], value: Any, where: str) -> Any:
    for kind in kinds:
        if kind is not types.NoneType and (dataclasses.is_dataclass(kind) or type(value) is kind):
            return _decode(kind, value, where)
    names = " or ".join(kind.__name__ for kind in kinds)
    raise ValueError(f"`{where}` must be {names}, got {value!r:.200}.")


def _decode_record(kind: Any, value: Any, where: str) -> Any:
    table = _expect(dict, value, where)
    prefix = f"{where}." if where else ""
    hints = typing.get_type_hints(kind)
    # TOML has no form for empty sequences of tables and for None.
    absent: dict[str, Any] = {
        name: None if types.NoneType in typing.get_args(hint) else ()
        for name, hint in hints.items()
        if types.NoneType in typing.get_args(hint) or name == "scores"
    }
    # Fields with a default are newer than the first files.
    fields = dataclasses.fields(kind)
    absent |= {f.name: f.default for f in fields if f.default is not dataclasses.MISSING}
    for name in table.keys() - hints.keys():
        raise ValueError(f"unknown key `{prefix}{name}`; remove it.")
    for name in hints.keys() - table.keys() - absent.keys():
        raise ValueError(f"missing key `{prefix}{name}`; write the file again.")
    decoded = {name: _decode(hints[name], v, f"{prefix}{name}") for name, v in table.items()}
    return kind(**absent | decoded)


def _expect(kind: Any, value: Any, where: str) -> Any:
    if type(value) is not kind:
        raise ValueError(f"`{where}` must be {kind.__name__}, got {value!r:.200}.")
    return value
