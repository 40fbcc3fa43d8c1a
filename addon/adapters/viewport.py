"""3D viewports that show the baked colors, and go back to what they were.

A screen remembers the shading of its viewports in the custom property `STATE_KEY`, by their place among its areas.
"""

from __future__ import annotations

import json

import bpy

#: Custom property of a screen: JSON, a list with the former shading of each viewport that was switched.
STATE_KEY = "radiosity_shading"

#: Solid shading with the active color attribute and no light of its own: what is stored is what is seen.
_SHOWN = {"type": "SOLID", "light": "FLAT", "color_type": "VERTEX"}


def show_colors(screen: bpy.types.Screen | None) -> None:
    """Switch the 3D viewports of a screen to the active color attribute. Does nothing without a screen."""
    if screen is None:
        return
    former = json.loads(screen.get(STATE_KEY, "[]"))
    known = {entry["area"] for entry in former}
    for index, area in enumerate(screen.areas):
        if area.type != 'VIEW_3D':
            continue
        shading = area.spaces.active.shading
        now = {name: getattr(shading, name) for name in _SHOWN}
        if now == _SHOWN:
            continue
        if index not in known:
            former.append({"area": index, **now})
        for name, value in _SHOWN.items():
            setattr(shading, name, value)
    if former:
        screen[STATE_KEY] = json.dumps(former)


def restore_shading(screen: bpy.types.Screen) -> bool:
    """Take back `show_colors`, except what the artist has changed since; whether there was anything."""
    if STATE_KEY not in screen:
        return False
    for entry in json.loads(screen[STATE_KEY]):
        area = screen.areas[entry["area"]] if entry["area"] < len(screen.areas) else None
        if area is None or area.type != 'VIEW_3D':
            continue  # the artist has rearranged the screen
        shading = area.spaces.active.shading
        # Type last: which values the other two may have depends on it.
        for name in ("color_type", "light", "type"):
            if getattr(shading, name) == _SHOWN[name]:
                setattr(shading, name, entry[name])
    del screen[STATE_KEY]
    return True
