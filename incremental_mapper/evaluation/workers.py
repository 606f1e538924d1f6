"""Work done side by side, through the interface of ``concurrent.futures.Executor``.

``LocalWorkers`` are processes on this machine, ``ClusterWorkers`` those of a Dask cluster. Both
run a function over items and give back each one's future as it is completed.
"""

import multiprocessing
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import (
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    as_completed,
)
from concurrent.futures.process import BrokenProcessPool
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
    ) -> Iterator[tuple[Item, 'Future[Result]']]:
        """Each item with its completed future, in the order of completion."""


class LocalWorkers:
    """Processes on this machine; one that dies takes only its own item with it.

    Each runs in a pool of its own, since a pool with a dead process is broken as a whole. Dask's
    LocalCluster would run a deadly item again or blame what waits behind it on the same worker.
    """

    def __init__(self, count: int) -> None:
        """Begin nothing yet: processes start with the first items.

        Args:
            count: Items that run side by side.
        """
        # Spawned, not forked: threads of the libraries do not survive a fork.
        self._context = multiprocessing.get_context('spawn')
        self._event = self._context.Event()
        self._idle: list[ProcessPoolExecutor] = []
        # A process inherits what its starter blocks, so none of them sees Ctrl-C.
        self._threads = ThreadPoolExecutor(
            count,
            initializer=signal.pthread_sigmask,
            initargs=(signal.SIG_BLOCK, {signal.SIGINT}),
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._event.set()
        self._threads.shutdown(cancel_futures=True)
        for pool in self._idle:
            pool.shutdown()

    def run(
        self, function: Callable[[Item], Result], items: Iterable[Item]
    ) -> Iterator[tuple[Item, 'Future[Result]']]:
        """Each item with its completed future; that of a dead process holds BrokenProcessPool."""
        return _completed(
            {self._threads.submit(self._in_a_process, function, item): item for item in items}
        )

    def _in_a_process(self, function: Callable[[Item], Result], item: Item) -> Result:
        future = None
        while future is None:
            pool = self._pool()
            try:
                future = pool.submit(function, item)
            except BrokenProcessPool:  # it died while it had nothing to do
                pool.shutdown()
        if isinstance(future.exception(), BrokenProcessPool):
            pool.shutdown()
        else:
            self._idle.append(pool)
        return future.result()

    def _pool(self) -> ProcessPoolExecutor:
        try:
            return self._idle.pop()
        except IndexError:
            return ProcessPoolExecutor(
                1, self._context, initializer=_begin_worker, initargs=(self._event,)
            )


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
    ) -> Iterator[tuple[Item, 'Future[Result]']]:
        """Each item with its completed future, in the order of completion."""
        return _completed({self._pool.submit(function, item): item for item in items})


def _completed(
    futures: dict['Future[Result]', Item],
) -> Iterator[tuple[Item, 'Future[Result]']]:
    for future in as_completed(futures):
        yield futures[future], future


def _begin_worker(event: Event) -> None:
    global _stop
    _stop = SharedStop(event)
