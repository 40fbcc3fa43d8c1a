"""Radiosity: bakes diffuse interreflection into the color attributes of meshes.

This folder is the package, as a Blender extension wants it. Importing it needs neither Blender nor any other module, so
that `radiosity.core` serves any Python with NumPy, and tests of the core run without bpy. `register()` and
`unregister()` make it an add-on, in the program and with the bpy module.
"""


def register() -> None:
    """Register properties, operators, panels and the command line with the running Blender."""
    from . import addon

    addon.register()


def unregister() -> None:
    """Take back all that `register` did, in reverse."""
    from . import addon

    addon.unregister()
