"""Radiosity in arrays: no Blender in here.

Conventions, everywhere: meters, watts, scene-linear Rec.709 RGB. ``form_factors[i, j]`` is the fraction of the power
leaving patch i that reaches patch j, so rows sum to at most 1, ``areas[i] * F[i, j] == areas[j] * F[j, i]``, and
``B = E + reflectance * (F @ B)``. Radiosity, exitance and irradiance are in W/m2; what a bake stores is those over pi.
Angles are radians. Normals follow the right-hand rule: counter-clockwise corners, seen from the front.
"""

from .energy import EnergyBalance, energy_balance
from .environment import Environment, InvalidPolygonError

# The package `form_factors` gives its name to the function: modules inside it are imported by their full path.
from .form_factors.matrix import FormFactors, form_factors
from .form_factors.pair import configuration_factor, form_factor
from .form_factors.point_to_polygon import point_to_polygon
from .solvers import Solution, State, solve, solve_radiosity

__all__ = [
    "EnergyBalance",
    "Environment",
    "FormFactors",
    "InvalidPolygonError",
    "Solution",
    "State",
    "configuration_factor",
    "energy_balance",
    "form_factor",
    "form_factors",
    "point_to_polygon",
    "solve",
    "solve_radiosity",
]
