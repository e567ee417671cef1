"""``jaxblur blur`` on sequences: names and options, the plan, the run, and its report."""

import argparse
import collections
import contextlib
import dataclasses
import functools
import hashlib
import json
import logging
import os
import pathlib
import queue
from collections.abc import Callable, Iterator
from typing import Any

import jaxblur

from . import mattes, results, stack, stages, strength
from .arguments import CommandError, frame_numbers, in_option_names, positive_integer
from .compute import start_jax
from .console import print_line, print_table
from .errors import is_foreseeable, message_of
from .filtering import find_filter, takes_neighbors
from .progress import about_frame, frame_messages, progress
from .recognition import settle_convention
from .shutter import OPTIONS

LOG = logging.getLogger("jaxblur")

FAILED = 1
WRITE_FAILURES = 3
"""Frames in a row that cannot be written, after which the run stops."""

# Options that do not change the pixels of an output: places, messages, workers. The file of
# parameters counts by its contents.
NOT_A_CHOICE = frozenset(
    {
        *("command", "run", "verbose", "quiet", "input", "output", "frames", "cut", "parameters"),
        *("overwrite", "skip_existing", "dry_run", "json", "png", "scheduler", "workers"),
        *("truth", "truth_layer", "result", "velocity_from", "depth_from", "no_compile_cache"),
        # A file of cameras counts by its contents.
        *("matte_from", "camera"),
        # The quality counts by its samples.
        *(
            "quality",
            "allow_resize",
            "argv",
            "isolate",
            "memory",
            "time_limit",
            "threads",
            "fps",
            "require_motion",
        ),
        # Cryptomattes count by whether they are blurred.
        "cryptomatte",
        # Neighbors count by whether they are used; the others are for single frames.
        *("neighbors", "before", "after", "subframes"),
        # The exposure counts by its times and its points.
        *("exposure", *OPTIONS),
        # Layers count by what is known of each before it is read; their files are inputs.
        *("layers", "holdout", "still"),
    }
)


def add_options(parser: argparse.ArgumentParser, existing: Any) -> None:
    """Add the options that only sequences have.

    Args:
        parser: of the command.
        existing: group of the ways to treat outputs that exist.
    """
    existing.add_argument(
        "--skip-existing",
        action="store_true",
        help="keep frames that were made in the same way (the default without --overwrite); "
        "any other file in the place of an output is an error",
    )
    group = parser.add_argument_group("sequences, whose names hold ####, %04d, @@@@ or $F4")
    group.add_argument(
        "-F",
        "--frames",
        type=frame_numbers,
        metavar="A-B[xN]",
        help="such as 1001-1240 or 1-100x2,107 (default: all frames found)",
    )
    group.add_argument(
        "--cut",
        type=frame_numbers,
        default=[],
        metavar="A,B",
        help="pass these frames through unblurred: at a camera cut vectors mean nothing",
    )
    group.add_argument(
        "--neighbors",
        choices=("auto", "off"),
        help="auto (the default): a filter that takes them, as layered does, sees the frames "
        "before and after, if they exist and no cut lies between; off: each frame alone",
    )
    group.add_argument(
        "--allow-resize",
        action="store_true",
        help="accept frames of another size than most (otherwise they give exit status 1)",
    )
    group.add_argument("--dry-run", action="store_true", help="print the plan, write nothing")
    group.add_argument("--json", action="store_true", help="print the plan or the outcome as JSON")
    group.add_argument(
        "--scheduler",
        metavar="local|ADDRESS",
        help="hand frames to processes on this machine, or to the Dask scheduler at an address "
        "such as tcp://farm:8786",
    )
    group.add_argument(
        "--workers",
        type=positive_integer,
        metavar="N",
        help="processes of --scheduler local (default 2)",
    )


def is_asked_for(arguments: argparse.Namespace) -> bool:
    """Whether the name of the input is that of a sequence."""
    from jaxblur.sequence import has_frame_number

    return arguments.frames is not None or has_frame_number(arguments.input)


