"""Jobs through stages: several at a time in one process, in bounded memory."""

import contextlib
import dataclasses
import queue
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from .jobs import Job


@dataclasses.dataclass(frozen=True)
class Stage:
    """A step that every job goes through.

    Attributes:
        name: a verb, for reports.
        work: makes of a job and what the stage before returned (None for the first) what the
            next stage gets; the last one's is the result.
        threads: jobs that may be in this stage at a time.
    """

    name: str
    work: Callable[[Job, Any], Any]
    threads: int = 1


@dataclasses.dataclass
class Outcome:
    """What became of a job.

    Attributes:
        job: the job.
        result: what the last stage returned.
        error: what a stage raised; the stages after it were left out.
        failed_in: name of that stage, or empty.
        seconds: time in each stage.
        messages: level and text of what was logged meanwhile, where it could not be shown.
    """

    job: Job
    result: Any = None
    error: BaseException | None = None
    failed_in: str = ""
    seconds: dict[str, float] = dataclasses.field(default_factory=dict)
    messages: tuple[tuple[int, str], ...] = ()


def run_stages(job: Job, stages: Sequence[Stage]) -> Outcome:
    """Take one job through all stages in this thread.

    Args:
        job: the job.
        stages: in order.

    Returns:
        The outcome; it holds the error if a stage raised one.
    """
    outcome, value = Outcome(job), None
    for stage in stages:
        value = _run_stage(outcome, stage, value)
        if outcome.error is not None:
            return outcome
    outcome.result = value
    return outcome


def run_pipeline(
    jobs: Iterable[Job], stages: Sequence[Stage], spare: int = 2
) -> Generator[Outcome, None, None]:
    """Take jobs through stages that overlap, each in threads of its own.

    At most as many jobs are under way as there are threads, and ``spare`` more that wait between
    two stages: this bounds the memory, however long the sequence.

    Args:
        jobs: taken one by one as there is room.
        stages: in order; their functions must bear to run in threads.
        spare: jobs that may wait between stages.

    Yields:
        Outcomes, as they come about. When the iterator is closed early, what runs is finished,
        and nothing else is begun.
    """
    done: queue.SimpleQueue[Outcome] = queue.SimpleQueue()
    stopping = threading.Event()
    limit = sum(stage.threads for stage in stages) + spare
    with contextlib.ExitStack() as stack:
        pools = [stack.enter_context(_pool(stage)) for stage in stages]
        stack.callback(stopping.set)

        def advance(outcome: Outcome, value: Any, position: int) -> None:
            value = _run_stage(outcome, stages[position], value)
            if outcome.error is None and position + 1 < len(stages):
                if not stopping.is_set():
                    pools[position + 1].submit(advance, outcome, value, position + 1)
                return
            outcome.result = value
            done.put(outcome)

        under_way = 0
        for job in jobs:
            if under_way == limit:
                yield done.get()
                under_way -= 1
            pools[0].submit(advance, Outcome(job), None, 0)
            under_way += 1
        for _ in range(under_way):
            yield done.get()


def _run_stage(outcome: Outcome, stage: Stage, value: Any) -> Any:
    """Run a stage; note how long it took, and what it raised instead of a value."""
    started = time.perf_counter()
    try:
        return stage.work(outcome.job, value)
    # An error in a thread that nobody waits for would be lost; whoever reads the outcome judges.
    except BaseException as error:
        outcome.error, outcome.failed_in = error, stage.name
        return None
    finally:
        outcome.seconds[stage.name] = time.perf_counter() - started


@contextlib.contextmanager
def _pool(stage: Stage) -> Iterator[ThreadPoolExecutor]:
    pool = ThreadPoolExecutor(stage.threads, thread_name_prefix=stage.name)
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
