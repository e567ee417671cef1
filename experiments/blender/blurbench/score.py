"""Score methods on the scenes of BlurBench and print a leaderboard.

    python -m experiments.blender.blurbench.score --frames DIR -o OUT [--method FILE.py:NAME ...]

DIR holds scenes as `blurbench.render` writes them. NAME is a function that takes a `Case` and
returns an (H, W, C) image in linear light, or None where it lacks what it needs. Writes and prints
as CSV and Markdown ``leaderboard``, ``psnr`` and ``flip``, PSNR in dB and FLIP of display values
over the whole frame, and ``motion``, the lengths of blur in each scene.
"""

import argparse
import importlib.util
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import jaxblur
from experiments import common
from experiments.blender.blurbench.cases import Case, find_cases
from experiments.blender.blurbench.split import HALVES
from jaxblur import metrics
from jaxblur.filters import filter_info

Method = Callable[[Case], Any]
Scores = dict[str, dict[str, metrics.Scores | None]]
"""By method and scene; None where the method gave no image."""


def with_defaults(name: str) -> Method:
    """A filter of the package with default parameters and settings: those that were published."""
    info = filter_info(name)
    parameters, settings = info.make_parameters(), info.make_settings()
    return lambda case: info.call(case.frame, parameters, settings=settings)


def with_neighbors(case: Case) -> Any:
    """`layered`, given the frames before and after."""
    parameters = jaxblur.LayeredParameters()
    return jaxblur.layered(case.frame, parameters, before=case.before, after=case.after)


METHODS: dict[str, Method] = {
    "unblurred": lambda case: case.frame.color,
    "pixel_velocity": with_defaults("pixel_velocity"),
    "mcguire2012": with_defaults("mcguire2012"),
    "guertin2014": with_defaults("guertin2014"),
    "Blender's Vector Blur": lambda case: case.vector_blur,
    "layered": with_defaults("layered"),
    "layered, with neighbors": with_neighbors,
}


def load_method(reference: str) -> Method:
    """Import a function from a file.

    Args:
        reference: ``path/to/file.py:name``.

    Returns:
        The function.

    Raises:
        argparse.ArgumentTypeError: there is no such file, or no such function in it.
    """
    path, _, name = reference.rpartition(":")
    if not path.endswith(".py") or not Path(path).is_file():
        raise argparse.ArgumentTypeError(f"expected an existing FILE.py:NAME, got {reference!r}")
    spec = importlib.util.spec_from_file_location(Path(path).stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    if not callable(getattr(module, name, None)):
        raise argparse.ArgumentTypeError(f"{path} has no function {name!r}")
    return getattr(module, name)


def score(methods: Mapping[str, Method], cases: Sequence[Case]) -> Scores:
    """Run every method on every scene.

    Args:
        methods: by name.
        cases: scenes.

    Returns:
        PSNR in dB, SSIM and FLIP of display values, by method and scene.
    """
    scores: Scores = {name: {} for name in methods}
    for case in cases:
        for name, method in methods.items():
            image = method(case)
            if image is None:
                scores[name][case.name] = None
                continue
            colors = np.asarray(image)[..., :3]
            scores[name][case.name] = metrics.compare(colors, case.truth[..., :3])
    return scores


def leaderboard(scores: Scores, cases: Sequence[Case]) -> list[list[Any]]:
    """Means over each half, the best mean PSNR over all scenes first.

    Args:
        scores: of `score`.
        cases: the scenes that were scored.

    Returns:
        Rows: method, then PSNR in dB and FLIP for each half. A mean is blank if the method gave no
        image on one of its scenes, since means over different scenes cannot be compared.
    """
    rows = []
    for method, by_scene in scores.items():
        row: list[Any] = [method]
        for half in HALVES:
            names = [case.name for case in cases if case.half == half]
            row += [_mean(by_scene, names, "psnr"), _mean(by_scene, names, "flip")]
        rows.append((_mean(by_scene, [case.name for case in cases], "psnr"), row))
    rows.sort(key=lambda item: -np.inf if item[0] == "" else item[0], reverse=True)
    return [row for _, row in rows]


def by_scene(scores: Scores, cases: Sequence[Case], metric: str) -> list[list[Any]]:
    """One metric of every method: a row for each scene, then the means over each half.

    Args:
        scores: of `score`.
        cases: the scenes that were scored.
        metric: ``psnr`` or ``flip``.

    Returns:
        Rows: scene, half, then one value for each method, blank where it gave no image.
    """
    rows: list[list[Any]] = []
    for half in HALVES:
        names = [case.name for case in cases if case.half == half]
        for name in names:
            rows.append([name, half, *(_mean(of, [name], metric) for of in scores.values())])
        if names:
            rows.append(["mean", half, *(_mean(of, names, metric) for of in scores.values())])
    return rows


def motion(case: Case) -> list[Any]:
    """How long the blur of a scene is.

    Args:
        case: the scene.

    Returns:
        Scene, half, then mean, 90th and 99th percentile of the path length within the shutter, px.
    """
    frame = case.frame
    path = np.asarray(frame.velocity)[..., None, :] if frame.path is None else frame.path
    ends = np.linalg.norm(path, axis=-1)
    length = ends.sum(-1) * (2 / ends.shape[-1])
    return [case.name, case.half, *map(float, (length.mean(), *np.percentile(length, (90, 99))))]


def _mean(
    of_method: Mapping[str, metrics.Scores | None], names: Sequence[str], metric: str
) -> float | str:
    found = [result for name in names if (result := of_method[name]) is not None]
    if not names or len(found) < len(names):
        return ""
    return float(np.mean([getattr(result, metric) for result in found]))


def main() -> None:
    """Score, and write and print the tables."""
    parser = common.output_parser("Score methods on the scenes of BlurBench.")
    parser.add_argument("--frames", type=Path, required=True, metavar="DIR")
    parser.add_argument("--half", choices=(*HALVES, "both"), default="both")
    parser.add_argument("--method", type=load_method, nargs="+", default=[], metavar="FILE.py:NAME")
    options = parser.parse_args()
    cases = [case for case in find_cases(options.frames) if options.half in (case.half, "both")]
    methods = METHODS | {method.__name__: method for method in options.method}
    scores = score(methods, cases)
    for metric in ("psnr", "flip"):
        rows = by_scene(scores, cases, metric)
        common.write_table(options.output, metric, ["scene", "half", *methods], rows)
    columns = ["scene", "half", "mean, px", "90 %, px", "99 %, px"]
    common.write_table(options.output, "motion", columns, [motion(case) for case in cases])
    columns = [f"{half} {metric}" for half in HALVES for metric in ("PSNR, dB", "FLIP")]
    rows = leaderboard(scores, cases)
    common.write_table(options.output, "leaderboard", ["method", *columns], rows)


if __name__ == "__main__":
    main()
