"""Drives long work, a generator of `Progress`, a few tens of milliseconds at a time or to its end.

Knows neither Blender nor the work, so that stepping can be tested where no window is.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from typing import Any

#: Work per tick of the timer: short enough that the window stays alive, long enough that the timer costs little.
TICK_SECONDS = 0.05

#: Below this share done, the time left would be a guess.
_SMALLEST_FRACTION = 0.02


class StepRunner:
    """Work in progress.

    Parameters
    ----------
    steps : generator
        Yields objects with `fraction` (0 to 1) and `message`; its return value is the result.
    clock : callable
        Seconds, for tests.
    """

    def __init__(self, steps: Generator[Any, None, Any], clock: Callable[[], float] = time.perf_counter) -> None:
        self._steps = steps
        self._clock = clock
        self._start = clock()
        self.fraction = 0.0
        self.message = ""
        self.is_done = False
        self.result: Any = None

    def advance(self, seconds: float = TICK_SECONDS) -> bool:
        """Work for about that long, at least one step; whether all is done. What the work raises passes through."""
        end = self._clock() + seconds
        while not self.is_done:
            try:
                progress = next(self._steps)
            except StopIteration as stop:
                self.is_done, self.fraction, self.result = True, 1.0, stop.value
                break
            # The bar never goes back, whatever the stages say.
            self.fraction = max(self.fraction, min(float(progress.fraction), 1.0))
            self.message = progress.message
            if self._clock() >= end:
                break
        return self.is_done

    @property
    def seconds_left(self) -> float | None:
        """Time left if the rest goes as fast as the part done; None while too little is known."""
        if self.fraction < _SMALLEST_FRACTION:
            return None
        return (self._clock() - self._start) * (1 - self.fraction) / self.fraction

    def close(self) -> None:
        """Give up: the work is stopped where it is and cleans up after itself."""
        self._steps.close()


def run_to_end(steps: Generator[Any, None, Any], on_progress: Callable[[float], None] | None = None) -> Any:
    """Run a generator of `Progress` to its end and return its result; `on_progress` gets the share done."""
    runner = StepRunner(steps)
    try:
        while not runner.advance(0.0):
            if on_progress is not None:
                on_progress(runner.fraction)
    finally:
        runner.close()
    return runner.result
