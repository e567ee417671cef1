"""The work on one frame of a sequence: what a thread or a worker process runs."""

import argparse
import contextlib
import dataclasses
import functools
import logging
import queue
from collections.abc import Iterator
from typing import Any, NamedTuple

from .. import blurring, loading, mattes, outputs, views
from ..choice import Choice, choose, passed_through
from ..compute import start_jax
from ..filtering import find_filter
from ..loading import Loaded, Source, mismatch, placed
from ..progress import about_frame
from ..scores import scores_of
from . import report
from .plan import at_job

LOG = logging.getLogger("jaxblur")


class View(NamedTuple):
    """A view of a frame, or a frame without views.

    Attributes:
        arguments: of the command for this view; see `views.each`.
        loaded: as it was read.
    """

    arguments: argparse.Namespace
    loaded: Loaded


@functools.cache
def _start_worker(compile_cache: bool, method: str | None) -> None:
    """Prepare a worker process, once for all of its frames."""
    start_jax(compile_cache)
    if method:
        # It has not imported a file that registers the filter.
        find_filter(method)


@dataclasses.dataclass(frozen=True)
class FrameWork:
    """The stages of one frame of a sequence.

    Attributes:
        arguments: of the command.
        asked: filter, parameters and settings from the options.
        devices: free devices, or None for JAX's default device.
        shared: frames that were read and are needed again, a `jaxblur.sequence.Shared`, or None
            where frames are blurred by several processes.
    """

    arguments: argparse.Namespace
    asked: Choice
    devices: queue.SimpleQueue[Any] | None = None
    shared: Any = None

    def read(self, job: Any, _: None) -> list[View]:
        """Read the views of a frame, its truth and its neighbors."""
        from jaxblur.sequence import Shared

        numbers = (job.frame, *job.neighbors)
        shared = self.shared or Shared(numbers)
        own, *others = shared.take(numbers, functools.partial(self._read_sources, job))
        with about_frame(job.frame):
            eyes = views.each(at_job(self.arguments, job))
            self._check_files(job, eyes)
            for eye in eyes:
                outputs.warn_of_double_blur(eye)
            frames = [
                loading.load(eye, self.asked.settings, source)
                for eye, source in zip(eyes, own.result(), strict=True)
            ]
            views.check_alike(frames, [eye.layer for eye in eyes])
            near: list[dict[str, Source]] = [{} for _ in frames]
            for number, future in zip(job.neighbors, others, strict=True):
                side = "before" if number < job.frame else "after"
                for eye, source in enumerate(self._seen(job.frame, frames, number, future)):
                    near[eye][side] = source
            return [
                View(eye, frame.with_neighbors(neighbors))
                for eye, frame, neighbors in zip(eyes, frames, near, strict=True)
            ]

    def _check_files(self, job: Any, eyes: list[argparse.Namespace]) -> None:
        """Reject a frame whose views are others than those that pictures are named after."""
        from jaxblur.exr import JaxblurIOError
        from jaxblur.sequence import parse_names

        names = [eye.layer for eye in eyes]
        files = outputs.files_of(self.arguments, parse_names(self.arguments.output), names)
        if [each.path(job.frame).name for each in files] != [path.name for path in job.outputs]:
            raise JaxblurIOError(
                eyes[0].input,
                "has other views than the first frame, after whose views pictures are named; "
                "choose views that all frames have with --views, or blur this frame alone.",
            )

    def _read_sources(self, job: Any, number: int) -> list[Source]:
        """Read the views of a frame or of its neighbor."""
        with about_frame(number):
            return [loading.read(eye) for eye in views.each(at_job(self.arguments, job, number))]

    def _seen(self, frame: int, frames: list[Loaded], number: int, sources: Any) -> list[Source]:
        """The views of a neighbor if all of them may be seen, or none with a message."""
        from jaxblur.exr import JaxblurIOError

        try:
            neighbor = sources.result()
        except JaxblurIOError as error:
            LOG.warning("blurred without frame %d: %s", number, error)
            return []
        if len(neighbor) != len(frames):
            LOG.warning("blurred without frame %d: it has other views.", number)
            return []
        seen = all(
            self._sees(frame, loaded, number, source)
            for loaded, source in zip(frames, neighbor, strict=True)
        )
        if not seen:
            return []
        return [
            placed(source, loaded.buffers.windows.data)
            for loaded, source in zip(frames, neighbor, strict=True)
        ]

    def _sees(self, frame: int, loaded: Loaded, number: int, neighbor: Source) -> bool:
        """Whether a frame may see a neighbor; if not, a message says why."""
        from jaxblur.sequence import is_cut

        if differs := mismatch(loaded, neighbor):
            LOG.warning("blurred without frame %d: %s %s.", number, neighbor.path, differs)
            return False
        first, second = neighbor.buffers, loaded.buffers
        if number > frame:
            first, second = second, first
        if is_cut(first, second, self.arguments.shutter):
            LOG.info(
                "frames %d and %d do not see each other: what they show differs too much, as at a "
                "cut",
                *sorted((number, frame)),
            )
            return False
        return True

    def blur(self, job: Any, frames: list[View]) -> tuple[Choice, list[tuple[View, Any]]]:
        """Blur the views of a frame, or pass it through."""
        with about_frame(job.frame):
            if self.devices is None:
                _start_worker(not self.arguments.no_compile_cache, self.arguments.filter)
            chosen = passed_through(self.asked)
            if job.action != "pass":
                fastest = max(frames, key=lambda view: view.loaded.speeds.suggested_radius)
                chosen = choose(self.arguments, self.asked, fastest.loaded)
            with self._device():
                return chosen, [self._blur_view(view, chosen) for view in frames]

    def _blur_view(self, view: View, choice: Choice) -> tuple[View, Any]:
        """Blur a view; returns it without what is not needed any more."""
        eye, loaded = view
        chosen = views.with_samples(eye, choice)
        blurred = blurring.blur(chosen, loaded, eye.seed)
        changes = mattes.blur(chosen, loaded, eye.seed, [loaded])
        blurred = blurring.after_blur(eye, chosen, loaded, blurred, eye.seed)
        left = dataclasses.replace(loaded, changes=changes).without_neighbor_pixels()
        return View(eye, left), blurred

    def write(self, job: Any, blurred: tuple[Choice, list[tuple[View, Any]]]) -> dict[str, Any]:
        """Write a frame, and score it; returns the entries of the report."""
        from jaxblur.sequence.jobs import MEAN_SPEED

        chosen, pictures = blurred
        eyes = [view.arguments for view, _ in pictures]
        made = [(view.loaded, image) for view, image in pictures]
        with about_frame(job.frame):
            whole, _ = views.merged(made)
            notes = outputs.provenance(eyes[0], chosen, whole, views.notes(eyes)) | job.marks
            notes[MEAN_SPEED] = f"{whole.mean_speed:.4f}"
            outputs.write(eyes[0], job.outputs, notes, made)
            scored = [scores_of(loaded, image) for loaded, image in made]
        sides = {"before": job.frame - 1, "after": job.frame + 1}
        used = whole.neighbors if outputs.NEIGHBORS in notes else ()
        return {
            "selects": whole.selects,
            "mean_speed": whole.mean_speed,
            "filter": chosen.name,
            "neighbors": [sides[side] for side in used],
            **report.scores_record([eye.layer for eye in eyes], scored),
        }

    def stages(self) -> tuple[Any, ...]:
        """The stages, in order, for `jaxblur.sequence`; every device blurs a frame at a time."""
        from jaxblur.sequence import Stage

        count = 1 if self.devices is None else self.devices.qsize()
        return (
            Stage("read", self.read, 1 + count),
            Stage("blur", self.blur, count),
            Stage("write", self.write, 1 + count),
        )

    @contextlib.contextmanager
    def _device(self) -> Iterator[None]:
        if self.devices is None:
            yield
            return
        import jax

        device = self.devices.get()
        try:
            with jax.default_device(device):
                yield
        finally:
            self.devices.put(device)
