"""`radiosity.flatten_groups`: the mix of the light groups for good, and the groups gone."""

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from ..addon.adapters.group_mix import flatten_groups
from ..addon.adapters.update_job import store_state
from .mix_groups import may_change_groups


class RADIOSITY_OT_flatten_groups(bpy.types.Operator):
    """Remove the light groups of all meshes of the scene and keep the light as it is mixed"""

    bl_idname = "radiosity.flatten_groups"
    bl_label = "Flatten Light Groups"
    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context):
        return may_change_groups(cls, context)

    def execute(self, context):
        count = flatten_groups(context.scene)
        store_state(context.scene, None)
        self.report({'INFO'}, rpt_("Flattened the light groups of {:d} meshes").format(count))
        return {'FINISHED'}
