"""Run the work over the frames of a sequence: threads or Dask, progress, failures."""

import argparse
import collections
import contextlib
import logging
import queue
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from .. import mattes, results, strength, view_files, views
from ..arguments import in_option_names
from ..choice import Choice
from ..compute import start_jax
from ..errors import FAILED, is_foreseeable, message_of
from ..loading import tell_rest
from ..progress import about_frame, messages_once, progress
from . import report
from .frame_work import FrameWork
from .plan import at_job, make_plan, refuse, with_all_frames

LOG = logging.getLogger("jaxblur")

WRITE_FAILURES = 3
"""Frames in a row that cannot be written, after which the run stops."""


def blur_sequence(arguments: argparse.Namespace, asked: Choice) -> int:
    """Blur a sequence.

    Args:
        arguments: of the command.
        asked: filter, parameters and settings from the options.

    Returns:
        0 if every frame is done, 1 if some are not.

    Raises:
        CommandError: before any work, since an option is wrong or an output must not be
            replaced.
    """
    arguments.in_sequence = True
    if arguments.seed is None:
        # A pattern that stands still over a shot looks like dirt on the lens. The number of the
        # frame alone decides, so that a frame is the same in every run and on every machine.
        arguments.seed = "frame"
    runs = [_Run(each, asked) for each in with_all_frames(view_files.each(arguments))]
    if arguments.dry_run:
        for run in runs:
            run.tell_rest()
        jobs = [job for run in runs for job in run.plan.jobs]
        return report.print_plan(jobs, _records(runs), arguments.json)
    for run in runs:
        refuse(run.plan, run.names)
    for run in runs:
        if todo := run.plan.with_action("blur"):
            mattes.warn_of_sharp(run.arguments, todo[0].inputs["input"])
    with messages_once():
        try:
            with _client(arguments, runs) as client:
                for run in runs:
                    run.work(client)
        except KeyboardInterrupt as interruption:
            written, total = sum(r.count_written() for r in runs), sum(len(r.todo) for r in runs)
            raise KeyboardInterrupt(
                f"interrupted; {written} of {total} frames are written; {_way_on(arguments, runs)}"
            ) from interruption
        report.print_outcome(arguments, _records(runs))
        _leave_result(arguments, runs)
    return 0 if all([run.is_done() for run in runs]) else FAILED


@contextlib.contextmanager
def _client(arguments: argparse.Namespace, runs: Sequence["_Run"]) -> Iterator[Any]:
    """The Dask client of all views; None where this process does the work, or there is none."""
    from jaxblur.sequence import cluster_client

    if not arguments.scheduler or not any(run.todo for run in runs):
        yield None
        return
    with cluster_client(arguments.scheduler, arguments.workers or 2) as client:
        yield client


def _way_on(arguments: argparse.Namespace, runs: Sequence["_Run"]) -> str:
    """What to do after an interruption, in words."""
    if not arguments.overwrite:
        return "the same command continues from there"
    if any(run.plan.needs_overwrite() for run in runs):
        return "the same command starts again, since only --overwrite replaces the others"
    return "the same command without --overwrite continues from there"


def _records(runs: Sequence["_Run"]) -> list[dict[str, Any]]:
    """What became of every frame."""
    return [record for run in runs for record in run.records.values()]


def _leave_result(arguments: argparse.Namespace, runs: Sequence["_Run"]) -> None:
    """Write the result folder of all frames that are there, if one is asked for."""
    there = [
        (at_job(run.arguments, job), job, run.records[job.frame].get("seconds", {}).get("blur"))
        for run in runs
        for job in run.done_jobs()
    ]
    if not arguments.result or not there:
        return
    shots = (shot for each in there for shot in results.shots_of_frame(*each))
    results.write(arguments, there[0][0], shots)


