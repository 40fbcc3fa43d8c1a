"""Sub-panel: how fine the selected meshes are, which limits how fine the light can be."""

import bpy

from .sidebar import RadiositySubPanel


class VIEW3D_PT_radiosity_discretization(RadiositySubPanel, bpy.types.Panel):
    bl_label = "Discretization"

    def draw(self, context):
        layout = self.prepared_layout(context)
        settings = context.scene.radiosity
        column = layout.column()
        column.prop(settings, "subdivide_length")
        column.prop(settings, "subdivide_limit")
        layout.operator("radiosity.subdivide", text="Subdivide...", icon='MOD_SUBSURF')
