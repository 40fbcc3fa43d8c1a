"""`radiosity.preview_material`: shows the baked colors in rendered views, and takes it back."""

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from ..addon.adapters.color_attribute import baked_attributes
from ..addon.adapters.preview_material import has_preview, remove_leftovers, restore_materials, show_preview
from ..addon.properties.progress import state


class RADIOSITY_OT_preview_material(bpy.types.Operator):
    """Show the baked colors in place of the materials, or bring the materials back"""

    bl_idname = "radiosity.preview_material"
    bl_label = "Preview Material"
    bl_options = {'REGISTER', 'UNDO'}

    use_preview: bpy.props.BoolProperty(
        name="Use Preview", description="Show the baked colors; off brings the materials back", default=True
    )

    @classmethod
    def description(cls, context, properties):
        if properties.use_preview:
            return "Show the baked colors in rendered views; the materials are kept and come back with Clear"
        return "Bring back the materials of the objects that show the baked colors"

    @classmethod
    def poll(cls, context):
        if state.is_running:
            cls.poll_message_set("A bake is running: press Esc to stop it")
        elif context.mode != 'OBJECT':
            cls.poll_message_set("Switch to Object Mode to change materials")
        else:
            return True
        return False

    def execute(self, context):
        meshes = [obj for obj in context.scene.objects if obj.type == 'MESH' and obj.is_editable]
        if not self.use_preview:
            count = sum(restore_materials(obj) for obj in meshes)
            remove_leftovers(meshes)
            self.report({'INFO'}, rpt_("Brought back the materials of {:d} objects").format(count))
            return {'FINISHED'}
        wanted = context.scene.radiosity.attribute_name
        count = 0
        for obj in meshes:
            names = baked_attributes(obj.data)
            # A mesh without slots gets one, which needs a mesh of this file.
            if names and (obj.data.is_editable or has_preview(obj)):
                show_preview(obj, wanted if wanted in names else names[-1])
                count += 1
        if not count:
            self.report({'ERROR'}, rpt_("No object in the scene has been baked: bake first"))
            return {'CANCELLED'}
        self.report({'INFO'}, rpt_("{:d} objects show the baked colors").format(count))
        return {'FINISHED'}