def refuse_options(arguments: argparse.Namespace) -> None:
    """Reject options of sequences for a single frame.

    Raises:
        CommandError: one is given.
    """
    options = ("cut", "dry_run", "json", "skip_existing", "scheduler", "workers", "neighbors")
    for name in options:
        if getattr(arguments, name):
            raise CommandError(
                f"--{name.replace('_', '-')}: is for sequences; write the input as name.####.exr."
            )


def run(arguments: argparse.Namespace, asked: stages.Choice) -> int:
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
    from jaxblur.sequence import has_frame_number, plan_jobs

    arguments.in_sequence = True
    if arguments.seed is None:
        # A pattern that stands still over a shot looks like dirt on the lens. The number of the
        # frame alone decides, so that a frame is the same in every run and on every machine.
        arguments.seed = "frame"
    if arguments.workers and arguments.scheduler != "local":
        raise CommandError("--workers: is for --scheduler local.")
    for name in ("before", "after", "subframes"):
        if getattr(arguments, name):
            also = "" if name == "subframes" else ", which finds its neighbors by itself"
            raise CommandError(f"--{name}: is for a single frame, not for a sequence{also}.")
    sources, outputs = _names(arguments)
    frames = arguments.frames or frames_on_disk(sources["input"])
    if arguments.truth is not None and len(frames) > 1 and not has_frame_number(arguments.truth):
        raise CommandError(
            f"--truth: {arguments.truth} is one file for {len(frames)} frames; write it as "
            "truth.####.exr."
        )
    for frame in arguments.cut:
        if frame not in frames:
            raise CommandError(f"--cut: frame {frame} is not among the frames of this run.")
    settle_convention(arguments, sources)
    neighbors = _uses_neighbors(arguments, asked)
    choices = _choices(arguments, asked) | ({"neighbors": True} if neighbors else {})
    choices |= {"cryptomatte": True} if arguments.cryptomatte else {}
    plan = plan_jobs(
        *(frames, sources, outputs, choices),
        overwrite=arguments.overwrite,
        cuts=arguments.cut,
        neighbors=neighbors,
    )
    if arguments.dry_run:
        return _print_plan(plan, arguments.json)
    _refuse(plan, sources["input"])
    if todo := plan.with_action("blur"):
        mattes.warn_of_sharp(arguments, todo[0].inputs["input"])
    return _Run(arguments, asked, plan).run()


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
    asked: stages.Choice
    devices: queue.SimpleQueue[Any] | None = None
    shared: Any = None

    def read(self, job: Any, _: None) -> stages.Loaded:
        """Read a frame, its truth and its neighbors."""
        from jaxblur.sequence import Shared

        with about_frame(job.frame):
            stages.warn_of_double_blur(self._at(job))
        numbers = (job.frame, *job.neighbors)
        shared = self.shared or Shared(numbers)
        own, *others = shared.take(numbers, functools.partial(self._read_source, job))
        with about_frame(job.frame):
            loaded = stages.load(self._at(job), self.asked.settings, own.result())
            neighbors = {
                "before" if number < job.frame else "after": neighbor
                for number, source in zip(job.neighbors, others, strict=True)
                if (neighbor := self._seen(job.frame, loaded, number, source)) is not None
            }
            return loaded.with_neighbors(neighbors)

    def _read_source(self, job: Any, number: int) -> stages.Source:
        """Read a frame or its neighbor."""
        with about_frame(number):
            return stages.read(self._at(job, number))

    def _seen(
        self, frame: int, loaded: stages.Loaded, number: int, source: Any
    ) -> stages.Source | None:
        """A neighbor if the frame may see it, or None with a message."""
        from jaxblur.exr import JaxblurIOError
        from jaxblur.sequence import is_cut

        try:
            neighbor = source.result()
        except JaxblurIOError as error:
            LOG.warning("blurred without frame %d: %s", number, error)
            return None
        if differs := stages.mismatch(loaded, neighbor):
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

    def blur(self, job: Any, loaded: stages.Loaded) -> tuple[stages.Loaded, stages.Choice, Any]:
        """Blur a frame, or pass it through."""
        with about_frame(job.frame):
            start_jax(not self.arguments.no_compile_cache)
            if self.arguments.filter:
                # A worker process has not imported a file that registers the filter.
                find_filter(self.arguments.filter)
            chosen = stages.passed_through(self.asked)
            if job.action != "pass":
                chosen = stages.choose(self.arguments, self.asked, loaded)
            with self._device():
                seed = self._at(job).seed
                blurred = stages.blur(chosen, loaded, seed)
                changes = mattes.blur(chosen, loaded, seed, [loaded])
                blurred = stages.after_blur(self.arguments, chosen, loaded, blurred, seed)
            loaded = dataclasses.replace(loaded, changes=changes)
            return loaded.without_neighbor_pixels(), chosen, blurred

    def write(self, job: Any, made: tuple[stages.Loaded, stages.Choice, Any]) -> dict[str, Any]:
        """Write a frame, and score it; returns the entries of the report."""
        from jaxblur.sequence.jobs import MEAN_SPEED

        loaded, chosen, image = made
        with about_frame(job.frame):
            notes = stages.provenance(self._at(job), chosen, loaded) | job.marks
            notes[MEAN_SPEED] = f"{loaded.mean_speed:.4f}"
            stages.write(self._at(job), job.outputs, image, notes, loaded)
            if loaded.buffers.ignored:
                LOG.warning("not finite: %s", loaded.buffers.ignored)
            images = {"input": loaded.buffers.color, "output": loaded.picture(image)}
            scored = stages.scores_of(images, loaded)
        sides = {"before": job.frame - 1, "after": job.frame + 1}
        used = loaded.neighbors if stages.NEIGHBORS in notes else ()
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
        here: dict[str, Any] = {role: inputs.get(role) for role in _roles(self.arguments)}
        if self.arguments.seed == "frame":
            here["seed"] = job.frame
        return argparse.Namespace(**vars(self.arguments) | here)


