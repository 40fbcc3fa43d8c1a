"""Settings of a bake: frozen, validated when made, the only form in which choices cross into the core."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

from . import solvers
from .errors import SettingsError
from .form_factors import matrix

#: Relative RMS error of the irradiance that each quality preset asks for.
QUALITY_ACCURACY = {"draft": 0.10, "preview": 0.03, "final": 0.01}

#: What a bake can store; see `BakeSettings.bake_type`.
BAKE_TYPES = ("combined", "lighting", "direct", "indirect", "emission")

#: Form-factor methods and solvers that the bake can be asked for by name: all that there are.
METHODS = ("auto", *matrix.METHODS)
SOLVERS = ("auto", *solvers.SOLVERS)

#: Accuracies that can be asked for. Below 0.2 % float32 rays and the patch solution set a floor; above 50 % nothing
#: gets cheaper.
ACCURACY_RANGE = (0.002, 0.5)


@dataclass(frozen=True)
class BakeSettings:
    """How to bake.

    Parameters
    ----------
    accuracy : float
        Relative RMS error of irradiance to aim for, no unit (0.03 is 3 %).
    method, solver : str
        Names from `METHODS` and `SOLVERS`.
    bake_type : str
        ``combined`` radiosity / pi, what the surface looks like; ``lighting`` irradiance / pi, as Cycles' Diffuse bake
        without color; ``direct``, ``indirect`` its two parts; ``emission`` emitted exitance / pi.
    seed : int
        Same input, settings and seed give the same bits.
    threads : int
        Threads of the ray engine; 0 takes all cores. The result does not depend on it.
    time_limit : float
        Seconds after which no further refinement is started; 0 means none.
    memory_limit : float
        Bytes the bake may take; refused before it starts when foreseen to take more. 0 means none.

    Raises
    ------
    SettingsError
        If a value is outside its range.
    """

    accuracy: float = QUALITY_ACCURACY["preview"]
    method: str = "auto"
    solver: str = "auto"
    bake_type: str = "combined"
    seed: int = 0
    threads: int = 0
    time_limit: float = 0.0
    memory_limit: float = 0.0

    def __post_init__(self) -> None:
        low, high = ACCURACY_RANGE
        if not (isfinite(self.accuracy) and low <= self.accuracy <= high):
            raise SettingsError(f"Accuracy must lie between {low:g} and {high:g}, not {self.accuracy:g}")
        for name, value, known in (
            ("method", self.method, METHODS),
            ("solver", self.solver, SOLVERS),
            ("bake type", self.bake_type, BAKE_TYPES),
        ):
            if value not in known:
                raise SettingsError(f"Unknown {name} {value!r}: choose {', '.join(known)}")
        if self.threads < 0:
            raise SettingsError(f"Threads must be 0 (all cores) or more, not {self.threads}")
        if not 0 <= self.seed < 2**31:
            raise SettingsError(f"Seed must lie between 0 and {2**31 - 1}, not {self.seed}")
        for name, limit in (("Time limit", self.time_limit), ("Memory limit", self.memory_limit)):
            if not (isfinite(limit) and limit >= 0):
                raise SettingsError(f"{name} must be 0 (none) or more, not {limit}")
