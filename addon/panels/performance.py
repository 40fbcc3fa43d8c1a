"""Sub-panel: time, threads and seed."""

import bpy

from .sidebar import RadiositySubPanel


class VIEW3D_PT_radiosity_performance(RadiositySubPanel, bpy.types.Panel):
    bl_label = "Performance"

    def draw(self, context):
        layout = self.prepared_layout(context)
        settings = context.scene.radiosity
        column = layout.column()
        column.prop(settings, "time_limit")
        column.prop(settings, "threads")
        column.prop(settings, "seed")