def _roles(arguments: argparse.Namespace) -> tuple[str, ...]:
    """The roles of all files of a frame."""
    return (*stack.roles(arguments), "velocity_from", "depth_from", "matte_from", "truth")


class _Run:
    """A run over the frames of a plan, and its report."""

    def __init__(self, arguments: argparse.Namespace, asked: stages.Choice, plan: Any):
        self.arguments, self.asked, self.plan = arguments, asked, plan
        self.selects: list[bool] = []
        self.records = {job.frame: _record(job) for job in plan.jobs}

    def run(self) -> int:
        """Run the plan and report the outcome."""
        todo = self.plan.with_action("blur", "pass")
        LOG.info("%d frames: %s", len(self.plan.jobs), _counts_in(self.plan))
        for job in self.plan.with_action("missing"):
            LOG.error("frame %d: %s", job.frame, job.reason)
        if todo:
            self._work(todo)
        self._report()
        self._leave_result()
        same = self.arguments.allow_resize or not self._resized()
        done = all(record["status"] in ("written", "kept") for record in self.records.values())
        return 0 if done and same and self._selects_something() else FAILED

    def _selects_something(self) -> bool:
        """Whether a scale of the motion is for any pixel of any frame; if not, that is reported."""
        if any(self.selects) or len(self.selects) < len(self.plan.jobs):
            return True
        LOG.error("%s of any frame.", strength.SELECTS_NOTHING)
        return False

    def _done(self) -> list[Any]:
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
            for job in self._done()
        }
        ((usual, _),) = collections.Counter(sizes.values()).most_common(1) or [((0, 0), 0)]
        others = {frame: size for frame, size in sizes.items() if size != usual}
        for frame, (width, height) in others.items():
            LOG.error(
                "frame %d: has %dx%d pixels, most frames have %dx%d; render it again, or pass "
                "--allow-resize.",
                *(frame, width, height, *usual),
            )
        return bool(others)

    def _leave_result(self) -> None:
        there = self._done()
        if self.arguments.result and there:
            results.write(self.arguments, results.shots_of_frames(self.arguments, there))

    def _work(self, todo: list[Any]) -> None:
        outcomes = _outcomes(self.arguments, self.asked, todo)
        before = [_times(job) for job in todo]
        refused = 0
        try:
            with frame_messages(), progress(len(todo)) as tell:
                for outcome in outcomes:
                    self._note(outcome, tell)
                    refused = refused + 1 if outcome.failed_in == "write" else 0
                    if refused == WRITE_FAILURES:
                        LOG.error("%d frames in a row cannot be written; stopping.", refused)
                        break
        except KeyboardInterrupt as interruption:
            # Stages that run are finished first, so frames may be on disk that no record has yet.
            outcomes.close()
            pairs = zip(map(_times, todo), before, strict=True)
            written = sum(None not in now and now != earlier for now, earlier in pairs)
            raise KeyboardInterrupt(
                f"interrupted; {written} of {len(todo)} frames are written; the same command "
                "continues from there"
            ) from interruption
        finally:
            outcomes.close()

    def _note(self, outcome: Any, tell: Callable[[str], None]) -> None:
        record = self.records[outcome.job.frame]
        record["seconds"] = {k: round(v, 3) for k, v in outcome.seconds.items()}
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

    def _report(self) -> None:
        from jaxblur.sequence import find_cuts

        records = list(self.records.values())
        speeds = {
            record["frame"]: record["mean_speed"]
            for record in records
            if record["mean_speed"] is not None and record["action"] != "pass"
        }
        cuts = find_cuts(speeds)
        for cut in cuts:
            LOG.warning(
                "frame %d: its vectors have a mean length of %.1f px, its neighbors' %.1f; if the "
                "camera cuts here, pass --cut %d to leave the frame unblurred.",
                *(cut.frame, cut.speed, cut.usual, cut.frame),
            )
        if self.arguments.json:
            cut_frames = [dataclasses.asdict(cut) for cut in cuts]
            print(json.dumps({"frames": records, "cuts": cut_frames}, indent=2))
            return
        print_line(f"{self.arguments.output}: {_counts(r['status'] for r in records)}")
        rows = _score_rows(records)
        if rows:
            print_table(("frame", *stages.SCORE_COLUMNS), rows)


