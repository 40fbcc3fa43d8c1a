"""`radiosity.clear`: a file as if no bake had ever been."""

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from ..addon.adapters.color_attribute import remove_color_attributes
from ..addon.adapters.compare_job import remove_comparison
from ..addon.adapters.preview_material import remove_leftovers, restore_materials
from ..addon.adapters.report import remove_report
from ..addon.adapters.viewport import restore_shading
from ..addon.properties.progress import state


class RADIOSITY_OT_clear(bpy.types.Operator):
    """Remove from the scene all that baking has added: colors, preview materials, viewport shading, reports"""

    bl_idname = "radiosity.clear"
    bl_label = "Clear"
    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context):
        if state.is_running:
            cls.poll_message_set("A bake is running: press Esc to stop it")
        elif context.mode != 'OBJECT':
            cls.poll_message_set("Switch to Object Mode to clear")
        else:
            return True
        return False

    def execute(self, context):
        objects = [obj for obj in context.scene.objects if obj.type == 'MESH' and obj.is_editable]
        for obj in objects:
            restore_materials(obj)
        remove_leftovers(objects)
        meshes = {obj.data for obj in objects if obj.data.is_editable}
        count = sum(remove_color_attributes(mesh) for mesh in meshes)
        for screen in bpy.data.screens:
            restore_shading(screen)
        remove_report(context.scene)
        remove_comparison(context.scene)
        self.report({'INFO'}, rpt_("Cleared the light of {:d} meshes").format(count))
        return {'FINISHED'}
