"""Solvers of radiosity equations: `SOLVERS` of a whole matrix, `STRATEGIES` that make form factors themselves."""

from .adaptive import solve_adaptively
from .black_boundary import black_boundary
from .choice import SOLVERS, solve_radiosity
from .progressive_refinement import ProgressiveRefinement, ShootingState
from .strategies import STRATEGIES, solve
from .system import Solution, State, System
from .transparent_boundary import LocalSolution, transparent_boundary
from .two_level import ElementFactors, TwoLevelSolution, solve_two_level, two_level

__all__ = [
    "SOLVERS",
    "STRATEGIES",
    "ElementFactors",
    "LocalSolution",
    "ProgressiveRefinement",
    "ShootingState",
    "Solution",
    "State",
    "System",
    "TwoLevelSolution",
    "black_boundary",
    "solve",
    "solve_adaptively",
    "solve_radiosity",
    "solve_two_level",
    "transparent_boundary",
    "two_level",
]
