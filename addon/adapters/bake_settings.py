"""Properties become settings: the one place where choices cross from Blender into the core, checked on the way.

Panel, operator and command line all come through `bake_options`, so a wrong value gets the same one line from each.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import bpy

from ... import __package__ as base_package
from ...core.errors import SettingsError
from ...core.settings import QUALITY_ACCURACY, BakeSettings
from .color_attribute import LONGEST_NAME
from .light_groups import GROUPINGS
from .memory import physical_memory

#: Attributes that Blender itself reads, with other types than colors.
RESERVED_NAMES = frozenset(
    "position material_index sharp_edge sharp_face crease_vert crease_edge bevel_weight_vert bevel_weight_edge "
    "custom_normal normal id radius freestyle_edge freestyle_face".split()
)

_DOMAINS = ("CORNER", "POINT")
_DATA_TYPES = {
    "FLOAT_COLOR": "FLOAT_COLOR", "BYTE_COLOR": "BYTE_COLOR", "FLOAT": "FLOAT_COLOR", "BYTE": "BYTE_COLOR",
}  # fmt: skip
_GIGABYTE = 1e9


@dataclass(frozen=True)
class BakeOptions:
    """All that a bake in Blender needs to know.

    Parameters
    ----------
    settings : BakeSettings
        What the core needs.
    attribute_name : str
        Color attribute that takes the light.
    domain : str
        ``CORNER`` or ``POINT``.
    data_type : str
        ``FLOAT_COLOR`` or ``BYTE_COLOR``.
    world_strength : float or None
        Replaces the strength of the world's light; white where the world is black. None keeps the world.
    make_single_user : bool
        Give objects that share a mesh one of their own before the colors are written.
    show_in_viewport : bool
        Switch the 3D viewports of the screen to the baked colors.
    light_groups : str
        Whose light is kept apart, in attributes of its own: ``NONE``, of each ``LIGHT``, of each ``COLLECTION``.

    Raises
    ------
    SettingsError
        If a value is not among those known.
    """

    settings: BakeSettings
    attribute_name: str = "Radiosity"
    domain: str = "CORNER"
    data_type: str = "FLOAT_COLOR"
    world_strength: float | None = None
    make_single_user: bool = False
    show_in_viewport: bool = False
    light_groups: str = "NONE"

    def __post_init__(self) -> None:
        check_attribute_name(self.attribute_name)
        for name, value, known in (
            ("domain", self.domain, _DOMAINS),
            ("data type", self.data_type, ("FLOAT_COLOR", "BYTE_COLOR")),
            ("kind of light groups", self.light_groups, ("NONE", *GROUPINGS)),
        ):
            if value not in known:
                raise SettingsError(f"Unknown {name} {value!r}: choose {' or '.join(known)}")
        # Written so that NaN fails too.
        if self.world_strength is not None and not 0 <= self.world_strength < float("inf"):
            raise SettingsError(f"World strength must be 0 or more, not {self.world_strength:g}")

    def as_dict(self) -> dict:
        """The same as JSON-ready values, flat, for the report."""
        values = asdict(self)
        return {**values.pop("settings"), **values}


def check_attribute_name(name: str) -> None:
    """Refuse names that no color attribute can have, before anything slow is done.

    Raises
    ------
    SettingsError
        If the name is empty, too long, hidden, or one that Blender itself uses.
    """
    if not name or name != name.strip():
        raise SettingsError(f"The attribute needs a name without spaces around it, not {name!r}")
    if len(name.encode("utf-8")) > LONGEST_NAME:
        raise SettingsError(f"The attribute's name may have {LONGEST_NAME} bytes at most: shorten {name!r}")
    if name.startswith("."):
        raise SettingsError(f"Blender hides attributes that start with a dot: choose another name than {name!r}")
    if name in RESERVED_NAMES:
        raise SettingsError(f"{name!r} is an attribute that Blender uses itself: choose another name")


def bake_options(scene_settings, **overrides) -> BakeOptions:
    """Settings of a scene, with some replaced, as validated options.

    Parameters
    ----------
    scene_settings : RadiositySceneSettings
        `Scene.radiosity`.
    **overrides
        Values by property name: quality, accuracy, method, solver, bake_type, attribute_name, domain, data_type, seed,
        threads, time_limit, memory_limit (bytes), world_strength, make_single_user, show_in_viewport, light_groups.
        None means not given. Names of choices may be in either case, with hyphens or underscores. An accuracy given
        alone means quality CUSTOM.

    Returns
    -------
    BakeOptions

    Raises
    ------
    SettingsError
        If a value is out of range or unknown, or a quality comes with an accuracy that contradicts it.
    TypeError
        If the name of an override is unknown.
    """
    given = {name: value for name, value in overrides.items() if value is not None}
    known = {
        "quality", "accuracy", "method", "solver", "bake_type", "attribute_name", "domain", "data_type", "seed",
        "threads", "time_limit", "memory_limit", "world_strength", "make_single_user", "show_in_viewport",
        "light_groups",
    }  # fmt: skip
    if unknown := sorted(given.keys() - known):
        raise TypeError(f"bake_options() got unknown names: {', '.join(unknown)}")

    def value(name: str):
        return given[name] if name in given else getattr(scene_settings, name)

    world_strength = given.get("world_strength")
    if world_strength is None and scene_settings.use_world_strength:
        world_strength = scene_settings.world_strength
    data_type = _choice(value("data_type"))
    return BakeOptions(
        settings=BakeSettings(
            accuracy=_accuracy(given, scene_settings),
            method=_choice(value("method")).lower(),
            solver=_choice(value("solver")).lower(),
            bake_type=_choice(value("bake_type")).lower(),
            seed=int(value("seed")),
            threads=int(value("threads")),
            time_limit=float(value("time_limit")),
            memory_limit=float(given["memory_limit"] if "memory_limit" in given else _memory_limit()),
        ),
        attribute_name=value("attribute_name"),
        domain=_choice(value("domain")),
        data_type=_DATA_TYPES.get(data_type, data_type),
        world_strength=None if world_strength is None else float(world_strength),
        make_single_user=bool(value("make_single_user")),
        show_in_viewport=bool(value("show_in_viewport")),
        light_groups=_choice(value("light_groups")),
    )


def _choice(name: str) -> str:
    return name.strip().upper().replace("-", "_")


def _accuracy(given: dict, scene_settings) -> float:
    if "quality" not in given and "accuracy" in given:
        return float(given["accuracy"])
    quality = _choice(given.get("quality", scene_settings.quality))
    if quality == "CUSTOM":
        # Properties hold 32-bit numbers: the shortest decimal is what the user typed.
        return float(f"{given.get('accuracy', scene_settings.accuracy):.6g}")
    if quality.lower() not in QUALITY_ACCURACY:
        names = ", ".join([*QUALITY_ACCURACY, "custom"]).upper()
        raise SettingsError(f"Unknown quality {quality!r}: choose {names}")
    if "accuracy" in given:
        raise SettingsError(f"Quality {quality} has an accuracy of its own: give only one of them, or quality CUSTOM")
    return QUALITY_ACCURACY[quality.lower()]


def _memory_limit() -> float:
    """Bytes a bake may take: the preference, or else what the computer has."""
    addon = bpy.context.preferences.addons.get(base_package)
    # Scripts that call radiosity.register() have no entry among the add-ons.
    preferred = addon.preferences.memory_limit * _GIGABYTE if addon and addon.preferences else 0.0
    return preferred or float(physical_memory() or 0)
