"""A pipeline of stages in one process: several jobs at a time, in bounded memory."""

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
    """A step of every job.

    Attributes:
        name: a verb, for reports.
        work: function of the job and the value of the previous stage (None for the first).
            Its value is passed to the next stage; that of the last stage is the result.
        threads: largest number of jobs in this stage at a time.
    """

    name: str
    work: Callable[[Job, Any], Any]
    threads: int = 1


@dataclasses.dataclass
class Outcome:
    """The outcome of a job.

    Attributes:
        job: the job.
        result: value of the last stage.
        error: exception that a stage raised; later stages did not run.
        failed_in: name of that stage, or empty.
        seconds: time in each stage.
        messages: level and text of log messages that could not be shown where the job ran.
    """

    job: Job
    result: Any = None
    error: BaseException | None = None
    failed_in: str = ""
    seconds: dict[str, float] = dataclasses.field(default_factory=dict)
    messages: tuple[tuple[int, str], ...] = ()


def run_stages(job: Job, stages: Sequence[Stage]) -> Outcome:
    """Run all stages of one job in this thread.

    Args:
        job: the job.
        stages: stages in order.

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
    """Run jobs through overlapping stages, each of which has its own threads.

    The number of jobs under way is at most the number of threads plus ``spare`` jobs that wait
    between two stages. This bounds memory, however long the sequence.

    Args:
        jobs: taken one by one as jobs finish.
        stages: stages in order; their functions must be safe to run in threads.
        spare: jobs that may wait between stages.

    Yields:
        Outcomes in order of completion. If the iterator is closed early, running stages finish, and
        no further one is started.
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
    """Run a stage; record its time, and its exception if it raises one."""
    started = time.perf_counter()
    try:
        return stage.work(outcome.job, value)
    # An exception in a thread would be lost, so it is stored in the outcome for the caller.
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