class _Run:
    """A run over the frames of a plan, those of one view where each view has files."""

    def __init__(self, arguments: argparse.Namespace, asked: Choice):
        self.arguments, self.asked = arguments, asked
        self.plan, self.names = make_plan(arguments, asked)
        self.todo = self.plan.with_action("blur", "pass")
        self.before = [_times(job) for job in self.todo]
        self.selects: list[bool] = []
        self.view = view_files.label_of(arguments, several=False)
        self.records = {job.frame: report.record_of(job, self.view) for job in self.plan.jobs}

    def tell_rest(self) -> None:
        """Say whether nothing moves in the first frame that is to be blurred."""
        from jaxblur.exr import JaxblurIOError

        for job in self.plan.with_action("blur")[:1]:
            with about_frame(job.frame):
                try:
                    for eye in views.each(at_job(self.arguments, job)):
                        tell_rest(eye, self.asked.settings)
                except JaxblurIOError as error:
                    LOG.warning("cannot be blurred: %s", error)

    def work(self, client: Any) -> None:
        """Work on the frames that are to be blurred or passed through.

        Args:
            client: of a Dask cluster; None for this process.
        """
        whose = f"view {self.view}: " if self.view else ""
        counts = report.counts_in(self.plan.jobs)
        count = len(self.plan.jobs)
        LOG.info("%s%d frame%s: %s", whose, count, "s" if count > 1 else "", counts)
        for job in self.plan.with_action("missing"):
            LOG.error("frame %d: %s", job.frame, job.reason)
        if self.todo:
            self._work(_outcomes(self.arguments, self.asked, self.todo, client))

    def count_written(self) -> int:
        """How many frames are written; a frame may be on disk that no record has yet."""
        pairs = zip(map(_times, self.todo), self.before, strict=True)
        return sum(None not in now and now != earlier for now, earlier in pairs)

    def is_done(self) -> bool:
        """Whether every frame is there, as it should be; what is wrong is reported."""
        same = self.arguments.allow_resize or not self._resized()
        done = all(record["status"] in ("written", "kept") for record in self.records.values())
        return done and same and self._selects_something()

    def _selects_something(self) -> bool:
        """Whether a scale of the motion is for any pixel of any frame; if not, that is reported."""
        if any(self.selects) or len(self.selects) < len(self.plan.jobs):
            return True
        LOG.error("%s of any frame.", strength.SELECTS_NOTHING)
        return False

    def done_jobs(self) -> list[Any]:
        """The jobs whose outputs exist."""
        return [
            job
            for job in self.plan.jobs
            if self.records[job.frame]["status"] in ("written", "kept")
        ]

    def _resized(self) -> bool:
        """Whether frames have another size than most; they are reported."""
        from jaxblur import exr

        sizes = {
            job.frame: exr.inspect(job.outputs[0]).parts[0].display_window[2:]
            for job in self.done_jobs()
        }
        ((usual, _),) = collections.Counter(sizes.values()).most_common(1) or [((0, 0), 0)]
        others = {frame: size for frame, size in sizes.items() if size != usual}
        for frame, (width, height) in others.items():
            LOG.error(
                "frame %d: has %dx%d pixels, most frames have %dx%d; render it again, or pass "
                "--allow-resize.",
                frame,
                width,
                height,
                *usual,
            )
        return bool(others)

    def _work(self, outcomes: Any) -> None:
        refused = 0
        try:
            with progress(len(self.todo)) as tell:
                for outcome in outcomes:
                    self._note(outcome, tell)
                    refused = refused + 1 if outcome.failed_in == "write" else 0
                    if refused == WRITE_FAILURES:
                        LOG.error("%d frames in a row cannot be written; stopping.", refused)
                        break
        finally:
            outcomes.close()

    def _note(self, outcome: Any, tell: Callable[[str], None]) -> None:
        record = self.records[outcome.job.frame]
        record["seconds"] = {k: round(v, 6) for k, v in outcome.seconds.items()}
        with about_frame(outcome.job.frame):
            for level, text in outcome.messages:
                LOG.log(level, "%s", in_option_names(text, vars(self.arguments)))
        if outcome.error is None:
            self.selects.append(outcome.result.pop("selects"))
            record |= outcome.result
            record["status"] = "written"
            times = ", ".join(f"{stage} {t:.2f}" for stage, t in outcome.seconds.items())
            total = sum(outcome.seconds.values())
            tell(f"frame {outcome.job.frame} ok {total:.2f} s ({times})")
            return
        if not is_foreseeable(outcome.error) and outcome.failed_in != "worker":
            raise outcome.error
        reason = in_option_names(message_of(outcome.error), vars(self.arguments))
        record |= {"status": "failed", "reason": reason}
        LOG.error("frame %d: %s", outcome.job.frame, reason)
        tell(f"frame {outcome.job.frame} failed")


def _outcomes(arguments: argparse.Namespace, asked: Choice, todo: list[Any], client: Any) -> Any:
    from jaxblur.sequence import Shared, run_cluster, run_pipeline

    if client is not None:
        return run_cluster(todo, FrameWork(arguments, asked).stages(), client)
    # Imported in this thread, not in the one that computes: imports are best done by one thread.
    start_jax(not arguments.no_compile_cache)
    import jax

    devices: queue.SimpleQueue[Any] = queue.SimpleQueue()
    for device in jax.local_devices():
        devices.put(device)
    shared = Shared(number for job in todo for number in (job.frame, *job.neighbors))
    return run_pipeline(todo, FrameWork(arguments, asked, devices, shared).stages())


def _times(job: Any) -> list[int | None]:
    """Modification time of each output of a frame, None where there is no file."""
    return [path.stat().st_mtime_ns if path.exists() else None for path in job.outputs]
