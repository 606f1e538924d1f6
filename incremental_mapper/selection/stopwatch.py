"""The seconds of a window's stages."""

import time


class Stopwatch:
    """Adds up the seconds of a window's stages."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = self.began = time.perf_counter()

    def lap(self, stage: str) -> float:
        """Charge the time since the last lap to a stage; returns it in seconds."""
        now = time.perf_counter()
        passed, self._last = now - self._last, now
        self.seconds[stage] = self.seconds.get(stage, 0.0) + passed
        return passed
