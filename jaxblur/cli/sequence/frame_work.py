"""The work on one frame of a sequence: what a thread or a worker process runs."""

import argparse
import contextlib
import dataclasses
import functools
import logging
import queue
from collections.abc import Iterator
from typing import Any

from .. import blurring, loading, mattes, outputs
from ..choice import Choice, choose, passed_through
from ..compute import start_jax
from ..filtering import find_filter
from ..loading import Loaded, Source, mismatch
from ..progress import about_frame
from ..scores import scores_of
from .plan import roles

LOG = logging.getLogger("jaxblur")


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

    def read(self, job: Any, _: None) -> Loaded:
        """Read a frame, its truth and its neighbors."""
        from jaxblur.sequence import Shared

        with about_frame(job.frame):
            outputs.warn_of_double_blur(self._at(job))
        numbers = (job.frame, *job.neighbors)
        shared = self.shared or Shared(numbers)
        own, *others = shared.take(numbers, functools.partial(self._read_source, job))
        with about_frame(job.frame):
            loaded = loading.load(self._at(job), self.asked.settings, own.result())
            neighbors = {
                "before" if number < job.frame else "after": neighbor
                for number, source in zip(job.neighbors, others, strict=True)
                if (neighbor := self._seen(job.frame, loaded, number, source)) is not None
            }
            return loaded.with_neighbors(neighbors)

    def _read_source(self, job: Any, number: int) -> Source:
        """Read a frame or its neighbor."""
        with about_frame(number):
            return loading.read(self._at(job, number))

    def _seen(self, frame: int, loaded: Loaded, number: int, source: Any) -> Source | None:
        """A neighbor if the frame may see it, or None with a message."""
        from jaxblur.exr import JaxblurIOError
        from jaxblur.sequence import is_cut

        try:
            neighbor = source.result()
        except JaxblurIOError as error:
            LOG.warning("blurred without frame %d: %s", number, error)
            return None
        if differs := mismatch(loaded, neighbor):
            LOG.warning("blurred without frame %d: %s %s.", number, neighbor.path, differs)
            return None
        first, second = neighbor.buffers, loaded.buffers
        if number > frame:
            first, second = second, first
        if is_cut(first, second, self.arguments.shutter):
            LOG.info(
                "frames %d and %d do not see each other: what they show differs too much, as at a "
                "cut",
                *sorted((number, frame)),
            )
            return None
        return neighbor

    def blur(self, job: Any, loaded: Loaded) -> tuple[Loaded, Choice, Any]:
        """Blur a frame, or pass it through."""
        with about_frame(job.frame):
            start_jax(not self.arguments.no_compile_cache)
            if self.arguments.filter:
                # A worker process has not imported a file that registers the filter.
                find_filter(self.arguments.filter)
            chosen = passed_through(self.asked)
            if job.action != "pass":
                chosen = choose(self.arguments, self.asked, loaded)
            with self._device():
                seed = self._at(job).seed
                blurred = blurring.blur(chosen, loaded, seed)
                changes = mattes.blur(chosen, loaded, seed, [loaded])
                blurred = blurring.after_blur(self.arguments, chosen, loaded, blurred, seed)
            loaded = dataclasses.replace(loaded, changes=changes)
            return loaded.without_neighbor_pixels(), chosen, blurred

    def write(self, job: Any, made: tuple[Loaded, Choice, Any]) -> dict[str, Any]:
        """Write a frame, and score it; returns the entries of the report."""
        from jaxblur.sequence.jobs import MEAN_SPEED

        loaded, chosen, image = made
        with about_frame(job.frame):
            notes = outputs.provenance(self._at(job), chosen, loaded) | job.marks
            notes[MEAN_SPEED] = f"{loaded.mean_speed:.4f}"
            outputs.write(self._at(job), job.outputs, image, notes, loaded)
            if loaded.buffers.ignored:
                LOG.warning("not finite: %s", loaded.buffers.ignored)
            images = {"input": loaded.buffers.color, "output": loaded.picture(image)}
            scored = scores_of(images, loaded)
        sides = {"before": job.frame - 1, "after": job.frame + 1}
        used = loaded.neighbors if outputs.NEIGHBORS in notes else ()
        return {
            "selects": loaded.selects,
            "mean_speed": loaded.mean_speed,
            "filter": chosen.name,
            "neighbors": [sides[side] for side in used],
            "scores": {name: score._asdict() for name, score in scored.items()},
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

    def _at(self, job: Any, number: int | None = None) -> argparse.Namespace:
        """The arguments for the frame of a job, or for one of its neighbors."""
        inputs = job.neighbors.get(number, job.inputs)
        here: dict[str, Any] = {role: inputs.get(role) for role in roles(self.arguments)}
        if self.arguments.seed == "frame":
            here["seed"] = job.frame
        return argparse.Namespace(**vars(self.arguments) | here)
