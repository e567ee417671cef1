"""What a run will do or has done with each frame: records, printed as a table or as JSON."""

import argparse
import dataclasses
import json
import logging
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from ..console import print_line, print_table
from ..errors import FAILED
from ..scores import SCORE_COLUMNS, in_words, score_cells

LOG = logging.getLogger("jaxblur")


def record_of(job: Any, view: str | None = None) -> dict[str, Any]:
    """The record of a frame before any work; the run fills in what became of it.

    Args:
        job: of the frame.
        view: that its files are of, where each view has files.
    """
    status = {"keep": "kept", "missing": "missing"}.get(job.action, "not done")
    return {
        "frame": job.frame,
        **({} if view is None else {"view": view}),
        "action": job.action,
        "status": status,
        "reason": job.reason,
        "outputs": [str(path) for path in job.outputs],
        "mean_speed": job.mean_speed,
        "neighbors": list(job.neighbors),
    }


def scores_record(views: Sequence[str | None], scored: Sequence[Mapping[str, Any]]) -> Any:
    """The entries of a record with the scores of a frame.

    Args:
        views: their names.
        scored: of each, as `scores_of` gives them.

    Returns:
        ``scores`` of a frame without views; ``scores_of_views`` by view of one that has several.
    """
    rows = [{name: score._asdict() for name, score in each.items()} for each in scored]
    if len(rows) == 1:
        return {"scores": rows[0]}
    return {"scores_of_views": dict(zip(views, rows, strict=True))}


def print_plan(jobs: Sequence[Any], records: Sequence[Any], as_json: bool) -> int:
    """Print what would be done with each frame.

    Args:
        jobs: of the frames.
        records: of the same, see `record_of`.
        as_json: the records, else a table.

    Returns:
        0, or 1 if a frame is missing or must not be written.
    """
    if as_json:
        print(json.dumps({"frames": records}, indent=2))
    else:
        rows = [(job.frame, job.action, job.reason, job.outputs[0]) for job in jobs]
        print_table((">frame", "action", "why", "output"), rows)
        print_line(counts_in(jobs))
    return FAILED if any(job.action in ("missing", "refuse") for job in jobs) else 0


def print_outcome(arguments: argparse.Namespace, records: list[dict[str, Any]]) -> None:
    """Print what became of each frame, and warn of frames that look like camera cuts.

    Args:
        arguments: of the command.
        records: of all frames, filled in by the run.
    """
    from jaxblur.sequence import find_cuts

    speeds: dict[str | None, dict[int, float]] = {}
    for record in records:
        if record["mean_speed"] is not None and record["action"] != "pass":
            speeds.setdefault(record.get("view"), {})[record["frame"]] = record["mean_speed"]
    # The files of each view have the cuts of the shot; one of them is enough to see one.
    found = {cut.frame: cut for of_view in speeds.values() for cut in find_cuts(of_view)}
    cuts = [found[frame] for frame in sorted(found)]
    for cut in cuts:
        LOG.warning(
            "frame %d: its vectors have a mean length of %.1f px, its neighbors' %.1f; if the "
            "camera cuts here, pass --cut %d to leave the frame unblurred.",
            cut.frame,
            cut.speed,
            cut.usual,
            cut.frame,
        )
    if arguments.json:
        cut_frames = [dataclasses.asdict(cut) for cut in cuts]
        print(json.dumps({"frames": records, "cuts": cut_frames}, indent=2))
        return
    print_line(f"{arguments.output}: {_counts(r['status'] for r in records)}")
    print_scores(records)


def print_scores(records: Sequence[Mapping[str, Any]]) -> None:
    """Print the scores of frames that have a truth, and their means.

    Args:
        records: of the frames: ``frame``, ``filter``, ``view`` where each view has files, and the
            entries of `scores_record`.
    """
    if rows := _score_rows(records):
        print_table(("frame", *SCORE_COLUMNS), rows)


def counts_in(jobs: Sequence[Any]) -> str:
    """How many frames are to be blurred, kept and so on."""
    return _counts(job.action for job in jobs)


def _counts(words: Iterable[str]) -> str:
    """Count words: ``238 written, 2 kept``."""
    counts: dict[str, int] = {}
    for word in words:
        counts[word] = counts.get(word, 0) + 1
    return ", ".join(f"{count} {word}" for word, count in counts.items())


def _score_rows(records: Sequence[Mapping[str, Any]]) -> list[tuple[Any, ...]]:
    """A row for each frame that has a truth, and the means."""
    scored = [
        (record, view, scores)
        for record in records
        for view, scores in _scores_by_view(record).items()
    ]
    rows = [
        (record["frame"], *score_cells(in_words(view, "output", record["filter"]), each["output"]))
        for record, view, each in scored
    ]
    methods = {record["filter"] for record, *_ in scored}
    method = methods.pop() if len(methods) == 1 else "output"
    for seen in dict.fromkeys(view for _, view, _ in scored):
        for name in ("input", "output"):
            each = [scores[name] for _, view, scores in scored if view == seen]
            mean = {key: sum(score[key] for score in each) / len(each) for key in each[0]}
            rows.append(("mean", *score_cells(in_words(seen, name, method), mean)))
    return rows


def _scores_by_view(record: Mapping[str, Any]) -> Mapping[str | None, Any]:
    """The scores of a record by view, which is None for a frame without views."""
    if scores := record.get("scores"):
        return {record.get("view"): scores}
    return {view: each for view, each in record.get("scores_of_views", {}).items() if each}
