"""Every method on the user's own scene: what each costs in seconds and leaves as error, and which to take.

The survey regrets that the methods were never compared (2.2.3, ccl.1). Which one wins depends on the scene, so it is
asked of the scene: each method bakes it at several accuracies, all bakes are measured at the same receivers against the
same followed light (`verification`), and the fastest that keeps the accuracy asked for is recommended.

Cost: the bakes themselves, one after the other, coarse ones first, and one verification. A method that was slow, or was
refused, is not asked for more. Memory: the colors of all bakes, 12 bytes a corner each.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, replace

from ..bake import BakeResult, bake_steps
from ..errors import SceneTooLargeError, SettingsError
from ..progress import Progress
from ..scene import Scene
from ..settings import METHODS, QUALITY_ACCURACY, BakeSettings
from .measured_error import MeasuredError
from .verification import PLACES, StoredColors, verify_each_steps

#: Seconds of a bake after which its method is not asked for a finer one, which would take several times as long.
LONG = 60.0

#: Share of the progress that the bakes take; the reference has the rest.
_BAKES = 0.8


@dataclass(frozen=True)
class Trial:
    """One bake of a comparison.

    `seconds` are those of the bake alone, without reading or writing; `measured` is None and `refusal` says why where
    there was none.
    """

    method: str
    accuracy: float
    seconds: float = 0.0
    rays: int = 0
    estimated_error: float | None = None
    measured: MeasuredError | None = None
    refusal: str = ""


@dataclass(frozen=True)
class Comparison:
    """Trials by method, coarse to fine, and which of them is recommended for `asked`; None where all were refused."""

    trials: tuple[Trial, ...]
    recommended: int | None
    asked: float

    @property
    def keeps(self) -> bool:
        """Whether what is recommended keeps the accuracy asked for."""
        return self.recommended is not None and self.trials[self.recommended].measured.error <= self.asked


def default_accuracies(asked: float) -> tuple[float, ...]:
    """Those of the presets that are no finer than what is asked for, and that itself, coarse to fine."""
    return tuple(sorted({asked, *(a for a in QUALITY_ACCURACY.values() if a > asked)}, reverse=True))


def compare_steps(
    scene: Scene,
    settings: BakeSettings,
    methods: Sequence[str] = METHODS,
    accuracies: Sequence[float] | None = None,
    places: int = PLACES,
) -> Generator[Progress, None, Comparison]:
    """Bake a scene by every method and measure what each is worth; the generator's return value is the result.

    Parameters
    ----------
    scene : Scene
    settings : BakeSettings
        `accuracy` is what is asked for; seed, threads and limits hold for every bake; the rest is replaced.
    methods : sequence of str
        From `METHODS`.
    accuracies : sequence of float, optional
        What each method is asked for; `default_accuracies` unless given.
    places : int
        Receivers compared.

    Raises
    ------
    SettingsError
        If a method or accuracy is unknown or out of range, or places are too few.
    RadiosityError
        As of `bake_steps` and `verify_steps`, for what concerns every method.
    """
    asked = settings.accuracy
    wanted = sorted(default_accuracies(asked) if accuracies is None else set(accuracies), reverse=True)
    # All checked before the first is baked.
    plans = [
        [
            replace(settings, method=method, solver="auto", bake_type="lighting", accuracy=accuracy)
            for accuracy in wanted
        ]
        for method in dict.fromkeys(methods)
    ]
    if not (plans and wanted):
        raise SettingsError("Nothing to compare: name at least one method and one accuracy")
    trials, bakes = [], []
    total = sum(len(plan) for plan in plans)
    for number, plan in enumerate(plans):
        refusal = ""
        for step, chosen in enumerate(plan):
            low = _BAKES * (number * len(wanted) + step) / total
            trial = Trial(chosen.method, chosen.accuracy, refusal=refusal)
            if not refusal:
                try:
                    trial, stored = yield from _tried(scene, chosen, low, low + _BAKES / total)
                    bakes.append(stored)
                    if trial.seconds > LONG:
                        refusal = f"not tried: took {trial.seconds:.0f} s at {chosen.accuracy:.3g}"
                except (SettingsError, SceneTooLargeError) as error:
                    if chosen.method == "auto":
                        raise
                    # What this method cannot do with this scene; others may.
                    refusal = str(error)
                    trial = replace(trial, refusal=refusal)
            trials.append(trial)
    if bakes:
        found = yield from _measured(scene, bakes, places, settings)
        measured = iter([verification.measured for verification in found])
        trials = [trial if trial.refusal else replace(trial, measured=next(measured)) for trial in trials]
    return Comparison(tuple(trials), recommend(trials, asked), asked)


def recommend(trials: Sequence[Trial], asked: float) -> int | None:
    """The fastest trial that keeps the accuracy asked for; where none does, the one that errs least."""
    numbers = [number for number, trial in enumerate(trials) if trial.measured is not None]
    kept = [number for number in numbers if trials[number].measured.error <= asked]
    if kept:
        return min(kept, key=lambda number: trials[number].seconds)
    return min(numbers, key=lambda number: trials[number].measured.error, default=None)


def _tried(
    scene: Scene, settings: BakeSettings, low: float, high: float
) -> Generator[Progress, None, tuple[Trial, list[StoredColors]]]:
    """One bake: its costs, and what it would store."""
    spent = _Stopwatch(bake_steps(scene, settings))
    for progress in spent:
        message = f"{settings.method} at {settings.accuracy:.3g}: {progress.message}"
        yield Progress(low + (high - low) * progress.fraction, message)
    result = spent.result
    stored = [StoredColors(mesh.corner_colors("lighting"), False) for mesh in result.meshes]
    statistics = result.statistics
    trial = Trial(settings.method, settings.accuracy, spent.seconds, statistics["rays"], statistics["estimated_error"])
    return trial, stored


class _Stopwatch:
    """Steps of work and the seconds spent inside them: not those in which a window is drawn between two."""

    def __init__(self, work: Generator[Progress, None, BakeResult]) -> None:
        self._work = work
        self.seconds = 0.0
        self.result: BakeResult | None = None

    def __iter__(self) -> Iterator[Progress]:
        try:
            while True:
                begin = time.perf_counter()
                try:
                    progress = next(self._work)
                except StopIteration as end:
                    self.result = end.value
                    return
                finally:
                    self.seconds += time.perf_counter() - begin
                yield progress
        finally:
            self._work.close()


def _measured(scene, bakes, places: int, settings: BakeSettings) -> Generator[Progress, None, list]:
    work = verify_each_steps(scene, bakes, "lighting", places, seed=settings.seed, threads=settings.threads)
    while True:
        try:
            progress = next(work)
        except StopIteration as end:
            return end.value
        yield Progress(_BAKES + (1 - _BAKES) * progress.fraction, progress.message)
