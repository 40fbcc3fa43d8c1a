"""Panels of the tab Radiosity in the sidebar of the 3D viewport. They name operators by `bl_idname` and only draw."""

from __future__ import annotations


def _classes():
    from .bake import VIEW3D_PT_radiosity
    from .comparison import VIEW3D_PT_radiosity_comparison
    from .discretization import VIEW3D_PT_radiosity_discretization
    from .exchange import VIEW3D_PT_radiosity_exchange
    from .output import VIEW3D_PT_radiosity_output
    from .performance import VIEW3D_PT_radiosity_performance
    from .statistics import VIEW3D_PT_radiosity_statistics
    from .world import VIEW3D_PT_radiosity_world

    return (  # in the order in which they are shown, parent first
        VIEW3D_PT_radiosity,
        VIEW3D_PT_radiosity_output,
        VIEW3D_PT_radiosity_world,
        VIEW3D_PT_radiosity_discretization,
        VIEW3D_PT_radiosity_exchange,
        VIEW3D_PT_radiosity_performance,
        VIEW3D_PT_radiosity_statistics,
        VIEW3D_PT_radiosity_comparison,
    )


def register() -> None:
    """Register all panels."""
    import bpy

    for cls in _classes():
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Take back what `register` did."""
    import bpy

    for cls in reversed(_classes()):
        bpy.utils.unregister_class(cls)
