"""Values that several jobs use, each made once."""

import collections
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from typing import Any


class Shared:
    """Values by number, such as frames as they were read, for jobs that share them.

    A value is made by the first thread that takes it, and forgotten at its last use. The number of
    values kept is bounded, so that in some orders of jobs a value may be made twice; not where jobs
    follow each other in the order of their numbers.
    """

    def __init__(self, uses: Iterable[int], most: int = 4):
        """Prepare.

        Args:
            uses: the number of the value for every use to come.
            most: largest number of values kept for later uses.
        """
        self._left = collections.Counter(uses)
        self._most = most
        self._kept: dict[int, Future[Any]] = {}
        self._lock = threading.Lock()

    def take(self, numbers: Iterable[int], make: Callable[[int], Any]) -> list[Future[Any]]:
        """Take values, and make those that are not there.

        Args:
            numbers: of the values, each once.
            make: function of a number that gives its value.

        Returns:
            A future for each, with the value or with the exception that making it raised. Those
            that another thread makes may not be done yet.
        """
        futures, missing = [], []
        with self._lock:
            for number in numbers:
                future = self._kept.pop(number, None)
                if future is None:
                    future = Future()
                    missing.append((number, future))
                futures.append(future)
                self._left[number] -= 1
                if self._left[number] > 0:
                    self._kept[number] = future
            while len(self._kept) > self._most:
                del self._kept[next(iter(self._kept))]
        for number, future in missing:
            try:
                future.set_result(make(number))
            # Whoever takes the value must get the exception, or would wait forever.
            except BaseException as error:
                future.set_exception(error)
        return futures
