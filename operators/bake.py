"""`radiosity.bake`: in steps under a timer from the panel, to its end from scripts and in background."""

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from ..addon.adapters.bake_job import bake_job_steps
from ..addon.adapters.bake_settings import bake_options
from ..addon.adapters.report import messages
from ..addon.properties import bake as bake_properties
from ..addon.properties.progress import state
from .long_work import LongWork

_ARGUMENTS = (
    "quality", "accuracy", "method", "solver", "bake_type", "attribute_name", "domain", "data_type", "seed", "threads",
    "time_limit", "world_strength", "make_single_user", "show_in_viewport", "light_groups",
)  # fmt: skip
_ONCE = {'options': {'SKIP_SAVE'}}  # an argument given once must not stick to later calls


class RADIOSITY_OT_bake(LongWork, bpy.types.Operator):
    """Find the light that the selected meshes exchange and store it in their color attribute"""

    bl_idname = "radiosity.bake"
    bl_label = "Bake Radiosity"
    bl_options = {'UNDO'}

    quality: bake_properties.quality(**_ONCE)
    accuracy: bake_properties.accuracy(**_ONCE)
    method: bake_properties.method(**_ONCE)
    solver: bake_properties.solver(**_ONCE)
    bake_type: bake_properties.bake_type(**_ONCE)
    attribute_name: bake_properties.attribute_name(**_ONCE)
    domain: bake_properties.domain(**_ONCE)
    data_type: bake_properties.data_type(**_ONCE)
    seed: bake_properties.seed(**_ONCE)
    threads: bake_properties.threads(**_ONCE)
    time_limit: bake_properties.time_limit(**_ONCE)
    world_strength: bake_properties.world_strength(**_ONCE)
    make_single_user: bake_properties.make_single_user(**_ONCE)
    show_in_viewport: bake_properties.show_in_viewport(**_ONCE)
    light_groups: bake_properties.light_groups(**_ONCE)

    stopped_text = "Bake stopped: nothing was changed"

    @classmethod
    def poll(cls, context):
        if state.is_running:
            cls.poll_message_set("A bake is running: press Esc to stop it")
        elif context.mode != 'OBJECT':
            cls.poll_message_set("Switch to Object Mode to bake")
        elif not any(obj.type == 'MESH' for obj in context.scene.objects):
            cls.poll_message_set("There is no mesh in the scene")
        else:
            return True
        return False

    def steps(self, context):
        given = {name: getattr(self, name) for name in _ARGUMENTS if self.properties.is_property_set(name)}
        return bake_job_steps(context, bake_options(context.scene.radiosity, **given))

    def tell(self, report):
        for warning in messages(report):
            self.report({'WARNING'}, warning)
        self.report({'INFO'}, _closing_line(report))


def _closing_line(report):
    scene = report["scene"]
    line = rpt_("Baked {:,d} receivers on {:d} objects in {:.1f} s").format(
        scene.get("receivers") or 0, scene.get("baked_objects") or 0, report["seconds"]["total"]
    )
    error, absorbed = report["estimated_error"], report["light_absorbed"]
    if error is not None:
        line += rpt_(", error about {:.1f} %").format(100 * error)
    if absorbed is not None:
        line += rpt_(", {:.1f} % of the light absorbed").format(100 * absorbed)
    return line
