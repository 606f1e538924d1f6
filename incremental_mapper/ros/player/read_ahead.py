"""Reading on in a thread while the items before are used."""

from collections.abc import Callable, Generator, Iterator
from queue import Full, Queue
from threading import Event, Thread
from typing import TypeVar

T = TypeVar('T')

_LOOK = 0.1
"""Seconds between two looks at whether to stop, where there is no room."""


class _End:
    """Comes after the last item, with what ended them too early."""

    def __init__(self, error: Exception | None) -> None:
        self.error = error


def read_ahead(make: Callable[[], Iterator[T]], most: int) -> Generator[T, None, None]:
    """The items of ``make()``, which runs in a thread and stays up to ``most`` items ahead.

    What it raises is raised here, after the items before it. Closing this iterator stops it.
    """
    items: Queue[T | _End] = Queue(most)
    stop = Event()

    def put(item: T | _End) -> bool:
        while not stop.is_set():
            try:
                items.put(item, timeout=_LOOK)
            except Full:
                continue
            return True
        return False

    def read() -> None:
        error = None
        try:
            for item in make():
                if not put(item):
                    return
        except Exception as raised:
            error = raised
        put(_End(error))

    thread = Thread(target=read, name='read_ahead', daemon=True)
    thread.start()
    try:
        while not isinstance(item := items.get(), _End):
            yield item
        if item.error is not None:
            raise item.error
    finally:
        stop.set()
        thread.join()
