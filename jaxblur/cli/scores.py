"""Scores of images against a truth, and their rows in tables."""

import argparse
from collections.abc import Mapping, Sequence
from typing import Any

from .arguments import file_path
from .loading import Loaded

SCORE_COLUMNS = ("against truth", ">PSNR dB", ">SSIM", ">FLIP")


def add_truth_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that name the truth; `.loading.load` reads it."""
    parser.add_argument(
        "--truth",
        type=file_path,
        metavar="FILE",
        help="print PSNR, SSIM and FLIP against it; each of several views against the view of its "
        "name there, or against the file of its name, where %%V in FILE stands for it",
    )
    parser.add_argument("--truth-layer", metavar="NAME", help="layer of the truth to look in")


def scores_of(loaded: Loaded, image: Any) -> dict[str, Any]:
    """Score a frame, sharp and blurred, against its truth, as a screen shows them.

    Args:
        loaded: the frame, or a view of it.
        image: (H, W, C) its blurred picture and passes.

    Returns:
        `jaxblur.metrics.Scores` of "input" and "output"; empty without a truth.
    """
    if loaded.truth is None:
        return {}
    color, light = loaded.buffers.color, loaded.colors.light
    return scores({"input": light(color), "output": light(loaded.picture(image))}, loaded.truth)


def scores(images: Mapping[str, Any], truth: Any) -> dict[str, Any]:
    """Score images against a truth.

    Args:
        images: (H, W, C) linear light by name.
        truth: (H, W, C) linear light.

    Returns:
        `jaxblur.metrics.Scores` by name.
    """
    from jaxblur import metrics

    return {
        name: metrics.compare(metrics.rgb(image), metrics.rgb(truth))
        for name, image in images.items()
    }


def in_words(view: str | None, name: str, method: str) -> str:
    """What a row of scores is about.

    Args:
        view: its name, where there are several.
        name: of `scores_of`.
        method: name of the filter, which made the output.
    """
    return " ".join(filter(None, (view, method if name == "output" else name)))


def view_rows(
    views: Sequence[str | None], scored: Sequence[Mapping[str, Any]], method: str
) -> list[tuple[str, ...]]:
    """Format the scores of a frame as rows for `SCORE_COLUMNS`.

    Args:
        views: their names, where there are several.
        scored: `scores` of each.
        method: name of what made the output.
    """
    return [
        row
        for view, scores in zip(views, scored, strict=True)
        for row in score_rows({in_words(view, name, method): s for name, s in scores.items()})
    ]


def score_rows(scored: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Format `scores` as rows for `SCORE_COLUMNS`."""
    return [score_cells(name, score._asdict()) for name, score in scored.items()]


def score_cells(name: str, score: Mapping[str, float]) -> tuple[str, ...]:
    """Format one score as a row for `SCORE_COLUMNS`."""
    return name, f"{score['psnr']:.2f}", f"{score['ssim']:.4f}", f"{score['flip']:.4f}"
