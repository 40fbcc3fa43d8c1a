"""Operators, one a file. Importing this package needs no bpy; `register` imports what it registers."""

from __future__ import annotations


def _classes():
    from .bake import RADIOSITY_OT_bake
    from .clear import RADIOSITY_OT_clear
    from .preview_material import RADIOSITY_OT_preview_material
    from .stop import RADIOSITY_OT_stop
    from .subdivide import RADIOSITY_OT_subdivide

    return (
        RADIOSITY_OT_bake,
        RADIOSITY_OT_stop,
        RADIOSITY_OT_subdivide,
        RADIOSITY_OT_preview_material,
        RADIOSITY_OT_clear,
    )


def register() -> None:
    """Register all operators."""
    import bpy

    for cls in _classes():
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Take back what `register` did."""
    import bpy

    from ..addon.properties.progress import state

    for cls in reversed(_classes()):
        bpy.utils.unregister_class(cls)
    state.finish()