def _outcomes(arguments: argparse.Namespace, asked: stages.Choice, todo: list[Any]) -> Any:
    from jaxblur.sequence import Shared, run_cluster, run_pipeline

    if arguments.scheduler:
        work = FrameWork(arguments, asked).stages()
        return run_cluster(todo, work, arguments.scheduler, arguments.workers or 2)
    # Imported in this thread, not in the one that computes: imports are best done by one thread.
    start_jax(not arguments.no_compile_cache)
    import jax

    devices: queue.SimpleQueue[Any] = queue.SimpleQueue()
    for device in jax.local_devices():
        devices.put(device)
    shared = Shared(number for job in todo for number in (job.frame, *job.neighbors))
    return run_pipeline(todo, FrameWork(arguments, asked, devices, shared).stages())


def _uses_neighbors(arguments: argparse.Namespace, asked: stages.Choice) -> bool:
    """Whether frames may see their neighbors; a plan may choose a filter that takes them."""
    if arguments.neighbors == "off" or arguments.shutter == 0:
        return False
    if strength.looks_at_neighbors(arguments):
        return True
    return arguments.plan is not None or takes_neighbors(asked.name)


def _names(arguments: argparse.Namespace) -> tuple[dict[str, Any], list[Any]]:
    """Names of the inputs by role, and of the outputs."""
    from jaxblur.sequence import has_frame_number, parse_names

    def placed(path: pathlib.Path) -> pathlib.Path:
        # Workers may stand in another folder.
        return pathlib.Path(os.path.abspath(path)) if arguments.scheduler else path

    given = {role: getattr(arguments, role) for role in _roles(arguments)}
    sources = {
        role: parse_names(placed(path)) if has_frame_number(path) or role == "input" else path
        for role, path in given.items()
        if path is not None
    }
    stages.check_output(arguments.output)
    output = parse_names(placed(arguments.output))
    with_png = arguments.png and arguments.output.suffix.lower() != ".png"
    return sources, [output, *([output.with_suffix(".png")] if with_png else [])]


def _times(job: Any) -> list[int | None]:
    """Modification time of each output of a frame, None where there is no file."""
    return [path.stat().st_mtime_ns if path.exists() else None for path in job.outputs]


