"""Radiosity in arrays: no Blender in here.

Conventions, everywhere: meters, watts, scene-linear Rec.709 RGB. ``form_factors[i, j]`` is the fraction of the power
leaving patch i that reaches patch j, so rows sum to at most 1, ``areas[i] * F[i, j] == areas[j] * F[j, i]``, and
``B = E + reflectance * (F @ B)``. Radiosity, exitance and irradiance are in W/m2; what a bake stores is those over pi.
Angles are radians. Normals follow the right-hand rule: counter-clockwise corners, seen from the front.
"""
