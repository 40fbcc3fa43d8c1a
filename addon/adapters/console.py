"""The terminal: result lines on standard output, progress and errors on standard error, Blender's chatter in neither.

Blender and its importers write to standard output from C, so the file descriptor itself is turned away while a command
runs.
"""

from __future__ import annotations

import ctypes
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from typing import TextIO

# Seconds between lines where standard error is a file or a pipe: enough to see that it lives, few enough to read.
_SPARSE_INTERVAL = 5.0
# Seconds between updates of the one line on a terminal.
_LIVE_INTERVAL = 0.1
# An estimate of the time left from less than this is noise.
_MIN_SECONDS, _MIN_FRACTION = 0.5, 0.02


@contextmanager
def own_output(verbose: bool) -> Iterator[TextIO]:
    """A stream to the real standard output; meanwhile all else that is written there vanishes.

    With `verbose` it goes to standard error instead.
    """
    _flush()
    real = os.dup(1)
    noise = os.dup(2) if verbose else os.open(os.devnull, os.O_WRONLY)
    os.dup2(noise, 1)
    try:
        with (
            open(real, "w", encoding="utf-8", errors="backslashreplace", closefd=False) as stream,
            open(noise, "w", encoding="utf-8", errors="backslashreplace") as noise_stream,
            redirect_stdout(noise_stream),  # Python's own may lead elsewhere than to descriptor 1
        ):
            yield stream
    finally:
        _flush()
        os.dup2(real, 1)
        os.close(real)


def _flush() -> None:
    """Write out what Python and C have kept back, so that it goes where standard output leads now."""
    sys.stdout.flush()
    library = ctypes.CDLL("ucrtbase" if os.name == "nt" else None)
    library.fflush(None)


def duration(seconds: float) -> str:
    """Seconds as people say them: 3 s, 2 min 5 s, 1 h 10 min."""
    whole = max(round(seconds), 0)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


class ProgressLine:
    """Progress of one job: one line that is rewritten on a terminal, a line now and then elsewhere.

    Parameters
    ----------
    label : str
        What is worked on; starts every line.
    stream : TextIO
        Usually `sys.stderr`.
    clock : callable
        Seconds from anywhere on.
    """

    def __init__(self, label: str, stream: TextIO, clock=time.monotonic):
        self._label, self._stream, self._clock = label, stream, clock
        self._started = self._shown_at = clock()
        self._live = stream.isatty()
        self._width = 0

    def update(self, fraction: float, message: str) -> None:
        """Show how far the job is, unless it was shown just now."""
        now = self._clock()
        if now - self._shown_at < (_LIVE_INTERVAL if self._live else _SPARSE_INTERVAL):
            return
        self._shown_at = now
        elapsed = now - self._started
        left = ""
        if elapsed >= _MIN_SECONDS and fraction >= _MIN_FRACTION:
            left = f", {duration(elapsed * (1 - fraction) / fraction)} left"
        self._write(f"{self._label}: {fraction:4.0%} {message}{left}")

    def clear(self) -> None:
        """Remove the line from a terminal, so that the next text starts on an empty one."""
        if self._live and self._width:
            self._stream.write("\r" + " " * self._width + "\r")
            self._stream.flush()
            self._width = 0

    def _write(self, text: str) -> None:
        if self._live:
            # Padding instead of an escape sequence, which old Windows consoles print.
            self._stream.write("\r" + text.ljust(self._width))
            self._width = len(text)
        else:
            self._stream.write(text + "\n")
        self._stream.flush()
