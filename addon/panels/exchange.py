"""Sub-panel: how the exchange of light is found and summed, for those who want a technique for its own sake."""

import bpy

from .sidebar import RadiositySubPanel


class VIEW3D_PT_radiosity_exchange(RadiositySubPanel, bpy.types.Panel):
    bl_label = "Form Factors"

    def draw(self, context):
        layout = self.prepared_layout(context)
        settings = context.scene.radiosity
        column = layout.column()
        column.prop(settings, "method")
        column.prop(settings, "solver")
        if settings.method == 'AUTO' and settings.solver == 'AUTO':
            return
        column = layout.column(align=True)
        column.label(text="A full matrix: fewer patches, coarser", icon='INFO')
        column.label(text="shadows of bounced light than Automatic", icon='BLANK1')
        if settings.method == 'CONTOUR_INTEGRAL':
            column.label(text="Has no shadows of its own: rays add them", icon='BLANK1')
