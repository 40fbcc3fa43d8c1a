"""`radiosity.stop`: the button beside the progress bar, which does what Esc does."""

import bpy

from ..addon.properties.progress import state


class RADIOSITY_OT_stop(bpy.types.Operator):
    """Stop the running bake and leave all as it was"""

    bl_idname = "radiosity.stop"
    bl_label = "Stop"
    bl_options = {'INTERNAL'}

    @classmethod
    def poll(cls, context):
        if not state.is_running:
            cls.poll_message_set("No bake is running")
        return state.is_running

    def execute(self, context):
        state.stop_requested = True
        return {'FINISHED'}
