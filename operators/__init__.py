"""Operators, one a file. Importing this package needs no bpy; `register` imports what it registers.

A file with a class RADIOSITY_OT_... is all that a new operator needs.
"""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules


def _classes():
    modules = [import_module(f".{found.name}", __package__) for found in iter_modules(__path__)]
    return [
        cls
        for module in modules
        for name, cls in vars(module).items()
        if name.startswith("RADIOSITY_OT_") and cls.__module__ == module.__name__
    ]


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
