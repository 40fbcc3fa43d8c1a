"""Preferences of the extension: what depends on the computer, not on the file."""

from bpy.props import FloatProperty
from bpy.types import AddonPreferences

from ... import __package__ as base_package
from ...core.visibility.embree import is_available


class RadiosityPreferences(AddonPreferences):
    """Shown where the extension is switched on."""

    bl_idname = base_package

    memory_limit: FloatProperty(
        name="Memory Limit",
        description="Refuse a bake that would take more gigabytes than this, 0 for what the computer has",
        default=0.0,
        min=0.0,
        soft_max=256.0,
        precision=1,
    )

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(self, "memory_limit", text="Memory Limit (GB)")
        if is_available():
            layout.label(text="Ray engine: Embree", icon='CHECKMARK')
        else:
            row = layout.row()
            row.alert = True
            row.label(text="The ray engine embreex is missing: bakes cannot run on this platform", icon='ERROR')
