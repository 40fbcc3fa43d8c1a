"""Sub-panel: lights whose light is kept apart, and the mix of them that is shown."""

import bpy

from .sidebar import RadiositySubPanel


class VIEW3D_PT_radiosity_light_groups(RadiositySubPanel, bpy.types.Panel):
    bl_label = "Light Groups"

    def draw(self, context):
        layout = self.prepared_layout(context)
        settings = context.scene.radiosity
        column = layout.column()
        column.prop(settings, "light_groups", text="Groups")
        if settings.light_groups != 'NONE' and (settings.method, settings.solver) != ('AUTO', 'AUTO'):
            column.label(text="Only with Method and Solver Automatic", icon='ERROR')
        if not len(settings.groups):
            return
        if context.mode != 'OBJECT':
            layout.label(text="Switch to Object Mode to mix", icon='ERROR')
        column = layout.column(align=True)
        column.enabled = context.mode == 'OBJECT'
        column.use_property_split = False
        for item in settings.groups:
            row = column.row(align=True)
            row.prop(item, "use_group", text="")
            part = row.row(align=True)
            part.active = item.use_group
            part.label(text=item.name, translate=False)
            part.prop(item, "color", text="")
            part.prop(item, "strength", text="")
        layout.operator("radiosity.update", icon='FILE_REFRESH')
        row = layout.row(align=True)
        row.operator("radiosity.mix_groups", text="Reset", icon='LOOP_BACK').reset = True
        row.operator("radiosity.flatten_groups", text="Flatten", icon='NODE_COMPOSITING')
