"""Sub-panel: what each method costs on this scene and how wrong it is, once it was asked."""

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..adapters.compare_job import read_comparison
from .sidebar import RadiositySubPanel


class VIEW3D_PT_radiosity_comparison(RadiositySubPanel, bpy.types.Panel):
    bl_label = "Comparison of Methods"

    def draw(self, context):
        layout = self.prepared_layout(context)
        layout.operator("radiosity.compare", icon='GRAPH')
        comparison = read_comparison(context.scene)
        if comparison is None:
            return
        column = layout.column(align=True)
        for trial in comparison["trials"]:
            split = column.split(factor=0.55)
            icon = 'SOLO_ON' if trial["recommended"] else 'BLANK1'
            split.label(text=f"{trial['method']} {100 * trial['accuracy']:.3g} %", icon=icon, translate=False)
            if trial["measured_error"] is None:
                split.label(text=iface_("refused"), translate=False)
            else:
                split.label(text=f"{100 * trial['measured_error']:.2g} %, {trial['seconds']:.1f} s", translate=False)
        if not comparison["keeps"]:
            layout.label(text="None keeps the accuracy asked for", icon='ERROR')
