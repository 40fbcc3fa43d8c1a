"""Sub-panel: another strength for the world's light."""

import bpy

from .sidebar import RadiositySubPanel


class VIEW3D_PT_radiosity_world(RadiositySubPanel, bpy.types.Panel):
    bl_label = "World Override"

    def draw_header(self, context):
        self.layout.enabled = not context.window_manager.radiosity.is_running
        self.layout.prop(context.scene.radiosity, "use_world_strength", text="")

    def draw(self, context):
        layout = self.prepared_layout(context)
        settings = context.scene.radiosity
        column = layout.column()
        column.active = settings.use_world_strength
        column.prop(settings, "world_strength", text="Strength")
