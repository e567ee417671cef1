"""Derivatives of the filters beside central differences, in this tree and in an older one.

    python -m experiments.013_gradients.run --before TREE --reference-data DIR -o OUT
        [--draws N] [--filters NAME:FETCH,...]

TREE is a checkout of a commit in which texels are held. For every filter, frame and quantity of
`jaxblur.check_gradient`: the ratio of derivative and difference. Writes ``ratios`` (every row),
``summary`` (how many of the determined rows are within 5, 10 and 20 percent) and ``times``.
"""

import dataclasses
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from experiments.common import (
    Example,
    catalogue_example,
    full_size_examples,
    output_parser,
    write_table,
)
from jaxblur import scenes

HERE = Path(__file__).resolve()
SIZE = (180, 320)
SHUTTER, TRUTH_SAMPLES = 0.5, 32
CASES = (
    *("guertin2014:nearest", "layered:bilinear", "pixel_velocity:nearest"),
    *("mcguire2012:nearest", "guertin2014:bilinear", "mcguire2012:bilinear"),
)
WITHIN = (0.05, 0.1, 0.2)
BARELY = 0.1
"""Largest standard error of a ratio that is counted."""


def busiest_part(example: Example) -> Example:
    """The part of a large frame of `SIZE` in which most pixels move by more than a pixel."""
    moves = np.linalg.norm(np.asarray(example.frame.velocity), axis=-1) > 1
    corners = [
        (row, column)
        for row in range(0, moves.shape[0] - SIZE[0] + 1, 10)
        for column in range(0, moves.shape[1] - SIZE[1] + 1, 10)
    ]
    row, column = max(corners, key=lambda c: moves[_part(*c)].sum())
    part = _part(row, column)
    frame = jax.tree.map(lambda buffer: buffer[part], example.frame)
    return example._replace(
        frame=dataclasses.replace(frame, color=frame.color[..., :3]),
        truth=np.asarray(example.truth)[part][..., :3],
    )


def _part(row: int, column: int) -> tuple[slice, slice]:
    return slice(row, row + SIZE[0]), slice(column, column + SIZE[1])


def write_frames(folder: Path, reference_data: Path | None) -> None:
    """Write the frames that a folder lacks, with their truth, as NumPy archives."""
    for name in scenes.SCENES:
        file = folder / f"catalogue_{name}.npz"
        if name != "static" and not file.exists():
            _write(file, catalogue_example(name, SIZE, SHUTTER, TRUTH_SAMPLES, path=True))
            print(name, flush=True)
    for example in full_size_examples(reference_data) if reference_data else []:
        _write(folder / f"rendered_{example.name}.npz", busiest_part(example))


def _write(file: Path, example: Example) -> None:
    buffers = {k: v for k, v in vars(example.frame).items() if v is not None}
    np.savez(
        file, truth=np.asarray(example.truth), **{k: np.asarray(v) for k, v in buffers.items()}
    )


def measure(tree: Path, frames: Path, result: Path, case: str, draws: int) -> subprocess.Popen:
    """Start a process that measures one filter in a tree."""
    worker = HERE.with_name("worker.py")
    arguments = [frames, result, *case.split(":"), draws, 9]
    environment = os.environ | {"PYTHONPATH": str(tree), "JAX_PLATFORMS": "cpu"}
    command = [sys.executable, str(worker), *map(str, arguments)]
    return subprocess.Popen(command, cwd=tree, env=environment)


def read_result(result: Path, tree: Path) -> dict[str, Any]:
    """What a process found.

    Raises:
        SystemExit: it imported another jaxblur.
    """
    found = json.loads(result.read_text(encoding="utf-8"))
    if Path(found["package"]) != tree / "jaxblur":
        raise SystemExit(f"{tree}: its process imports {found['package']}")
    return found


def join(case: str, before: dict[str, Any], after: dict[str, Any]) -> list[tuple[Any, ...]]:
    """Rows of the table: determined quantities and cosines, both trees."""
    older = {(row["frame"], row["name"], row.get("at")): row for row in before["rows"]}
    rows = []
    for row in after["rows"]:
        if not row["determined"]:
            continue
        old = older[row["frame"], row["name"], row.get("at")]
        name = row["name"]
        if name == "all velocities":
            name += f" times {row['at']:g}"
        figures = [
            "" if number is None else float(f"{number:.3g}")
            for number in (
                row.get("difference"),
                row.get("difference_error"),
                row.get("sensitivity"),
                old["ratio"],
                old.get("ratio_error"),
                row["ratio"],
                row.get("ratio_error"),
            )
        ]
        rows.append((case, row["frame"].partition("_")[2], name, *figures))
    return rows


