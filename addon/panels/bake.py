"""Main panel: what to bake, the button, and progress while it runs."""

from collections import Counter
from functools import lru_cache

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ...core.visibility.embree import is_available
from .sidebar import RadiositySidebar


class VIEW3D_PT_radiosity(RadiositySidebar, bpy.types.Panel):
    bl_label = "Radiosity"

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        settings = context.scene.radiosity
        progress = context.window_manager.radiosity

        if not _has_ray_engine():
            column = layout.column(align=True)
            column.alert = True
            column.label(text="Ray engine embreex is missing", icon='ERROR')
            column.label(text="There is none for this platform: cannot bake", icon='BLANK1')

        column = layout.column()
        column.enabled = not progress.is_running
        column.prop(settings, "quality")
        if settings.quality == 'CUSTOM':
            column.prop(settings, "accuracy")
        column.prop(settings, "bake_type")
        column.prop(settings, "attribute_name")

        if progress.is_running:
            row = layout.row(align=True)
            row.scale_y = 1.5
            row.progress(factor=progress.fraction, text=progress.message)
            row.operator("radiosity.stop", text="", icon='X')
            layout.label(text="Esc stops and changes nothing", icon='INFO')
            return

        column = layout.column(align=True)
        for text, icon in _receivers(context):
            column.label(text=text, icon=icon)
        column = layout.column()
        row = column.row()
        row.scale_y = 1.5
        row.operator("radiosity.bake", text="Bake", icon='LIGHT_SUN')
        column.operator("radiosity.clear", icon='TRASH')


def _receivers(context):
    """Lines with icons: which meshes will take the light, and what is wrong with them, before the button is pressed."""
    if context.mode != 'OBJECT':
        return [("Switch to Object Mode to bake", 'ERROR')]
    selected = [obj for obj in context.selected_objects if obj.type == 'MESH']
    if not selected:
        return [("All rendered meshes receive light", 'OUTLINER_OB_MESH')]
    if not any(len(obj.data.polygons) for obj in selected):
        return [("The selected meshes have no faces", 'ERROR')]
    if len(selected) == 1:
        lines = [(iface_("Receives light: {:s}").format(selected[0].name), 'OUTLINER_OB_MESH')]
    else:
        lines = [(iface_("Receive light: {:,d} meshes").format(len(selected)), 'OUTLINER_OB_MESH')]
    sharing = sum(count for count in Counter(obj.data for obj in selected).values() if count > 1)
    if sharing and not context.scene.radiosity.make_single_user:
        lines.append((iface_("{:,d} share a mesh: Make Single User").format(sharing), 'ERROR'))
    return lines


@lru_cache(maxsize=1)
def _has_ray_engine():
    # A failing import searches the whole path, too slow for every redraw.
    return is_available()
