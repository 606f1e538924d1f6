"""Work done side by side, through the interface of ``concurrent.futures.Executor``.

``LocalWorkers`` are processes on this machine, ``ClusterWorkers`` those of a Dask cluster. Both
run a function over items and give back each one's future as it is completed.
"""

import multiprocessing
import signal
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.synchronize import Event
from types import TracebackType
from typing import Any, Protocol, Self, TypeVar

from incremental_mapper.errors import MapperError
from incremental_mapper.results.offline_run import Stop

Item = TypeVar('Item')
Result = TypeVar('Result')

CONNECT_SECONDS = 10.0


class ClusterError(MapperError):
    """The cluster cannot be used."""


class SharedStop(Stop):
    """The wish of the process that gives out the work that its workers stop."""

    def __init__(self, event: Event) -> None:
        self._event = event

    @property
    def wanted(self) -> bool:
        """Whether the work is to stop."""
        return self._event.is_set()

    @wanted.setter
    def wanted(self, value: bool) -> None:
        if value:
            self._event.set()


_stop: Stop = Stop()


def stop_of_this_process() -> Stop:
    """What a function that workers run asks whether it should stop."""
    return _stop


class Workers(Protocol):
    """Whoever does the work; to be used in a ``with`` statement."""

    def __enter__(self) -> Self:
        """Begin."""

    def __exit__(self, kind: Any, error: Any, trace: Any, /) -> None:
        """End; nothing runs afterwards."""

    def run(
        self, function: Callable[[Item], Result], items: Iterable[Item]
    ) -> Generator[tuple[Item, 'Future[Result]'], None, None]:
        """Each item with its completed future, in the order of completion."""


class LocalWorkers:
    """Processes on this machine; one that dies takes only its own item with it.

    They are spawned, not forked: threads of the libraries do not survive a fork.
    """

    def __init__(self, count: int) -> None:
        """Begin nothing yet: processes start with the first item."""
        self._count = count
        self._context = multiprocessing.get_context('spawn')
        self._event = self._context.Event()
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._event.set()
        self._close()

    def run(
        self, function: Callable[[Item], Result], items: Iterable[Item]
    ) -> Generator[tuple[Item, 'Future[Result]'], None, None]:
        """Each item with its completed future; that of a dead process holds BrokenProcessPool."""
        waiting = deque(items)
        while waiting:
            suspects = []
            for item, future in _side_by_side(self._open(), function, waiting, self._count):
                if _process_died(future):
                    suspects.append((item, future))
                else:
                    yield item, future
            if suspects:
                self._close()
            if len(suspects) == 1:
                yield suspects.pop()
            # Which item killed its process is not known; each for itself, only that one does again.
            for item, _ in suspects:
                alone = next(_side_by_side(self._open(), function, deque([item]), 1))
                if _process_died(alone[1]):
                    self._close()
                yield alone

    def _open(self) -> ProcessPoolExecutor:
        if self._pool is None:
            self._pool = ProcessPoolExecutor(
                self._count, self._context, initializer=_begin_worker, initargs=(self._event,)
            )
        return self._pool

    def _close(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
            self._pool = None


class ClusterWorkers:
    """The workers of a Dask cluster, which must see the same folders under the same paths.

    Ctrl-C cancels what waits; a worker finishes the item that it has begun.
    """

    def __init__(self, address: str) -> None:
        """Connect to the scheduler; raises ClusterError with what to do where that fails."""
        try:
            from distributed import Client
            from distributed.comm import get_address_host_port
        except ModuleNotFoundError as error:
            raise ClusterError(
                f'--scheduler: {error.name} is missing; pip install "incremental_mapper[cluster]"'
            ) from error
        try:
            get_address_host_port(address)  # a client that cannot read it lives on and complains
            self._client = Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            reason = ' '.join(str(error).split()) or type(error).__name__
            raise ClusterError(
                f'--scheduler {address}: no Dask scheduler can be reached there ({reason}); '
                'start one with "dask scheduler", or leave --scheduler out'
            ) from error
        self._pool: Executor = self._client.get_executor(pure=False, retries=0)

    @property
    def count(self) -> int:
        """Workers that the cluster has now."""
        return len(self._client.ncores())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._pool.shutdown(wait=error is None)  # not waiting, Dask's executor cancels
        self._client.close()

    def run(
        self, function: Callable[[Item], Result], items: Iterable[Item]
    ) -> Generator[tuple[Item, 'Future[Result]'], None, None]:
        """Each item with its completed future, in the order of completion."""
        return _side_by_side(self._pool, function, deque(items), None)


def _side_by_side(
    pool: Executor,
    function: Callable[[Item], Result],
    waiting: deque[Item],
    at_most: int | None,
) -> Generator[tuple[Item, 'Future[Result]'], None, None]:
    """Take items from ``waiting``, with ``at_most`` begun and not completed at any time.

    Items stay in ``waiting`` where the pool broke before they were begun.
    """
    begun: dict[Future[Result], Item] = {}
    broken = False
    while begun or (waiting and not broken):
        while waiting and not broken and (at_most is None or len(begun) < at_most):
            try:
                with _interrupts_held():
                    future = pool.submit(function, waiting[0])
            except BrokenProcessPool:
                broken = True
                break
            begun[future] = waiting.popleft()
        done, _ = wait(begun, return_when=FIRST_COMPLETED)
        for future in done:
            broken = broken or _process_died(future)
            yield begun.pop(future), future


def _process_died(future: 'Future[Any]') -> bool:
    return not future.cancelled() and isinstance(future.exception(), BrokenProcessPool)


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Processes that are started meanwhile never see Ctrl-C; this one sees it afterwards."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin_worker(event: Event) -> None:
    global _stop
    _stop = SharedStop(event)