def summarize(case: str, rows: Sequence[tuple[Any, ...]]) -> list[tuple[Any, ...]]:
    """By kind of quantity: how many ratios are near 1, before and after."""
    kinds: dict[str, list[tuple[float, float]]] = {}
    for _, _, name, *figures in rows:
        before, after, error = figures[3], figures[5], figures[6]
        kind = "parameters"
        for word in ("all velocities", "object speed", "object direction", "object depth"):
            kind = word if name.startswith(word) else kind
        kind = "camera" if name.startswith("twist") else kind
        if name.startswith("cosine"):
            kind = "cosine of the camera's six"
        elif error > BARELY:
            continue
        kinds.setdefault(kind, []).append((before, after))
    table = []
    for kind, pairs in kinds.items():
        both = np.array(pairs)
        cells = []
        for ratios in both.T:
            shares = [f"{np.sum(np.abs(ratios - 1) <= share)}" for share in WITHIN]
            cells += [f"{np.median(ratios):.3f}", " / ".join(shares)]
        table.append((case, kind, len(pairs), *cells))
    return table


def main() -> None:
    """Parse the command line, measure, write."""
    parser = output_parser("Derivatives beside differences.", "rendered scenes")
    parser.add_argument("--before", type=Path, required=True, metavar="TREE")
    parser.add_argument("--frames", type=Path, metavar="DIR", help="keeps the frames between runs")
    parser.add_argument("--draws", type=int, default=8)
    parser.add_argument("--filters", default=",".join(CASES), metavar="NAME:FETCH,...")
    options = parser.parse_args()
    trees = {"before": options.before.resolve(), "after": HERE.parents[2]}
    rows: list[tuple[Any, ...]] = []
    summary: list[tuple[Any, ...]] = []
    costs: list[tuple[Any, ...]] = []
    with tempfile.TemporaryDirectory() as results, tempfile.TemporaryDirectory() as temporary:
        folder = options.frames or Path(temporary)
        folder.mkdir(exist_ok=True)
        write_frames(folder, options.reference_data)
        for case in options.filters.split(","):
            files = {when: Path(results) / f"{when}.json" for when in trees}
            started = [
                measure(tree, folder, files[when], case, options.draws)
                for when, tree in trees.items()
            ]
            if any(process.wait() for process in started):
                raise SystemExit(f"{case}: a process failed")
            found = {when: read_result(files[when], tree) for when, tree in trees.items()}
            label = case.replace(":", ", ")
            joined = join(label, found["before"], found["after"])
            rows += joined
            summary += summarize(label, joined)
            costs += _costs(label, found)
            write_all(options.output, rows, summary, costs)


def _costs(case: str, found: dict[str, dict[str, Any]]) -> list[tuple[Any, ...]]:
    times = {when: result["times"] for when, result in found.items()}
    table = []
    for what, after in times["after"].items():
        passes = [f"{t[what] / t['forward']:.2f}" for t in times.values()]
        table.append((case, what, f"{times['before'][what]:.1f}", f"{after:.1f}", *passes))
    return table


def write_all(output: Path, rows: Sequence[Any], summary: Sequence[Any], costs: Sequence[Any]):
    """Write the three tables."""
    columns = ("filter", "frame", "quantity", "difference", "standard error", "sensitivity")
    columns += ("ratio before", "its error", "ratio after", "its error after")
    write_table(output, "ratios", columns, rows)
    shares = "within " + " / ".join(f"{100 * share:g}" for share in WITHIN) + " %"
    columns = ("filter", "quantity", "rows", "median before", f"{shares} before")
    write_table(output, "summary", (*columns, "median after", f"{shares} after"), summary)
    columns = ("filter", "program", "CPU ms before", "after", "forward passes before")
    write_table(output, "times", (*columns, "forward passes after"), costs)


if __name__ == "__main__":
    main()
