"""The Blender side: adapters, properties, panels and the command line.

Importing this package needs no bpy; `register` and `unregister` import what they register.
"""

from importlib import import_module

# In the order in which they build on each other; taken back in reverse.
_PARTS = (".properties", "..operators", ".panels", ".command_line")


def register() -> None:
    """Register every part, or none: what was done is taken back when a part fails."""
    done = []
    try:
        for name in _PARTS:
            part = import_module(name, __package__)
            part.register()
            done.append(part)
    except BaseException:
        for part in reversed(done):
            part.unregister()
        raise


def unregister() -> None:
    """Unregister every part, the last one first."""
    for name in reversed(_PARTS):
        import_module(name, __package__).unregister()
