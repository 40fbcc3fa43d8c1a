"""Sub-panel: where the light is stored and how it is shown."""

import bpy

from ..adapters.preview_material import has_preview
from .sidebar import RadiositySubPanel


class VIEW3D_PT_radiosity_output(RadiositySubPanel, bpy.types.Panel):
    bl_label = "Output"

    def draw(self, context):
        layout = self.prepared_layout(context)
        settings = context.scene.radiosity
        column = layout.column()
        column.prop(settings, "domain")
        column.prop(settings, "data_type")
        column = layout.column(heading="Objects")
        column.prop(settings, "make_single_user")
        column = layout.column(heading="Display")
        column.prop(settings, "show_in_viewport")

        is_shown = context.object is not None and has_preview(context.object)
        text, icon = ("Restore Materials", 'LOOP_BACK') if is_shown else ("Show Preview Material", 'SHADING_RENDERED')
        layout.operator("radiosity.preview_material", text=text, icon=icon).use_preview = not is_shown
