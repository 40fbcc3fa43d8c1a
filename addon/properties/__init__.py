"""Property groups: one pointer per ID type, called `radiosity` everywhere."""

from __future__ import annotations


def _classes():
    from .light_group import RadiosityLightGroup
    from .preferences import RadiosityPreferences
    from .progress import RadiosityProgress
    from .scene import RadiositySceneSettings

    # Settings hold groups, which come first.
    return RadiosityLightGroup, RadiositySceneSettings, RadiosityProgress, RadiosityPreferences


def register() -> None:
    """Add `Scene.radiosity` and `WindowManager.radiosity`, and the preferences."""
    import bpy

    for cls in _classes():
        bpy.utils.register_class(cls)
    _group, settings, progress, _preferences = _classes()
    bpy.types.Scene.radiosity = bpy.props.PointerProperty(
        name="Radiosity", description="Settings of the radiosity bake", type=settings
    )
    bpy.types.WindowManager.radiosity = bpy.props.PointerProperty(
        name="Radiosity", description="Progress of the radiosity bake", type=progress
    )


def unregister() -> None:
    """Take back what `register` added."""
    import bpy

    del bpy.types.WindowManager.radiosity
    del bpy.types.Scene.radiosity
    for cls in reversed(_classes()):
        bpy.utils.unregister_class(cls)
