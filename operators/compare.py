"""`radiosity.compare`: every method on the scene at hand, what it costs and how wrong it is."""

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from ..addon.adapters.bake_settings import bake_options
from ..addon.adapters.compare_job import advice, compare_job_steps, show_comparison
from ..addon.properties.progress import state
from ..core.verification.verification import PLACES
from .long_work import LongWork


class RADIOSITY_OT_compare(LongWork, bpy.types.Operator):
    """Bake by every method, without storing anything, and measure the error of each at the same vertices"""

    bl_idname = "radiosity.compare"
    bl_label = "Compare Methods"
    bl_options = {'UNDO'}

    places: bpy.props.IntProperty(
        name="Places",
        description="Vertices whose light is compared; four times as many halve the width of the interval",
        default=PLACES,
        min=16,
        max=100_000,
        options={'SKIP_SAVE'},
    )

    stopped_text = "Comparison stopped: nothing was changed"

    @classmethod
    def poll(cls, context):
        if state.is_running:
            cls.poll_message_set("A bake is running: press Esc to stop it")
        elif context.mode != 'OBJECT':
            cls.poll_message_set("Switch to Object Mode to compare")
        elif not any(obj.type == 'MESH' for obj in context.scene.objects):
            cls.poll_message_set("There is no mesh in the scene")
        else:
            return True
        return False

    def steps(self, context):
        return compare_job_steps(context, bake_options(context.scene.radiosity), places=self.places)

    def tell(self, comparison):
        image = show_comparison(comparison, bpy.context.scene.name)
        if image is not None:
            _open_in_image_editor(bpy.context.window, image)
        line = advice(comparison)
        self.report({'INFO'}, rpt_("Compared {:d} bakes: {:s}").format(len(comparison["trials"]), line))


def _open_in_image_editor(window, image):
    """Show the image where an image editor is open, and else in a window of its own, as Blender does with renders."""
    if bpy.app.background or window is None:
        return
    areas = [area for window in bpy.context.window_manager.windows for area in window.screen.areas]
    editor = next((area for area in areas if area.type == 'IMAGE_EDITOR'), None)
    if editor is None:
        known = set(bpy.context.window_manager.windows)
        with bpy.context.temp_override(window=window):
            bpy.ops.wm.window_new()
        opened = next(iter(set(bpy.context.window_manager.windows) - known), None)
        if opened is None:
            return
        editor = max(opened.screen.areas, key=lambda area: area.width * area.height)
        editor.type = 'IMAGE_EDITOR'
    editor.spaces.active.image = image
