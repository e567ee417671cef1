"""Jobs on the workers of a Dask cluster, in other processes or on other machines.

The workers must see the files under the same names as this process and have the same version of
jaxblur. If a worker dies, its jobs are given to another one; a job that runs twice writes the same
file twice, each time completely or not at all.
"""

import contextlib
import logging
import signal
import threading
import uuid
import warnings
from collections.abc import Generator, Iterable, Iterator, Sequence
from multiprocessing import resource_tracker
from typing import Any

import jaxblur

from .jobs import Job
from .pipeline import Outcome, Stage, run_stages

LOG = logging.getLogger("jaxblur")
LOCAL = "local"
CONNECT_SECONDS = 5
# No memory limit, because a worker near it would be paused and then killed. Dask always starts its
# web servers: here on free ports of the loopback interface, and with no pages.
LOCAL_OPTIONS: dict[str, Any] = {
    "threads_per_worker": 1,
    "memory_limit": None,
    "dashboard_address": "127.0.0.1:0",
    "scheduler_kwargs": {"dashboard": False},
    "protocol": "tls://",
    "silence_logs": logging.CRITICAL,
}
NO_PAGES = {f"distributed.{server}.http.routes": [] for server in ("scheduler", "worker", "nanny")}


def run_cluster(
    jobs: Iterable[Job], stages: Sequence[Stage], client: Any
) -> Generator[Outcome, None, None]:
    """Run the stages of jobs on the workers of a Dask cluster, each job on one worker.

    Args:
        jobs: the jobs; every worker must be able to use their paths.
        stages: stages in order; their functions must be picklable.
        client: a `distributed.Client`, as `cluster_client` gives it.

    Yields:
        Outcomes in order of completion. If the iterator is closed early, no further job is started.
    """
    from distributed import as_completed

    run = uuid.uuid4().hex
    futures = {
        client.submit(
            work_on, job, tuple(stages), jaxblur.__version__, key=f"{run}-{job.frame}"
        ): job
        for job in jobs
    }
    try:
        for future in as_completed(list(futures), loop=client.loop):
            yield _outcome(future, futures[future])
    finally:
        client.cancel(list(futures))


def work_on(job: Job, stages: Sequence[Stage], version: str) -> Outcome:
    """Run a job on a worker, and collect its log messages.

    Args:
        job: the job.
        stages: stages in order.
        version: version of jaxblur in the process that submitted the job.

    Returns:
        The outcome, with the messages.

    Raises:
        RuntimeError: this worker has another version of jaxblur.
    """
    if version != jaxblur.__version__:
        raise RuntimeError(
            f"a worker has jaxblur {jaxblur.__version__}, not {version}; install the same version."
        )
    with _messages() as messages:
        outcome = run_stages(job, stages)
    outcome.messages = tuple(messages)
    return outcome


@contextlib.contextmanager
def cluster_client(scheduler: str, workers: int = 2) -> Iterator[Any]:
    """Connect to a scheduler, or start one with workers and stop it afterwards.

    A scheduler at a ``tls://`` address is connected to with the certificates of Dask's own
    configuration.

    Args:
        scheduler: ``local`` for processes on this machine, or the address of a scheduler, such
            as ``tcp://farm:8786``.
        workers: number of local processes.

    Yields:
        A `distributed.Client`.

    Raises:
        ValueError: Dask is not installed, or the scheduler does not answer.
    """
    try:
        from dask import config
        from distributed import Client, LocalCluster
        from distributed.security import Security

        # Keys for this run, which need cryptography: other users of this machine cannot connect.
        security = Security.temporary() if scheduler == LOCAL else None
    except ImportError as error:
        raise ValueError(
            "`scheduler` needs Dask and cryptography, of which one is not installed: "
            "pip install 'jaxblur[dask]'."
        ) from error
    with contextlib.ExitStack() as stack:
        address: Any = scheduler
        if scheduler == LOCAL:
            with config.set(NO_PAGES), _without_interruptions():
                cluster = LocalCluster(n_workers=workers, security=security, **LOCAL_OPTIONS)
            address = stack.enter_context(cluster)
        try:
            client = Client(address, set_as_default=False, timeout=CONNECT_SECONDS)
        except (OSError, ValueError) as error:
            raise ValueError(
                f"`scheduler`: {scheduler} does not answer; give local or the address that "
                "`dask scheduler` prints, such as tcp://farm:8786."
            ) from error
        yield stack.enter_context(client)


@contextlib.contextmanager
def _without_interruptions() -> Iterator[None]:
    """Keep Ctrl-C from the threads that start here, and from their processes, for good.

    A terminal sends it to all processes of a command: workers would print where they are. This
    thread gets one that arrives meanwhile at the end.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # As it starts, it unblocks the signal for the thread that needs it first.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _outcome(future: Any, job: Job) -> Outcome:
    error = future.exception()
    if error is None:
        return future.result()
    return Outcome(job, error=error, failed_in="worker")


@contextlib.contextmanager
def _messages() -> Iterator[list[tuple[int, str]]]:
    """Collect log records and warnings of this thread."""
    messages: list[tuple[int, str]] = []
    thread = threading.get_ident()

    class Collector(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if threading.get_ident() == thread:
                messages.append((record.levelno, record.getMessage()))

    collector = Collector()
    LOG.addHandler(collector)
    # It stays: the threads of a worker share the logger.
    LOG.setLevel(logging.INFO)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("always", category=UserWarning)
            warnings.showwarning = lambda message, *_, **__: LOG.warning("%s", message)
            yield messages
    finally:
        LOG.removeHandler(collector)
