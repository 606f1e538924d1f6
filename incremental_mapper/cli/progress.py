"""What a user sees while a drive is mapped: a bar while it is read, then what is being done."""

from types import TracebackType
from typing import Self

from tqdm import tqdm

READING = 'map'


class Progress:
    """A bar on stderr, in a terminal only; its name is that of the stage."""

    def __init__(self, count: int, hidden: bool | None = None) -> None:
        """Show an empty bar.

        Args:
            count: Measurements of the input.
            hidden: Whether nothing is shown; None looks whether stderr is a terminal.
        """
        self._bar = tqdm(total=count, unit='msg', desc=READING, disable=hidden)
        self._resting = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bar.close()

    def read(self, count: int) -> None:
        """Measurements were read; a negative number takes back what is read anew."""
        if self._resting:  # it begins anew, with settings that were mended
            self._resting = False
            self._bar.reset()
            self._bar.set_description(READING)
        self._bar.update(count)

    def stage(self, name: str) -> None:
        """All has been read; the bar rests at its end while something else is done."""
        self._resting = True
        if not self._bar.disable:
            # What was left out on the way was counted beforehand, and never came.
            self._bar.n = self._bar.total or self._bar.n
            self._bar.set_description(name)
