"""Every claim with a number in the sources that this package can test, beside what is so here.

    python -m experiments.018_claims.run --reference-data DIR [-o OUT] [--claims NAME,NAME]

Writes results.json, with all numbers of each claim, to OUT (default: this folder), and the table to
README.md beside it, between the markers. A run of some claims keeps the results of the others.
DIR holds rendered scenes as `experiments/blender` writes them; without it scenes of the catalogue
stand for them. ``--tiny`` shows that a run works.
"""

import argparse
import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from . import costs, inputs, paths, samples, tiles
from .claim import TINY, Claim, Extent, Row
from .elsewhere import ROWS

CLAIMS: Mapping[str, Claim] = {
    claim.__name__: claim
    for module in (samples, tiles, costs, inputs, paths)
    for claim in module.CLAIMS
}
FOLDER = Path(__file__).parent
START, END = "<!-- table -->", "<!-- end of the table -->"
COLUMNS = ("claim", "source", "how tested", "theirs", "ours", "verdict")


def write_rows(path: Path, rows: Mapping[str, Row]) -> None:
    """Write rows with all their numbers as JSON, in the order of `CLAIMS`."""
    data = {name: dataclasses.asdict(rows[name]) for name in CLAIMS if name in rows}
    path.write_text(json.dumps(data, indent=1, default=_plain) + "\n", encoding="utf-8")


def _plain(value: Any) -> Any:
    """A NumPy or JAX number as one that JSON holds."""
    return np.asarray(value).tolist()


def read_rows(path: Path) -> dict[str, Row]:
    """The rows of a results file by the name of their claim; none if there is no file."""
    if not path.is_file():
        return {}
    data = json.loads(path.read_text(encoding="utf-8"))
    return {name: Row(**row) for name, row in data.items()}


def table(rows: Mapping[str, Row]) -> str:
    """A Markdown table, one line a claim: those measured here, then those of other pages."""
    fields = ("claim", "source", "tested", "theirs", "ours", "verdict")
    lines = [f"| {' | '.join(COLUMNS)} |", f"|{'---|' * len(COLUMNS)}"]
    every = [*(rows[name] for name in CLAIMS if name in rows), *ROWS]
    lines += [f"| {' | '.join(getattr(row, name) for name in fields)} |" for row in every]
    return "\n".join(lines) + "\n"


def with_table(page: str, text: str) -> str:
    """A page whose part between the markers is replaced.

    Raises:
        ValueError: the page lacks a marker.
    """
    before, start, rest = page.partition(START)
    _, end, after = rest.partition(END)
    if not start or not end:
        raise ValueError(f"the page must hold the markers {START} and {END}; put them back.")
    return f"{before}{START}\n\n{text}\n{END}{after}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure the claims that are asked for, one after the other, and write what is known."""
    parser = argparse.ArgumentParser(description="Test the claims of the sources.")
    parser.add_argument("-o", "--output", type=Path, default=FOLDER, metavar="OUT")
    parser.add_argument("--claims", default=",".join(CLAIMS), help="default: all")
    parser.add_argument("--reference-data", type=Path, metavar="DIR", help="rendered scenes")
    parser.add_argument("--tiny", action="store_true", help="a run that shows that it works")
    options = parser.parse_args(arguments)
    chosen = options.claims.split(",")
    for name in chosen:
        if name not in CLAIMS:
            parser.error(f"--claims must be some of {', '.join(CLAIMS)}, got {name!r}.")
    results, page = options.output / "results.json", options.output / "README.md"
    if not page.is_file():
        parser.error(f"{page} is missing; copy that of {FOLDER} there.")
    extent = dataclasses.replace(
        TINY if options.tiny else Extent(), reference=options.reference_data
    )
    for name in chosen:
        rows = read_rows(results) | {name: CLAIMS[name](extent)}
        write_rows(results, rows)
        jax.clear_caches()
        page.write_text(with_table(page.read_text(encoding="utf-8"), table(rows)), encoding="utf-8")
        print(f"{name}: {rows[name].ours}: {rows[name].verdict}", flush=True)


if __name__ == "__main__":
    main()
