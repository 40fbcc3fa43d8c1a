"""`radiosity.update`: the bake brought up to date after lights were changed, without a new one."""

import time

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from ..addon.adapters.update_job import update_lights
from ..core.errors import RadiosityError
from .mix_groups import may_change_groups


class RADIOSITY_OT_update(bpy.types.Operator):
    """Bring the baked light up to date where only power and color of lights were changed since"""

    bl_idname = "radiosity.update"
    bl_label = "Update"
    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context):
        return may_change_groups(cls, context)

    def execute(self, context):
        start = time.perf_counter()
        try:
            done = update_lights(context)
        except RadiosityError as error:
            self.report({'ERROR'}, str(error))
            return {'CANCELLED'}
        text = rpt_("Relit {:d} light groups on {:d} meshes in {:.2f} s")
        self.report({'INFO'}, text.format(done.groups, done.meshes, time.perf_counter() - start))
        return {'FINISHED'}
