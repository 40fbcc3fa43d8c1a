"""Sources of direct light, one module a kind. A light is a frozen dataclass that satisfies `Light`.

Emissive faces become `AreaLight`s inside the bake; lamps are made by whoever reads the scene.
"""

from __future__ import annotations

from .area import AreaLight
from .light import Light
from .point import PointLight
from .spot import SpotLight
from .sun import SunLight

__all__ = ["AreaLight", "Light", "PointLight", "SpotLight", "SunLight"]
