"""Distribute work among this process and workers, which may fail.

The work is a list of *items*, each of which has the same result whoever processes it.  Workers are
killed, stop, run out of memory, or never answer.  This process therefore repeats whatever they have
not finished.  So a worker that fails costs time, but no result.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable, Set
from time import perf_counter
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeAlias, TypeVar

from tracer.picture.parallel import Threads

# Importing it takes longer than rendering a small picture, and only an executor needs it.
if TYPE_CHECKING:
    from concurrent.futures import Future

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")
_Tasks: TypeAlias = "Set[_Task[Any, Any]]"  # the tasks of one call of `Distribution.process`

# Maximum number of submitted but unfinished items for each worker: enough to keep the worker busy.
_ITEMS_PER_WORKER = 2


class Executor(Protocol):
    """The part of a `concurrent.futures.Executor` that is used here."""

    def submit(self, function: Callable[..., Any], /, *args: Any) -> Future[Any]:
        """Schedule the call ``function(*args)`` in a worker, and return the future of its result.

        If the worker is another process, the function, its arguments and its result must be
        picklable.
        """


class _Task(Generic[_Item, _Result]):
    """An item, and what is known about it."""

    item: _Item
    # The result, from the time when it is known until it is yielded.  The tuple tells a result of
    # None from no result.
    results: tuple[_Result, ...]
    seconds: float  # time that this process took for the item; 0 if it has not processed it

    def __init__(self, item: _Item) -> None:
        self.item = item
        self.results = ()
        self.seconds = 0.0


class Distribution(Generic[_Item, _Result]):
    """A list of items that this process and the workers of an executor process together.

    Both take items from the front of the list.  When none is left to take, this process repeats
    those that the workers have not finished.  While this process is busy with a large item, it can
    divide the item into smaller ones.  A nested call of `process` puts these in front of the list.

    Parameters
    ----------
    function
        Called with an item in this process; returns the result.  Its exceptions end the iteration
        over `process`.
    remote_function
        Called with an item in a worker.  Its result is yielded in place of that of `function`,
        which may differ in form: for example, `function` writes to an array of this process, and
        `remote_function` returns what is to be written.  If workers are other processes, the
        function, the items and the results must be picklable.
    worker_count
        Number of workers of the executor, which determines how many items are submitted to it.
    executor
        None if this process does all the work.  The attribute can be set at any time, to share the
        remaining items.  It becomes None if submitting an item fails.
    is_valid
        Tests an item and the result that the executor returns for it: a worker may decline an item,
        and an executor of a user may return anything.  If the result is not valid, this process
        repeats the item.
    """

    def __init__(
        self,
        function: Callable[[_Item], _Result],
        remote_function: Callable[[_Item], Any],
        worker_count: int,
        executor: Executor | None = None,
        is_valid: Callable[[_Item, Any], bool] = lambda _item, _result: True,
    ) -> None:
        self._function = function
        self._remote_function = remote_function
        self._worker_count = worker_count
        self.executor = executor
        self._is_valid = is_valid
        self._waiting = deque[_Task[_Item, _Result]]()  # tasks that nobody has taken
        # Futures whose results have not been collected, in order of submission.
        self._futures = dict[_Task[_Item, _Result], "Future[Any]"]()

    def process(self, items: Iterable[_Item]) -> Generator[_Result]:
        """Process items, and yield their results in order.

        A caller that stops early must close the iterator, so that the remaining items are dropped.
        """
        # A dict, to keep the order and to look tasks up.  Tasks that nobody has taken stay at the
        # front of `_waiting`, because a nested call ends before another task is taken here.
        tasks = dict.fromkeys(_Task[_Item, _Result](item) for item in items)
        self._waiting.extendleft(reversed(tasks))
        try:
            for task in tasks:
                while not task.results:
                    self.submit_items()
                    if self._waiting and self._waiting[0] in tasks:
                        self._process_task(self._waiting.popleft())
                    else:
                        self._help_workers(tasks.keys())
                    self._collect_results(tasks.keys())
                result = task.results[0]
                task.results = ()  # results may be large, and the tasks live until the end
                yield result
        finally:
            self._drop(tasks.keys())

    def submit_items(self) -> None:
        """Submit enough items to the executor to keep all its workers busy.

        Iteration calls this method before each item that this process takes.  A slow `function`
        should also call this method from time to time.
        """
        if self.executor is None:
            return
        unfinished_count = sum(not future.done() for future in self._futures.values())
        # The workers get only their share of the remaining items: this process needs work, too.
        worker_share = len(self._waiting) * self._worker_count // (self._worker_count + 1)
        needed_count = _ITEMS_PER_WORKER * self._worker_count - unfinished_count
        try:
            for _ in range(min(needed_count, worker_share)):
                task = self._waiting[0]
                self._futures[task] = self.executor.submit(self._remote_function, task.item)
                self._waiting.popleft()
        except Exception:  # for example because workers have died several times
            self.executor = None

    def _help_workers(self, tasks: _Tasks) -> None:
        """Process an item that the workers have not finished, or wait until one is done.

        The item is the one that was submitted last, because the workers have most probably not
        begun it.  If no worker has, process it here instead.  Otherwise, wait until any item is
        done, but at most for as long as this process took for its own slowest item.  If none is
        done then, process the item here as well, because the worker may never answer.
        """
        futures = {task: future for task, future in self._futures.items() if task in tasks}
        if not futures:
            return
        from concurrent.futures import FIRST_COMPLETED, wait

        last_task = [*futures][-1]
        is_begun = not futures[last_task].cancel()
        if is_begun:
            # A thread cannot be killed, so it returns a result or raises an exception in the end.
            may_never_answer = not isinstance(self.executor, Threads)
            max_seconds = max(task.seconds for task in tasks) if may_never_answer else None
            if wait(futures.values(), max_seconds, return_when=FIRST_COMPLETED).done:
                return  # `_collect_results` stores the result, or repeats the item if it failed
        del self._futures[last_task]
        self._process_task(last_task)

    def _process_task(self, task: _Task[_Item, _Result]) -> None:
        """Process an item in this process, and measure how long it takes."""
        start_time = perf_counter()
        task.results = (self._function(task.item),)
        task.seconds = perf_counter() - start_time

    def _collect_results(self, tasks: _Tasks) -> None:
        """Store the results that workers have returned.

        Process an item here if its worker has raised an exception or returned an invalid result.
        """
        for task in [task for task, future in self._futures.items() if future.done()]:
            if task not in tasks:
                continue
            future = self._futures.pop(task)
            # future.result() would raise a worker's exception, even a KeyboardInterrupt.
            has_result = not future.cancelled() and future.exception() is None
            if has_result and self._is_valid(task.item, future.result()):
                task.results = (future.result(),)
            else:
                self._process_task(task)

    def _drop(self, tasks: _Tasks) -> None:
        """Remove items from the list, and cancel the submitted ones that no worker has begun."""
        self._waiting = deque(task for task in self._waiting if task not in tasks)
        for task in [task for task in self._futures if task in tasks]:
            self._futures.pop(task).cancel()
