"""Long work is a generator that yields how far it is, so that whoever runs it can draw, stop or hurry."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """One step of long work: `fraction` of all of it, 0 to 1, and what is being done."""

    fraction: float
    message: str


def shared_progress(work: Generator, low: float, high: float) -> Generator:
    """Pass on the progress of `work`, which yields fractions, within [low, high]; returns its result."""
    while True:
        try:
            done = next(work)
        except StopIteration as end:
            return end.value
        yield low + (high - low) * done


def finish(work: Generator) -> object:
    """Run `work` to its end; its result."""
    while True:
        try:
            next(work)
        except StopIteration as end:
            return end.value
