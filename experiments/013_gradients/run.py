"""Derivatives of the filters beside central differences, with and without that in the place.

    python -m experiments.013_gradients.run --reference-data DIR -o OUT
        [--draws N] [--step H] [--filters NAME:FETCH,...] [--frames DIR]

For every filter, frame and quantity of `jaxblur.check_gradient`: the ratio of the
derivative to the difference.
"Before" is the derivative with the texels held that a program reads. Writes ``ratios`` (every
determined row), ``summary`` (how many of them are within 5, 10 and 20 percent), ``slopes`` (the
error by all velocities as a share of the steepest slope) and ``times``.
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
WORKER = "experiments.013_gradients.worker"
ROUNDS = 9
"""Runs of which a time is the median."""
COSINE = "camera: cosine of six"
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
    arrays = vars(example.frame) | {"truth": example.truth}
    known: Any = {name: np.asarray(array) for name, array in arrays.items() if array is not None}
    np.savez(file, **known)


def measure(frames: Path, case: str, draws: int, step: float) -> dict[str, dict[str, Any]]:
    """What the processes of a filter find, by whether texels are held (before) or move (after)."""
    with tempfile.TemporaryDirectory() as folder:
        started = {}
        for when, texels in (("before", "held"), ("after", "moving")):
            numbers = draws, step, ROUNDS
            arguments = [frames, Path(folder) / when, *case.split(":"), *numbers, texels]
            command = [sys.executable, "-m", WORKER, *map(str, arguments)]
            # Kernels of their own: those with texels held are not found again as those without.
            cache = Path(folder) / f"cache_{when}"
            environment = os.environ | {"JAX_PLATFORMS": "cpu", "XDG_CACHE_HOME": str(cache)}
            started[when] = subprocess.Popen(command, cwd=HERE.parents[2], env=environment)
        if any([process.wait() for process in started.values()]):
            raise SystemExit(f"{case}: a process failed")
        return {when: json.loads((Path(folder) / when).read_text()) for when in started}


def join(case: str, before: list[dict[str, Any]], after: list[dict[str, Any]]) -> list[Any]:
    """Rows of the table: the determined quantities, and cosines of the camera's six numbers."""
    rows: list[tuple[Any, ...]] = []
    for old, new in zip(before, after, strict=True):
        assert (old["frame"], old["name"], old["at"]) == (new["frame"], new["name"], new["at"])
        if not new["determined"]:
            continue
        name = new["name"]
        if name == "all velocities":
            name += f" times {new['at']:g}"
        held = old["reverse"] / new["difference"]
        keys = ("difference", "difference_error", "sensitivity", "ratio", "ratio_error")
        figures = [_digits(new[key]) for key in keys]
        rows.append((case, _scene(new["frame"]), name, *figures, _digits(held)))
    for frame in dict.fromkeys(row["frame"] for row in after):
        twists = [
            k for k, row in enumerate(after) if row["frame"] == frame and "twist" in row["name"]
        ]
        if not any(after[k]["determined"] for k in twists):
            continue
        difference, *derivatives = (
            np.array([table[k][key] for k in twists])
            for table, key in ((after, "difference"), (after, "reverse"), (before, "reverse"))
        )
        cosines = [
            float(d @ difference / (np.linalg.norm(d) * np.linalg.norm(difference) or np.inf))
            for d in derivatives
        ]
        moved, held = map(_digits, cosines)
        rows.append((case, _scene(frame), COSINE, *[""] * 3, moved, "", held))
    return rows


def _scene(frame: str) -> str:
    return frame.replace("_", ", ", 1)


def _digits(number: float) -> float:
    return float(f"{number:.3g}")


def summarize(case: str, rows: Sequence[tuple[Any, ...]]) -> list[tuple[Any, ...]]:
    """By kind of quantity: how many ratios are near 1, before and after."""
    kinds: dict[str, list[tuple[float, float]]] = {}
    for _, _, name, *figures in rows:
        after, error, before = figures[3:]
        kind = "parameters"
        for word in ("all velocities", "object speed", "object direction", "object depth"):
            kind = word if name.startswith(word) else kind
        kind = "camera" if name.startswith("twist") else kind
        if name == COSINE:
            kind = name
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


def slopes(case: str, rows: Sequence[tuple[Any, ...]]) -> list[tuple[Any, ...]]:
    """By frame: the worst derivative by all velocities, its error as a share of the steepest slope.

    Near the least loss a ratio divides by almost nothing, and this does not.
    """
    frames: dict[str, list[tuple[float, float, float]]] = {}
    for _, frame, name, difference, _, _, after, _, before in rows:
        if name.startswith("all velocities"):
            frames.setdefault(frame, []).append((float(difference), before, after))
    table = []
    for frame, found in frames.items():
        difference, *ratios = np.array(found).T
        apart = [np.abs((ratio - 1) * difference).max() for ratio in ratios]
        shares = [f"{share / np.abs(difference).max():.3f}" for share in apart]
        table.append((case, frame, *shares))
    return table


def main() -> None:
    """Parse the command line, measure, write."""
    parser = output_parser("Derivatives beside differences.", "rendered scenes")
    parser.add_argument("--frames", type=Path, metavar="DIR", help="keeps the frames between runs")
    parser.add_argument("--draws", type=int, default=8)
    parser.add_argument("--step", type=float, default=0.02, help="half the interval; default: 0.02")
    parser.add_argument("--filters", default=",".join(CASES), metavar="NAME:FETCH,...")
    options = parser.parse_args()
    rows: list[Any] = []
    summary: list[Any] = []
    costs: list[Any] = []
    worst: list[Any] = []
    with tempfile.TemporaryDirectory() as temporary:
        frames = options.frames or Path(temporary)
        frames.mkdir(exist_ok=True)
        write_frames(frames, options.reference_data)
        for case in options.filters.split(","):
            found = measure(frames, case, options.draws, options.step)
            label = case.replace(":", ", ")
            joined = join(label, found["before"]["rows"], found["after"]["rows"])
            rows += joined
            summary += summarize(label, joined)
            worst += slopes(label, joined)
            costs += _costs(label, found)
            write_all(options.output, rows, summary, worst, costs)


def _costs(case: str, found: dict[str, dict[str, Any]]) -> list[tuple[Any, ...]]:
    times = {when: result["times"] for when, result in found.items()}
    table = []
    for what, after in times["after"].items():
        passes = [f"{t[what] / t['forward']:.2f}" for t in times.values()]
        table.append((case, what, f"{times['before'][what]:.1f}", f"{after:.1f}", *passes))
    return table


def write_all(output: Path, *tables: Sequence[Any]) -> None:
    """Write rows, summary, slopes and times."""
    shares = "within " + " / ".join(f"{100 * share:g}" for share in WITHIN) + " %"
    measured = ("difference", "its standard error", "sensitivity")
    judged = ("ratio after", "its standard error", "ratio before")
    columns = {
        "ratios": ("filter", "frame", "quantity", *measured, *judged),
        "summary": (
            *("filter", "quantity", "rows", "median before", f"{shares} before"),
            *("median after", f"{shares} after"),
        ),
        "slopes": ("filter", "frame", "worst error before", "after"),
        "times": (
            *("filter", "program", "CPU ms before", "after"),
            *("forward passes before", "forward passes after"),
        ),
    }
    for (name, heads), rows in zip(columns.items(), tables, strict=True):
        write_table(output, name, heads, rows)


if __name__ == "__main__":
    main()