def frames_on_disk(names: Any) -> list[int]:
    """The frames of a sequence that exist; missing ones between them give a warning.

    Args:
        names: a `jaxblur.sequence.FrameNames`.

    Returns:
        Their numbers, ascending.

    Raises:
        CommandError: there is none.
    """
    from jaxblur.sequence import missing_frames

    frames = names.frames_on_disk()
    if not frames:
        raise CommandError(f"{names.pattern}: no such frames{_padding_hint(names)}.")
    missing = missing_frames(frames)
    if missing:
        LOG.warning("%s: missing frames: %s.", names.pattern, missing)
    return frames


def _padding_hint(names: Any) -> str:
    other = names.other_padding()
    return f"; {other} has another padding; ## stands for two digits" if other else ""


def _choices(arguments: argparse.Namespace, asked: stages.Choice) -> dict[str, Any]:
    """Every choice that determines an output besides its inputs.

    A new option counts unless it is named in `NOT_A_CHOICE`, a new setting unless it has its
    default.
    """
    places = NOT_A_CHOICE | {*stack.roles(arguments)}
    given = {key: value for key, value in vars(arguments).items() if key not in places}
    if arguments.filter and ":" in arguments.filter:
        given["filter_file"] = _sha256(arguments.filter.rpartition(":")[0])
    if arguments.exposure is not None:
        given["exposure"] = arguments.exposure._asdict()
    is_file = isinstance(arguments.camera, pathlib.Path)
    given["camera"] = _sha256(str(arguments.camera)) if is_file else arguments.camera
    usual = dataclasses.asdict(type(asked.settings)())
    changed = {k: v for k, v in dataclasses.asdict(asked.settings).items() if v != usual[k]}
    chosen = {"name": asked.name, "parameters": dict(asked.parameters), "settings": changed}
    return given | chosen | {"version": jaxblur.__version__}


def _sha256(path: str) -> str:
    return hashlib.sha256(pathlib.Path(path).read_bytes()).hexdigest()


def _refuse(plan: Any, names: Any) -> None:
    """Stop before any work if an output must not be replaced, or if there is no input."""
    refused, missing = plan.with_action("refuse"), plan.with_action("missing")
    if refused:
        more = f" (and {len(refused) - 1} more)" if len(refused) > 1 else ""
        raise CommandError(f"{refused[0].reason}{more}.")
    if len(missing) == len(plan.jobs):
        raise CommandError(
            f"{missing[0].reason}, nor any other frame asked for{_padding_hint(names)}."
        )


def _print_plan(plan: Any, as_json: bool) -> int:
    if as_json:
        print(json.dumps({"frames": [_record(job) for job in plan.jobs]}, indent=2))
    else:
        rows = [(job.frame, job.action, job.reason, job.outputs[0]) for job in plan.jobs]
        print_table((">frame", "action", "why", "output"), rows)
        print_line(_counts_in(plan))
    return FAILED if plan.with_action("missing", "refuse") else 0


def _record(job: Any) -> dict[str, Any]:
    """The report's record of a frame, before any work."""
    status = {"keep": "kept", "missing": "missing"}.get(job.action, "not done")
    return {
        "frame": job.frame,
        "action": job.action,
        "status": status,
        "reason": job.reason,
        "outputs": [str(path) for path in job.outputs],
        "mean_speed": job.mean_speed,
        "neighbors": list(job.neighbors),
    }


def _counts_in(plan: Any) -> str:
    return _counts(job.action for job in plan.jobs)


def _counts(words: Iterator[str]) -> str:
    """Count words: ``238 written, 2 kept``."""
    counts: dict[str, int] = {}
    for word in words:
        counts[word] = counts.get(word, 0) + 1
    return ", ".join(f"{count} {word}" for word, count in counts.items())


def _score_rows(records: list[dict[str, Any]]) -> list[tuple[Any, ...]]:
    """A row for each frame that has a truth, and the means."""
    scored = [record for record in records if record.get("scores")]
    rows = [(r["frame"], *_cells("output", r["scores"]["output"])) for r in scored]
    for name in ("input", "output") if scored else ():
        each = [record["scores"][name] for record in scored]
        mean = {key: sum(score[key] for score in each) / len(each) for key in each[0]}
        rows.append(("mean", *_cells(name, mean)))
    return rows


def _cells(name: str, score: dict[str, float]) -> tuple[str, ...]:
    return name, f"{score['psnr']:.2f}", f"{score['ssim']:.4f}", f"{score['flip']:.4f}"
