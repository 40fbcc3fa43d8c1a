"""Solvers of radiosity equations: `SOLVERS` of a whole matrix, `STRATEGIES` that make form factors themselves."""

from .adaptive import solve_adaptively
from .choice import SOLVERS, solve_radiosity
from .progressive_refinement import ProgressiveRefinement, ShootingState
from .strategies import STRATEGIES, solve
from .system import Solution, State, System
from .two_level import ElementFactors, TwoLevelSolution, solve_two_level, two_level

__all__ = [
    "SOLVERS",
    "STRATEGIES",
    "ElementFactors",
    "ProgressiveRefinement",
    "ShootingState",
    "Solution",
    "State",
    "System",
    "TwoLevelSolution",
    "solve",
    "solve_adaptively",
    "solve_radiosity",
    "solve_two_level",
    "two_level",
]
