"""`radiosity.mix_groups`: the light that is shown as another mix of the light groups, without solving anything."""

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from ..addon.adapters.group_mix import all_at_once, reset_mix, write_mix
from ..addon.properties.progress import state
from ..core.errors import RadiosityError


class RADIOSITY_OT_mix_groups(bpy.types.Operator):
    """Change how light groups are mixed and write what they give together to the meshes"""

    bl_idname = "radiosity.mix_groups"
    bl_label = "Mix Light Groups"
    bl_options = {'REGISTER', 'UNDO'}

    group: bpy.props.StringProperty(
        name="Group",
        description="Name of the light group to change; empty changes none and writes the mix as it is",
        default="",
        options={'SKIP_SAVE'},
    )
    use_group: bpy.props.BoolProperty(
        name="Use Group", description="Let the light of the group take part", default=True, options={'SKIP_SAVE'}
    )
    color: bpy.props.FloatVectorProperty(
        name="Color",
        description="Multiply the light of the group by a color",
        default=(1.0, 1.0, 1.0),
        size=3,
        min=0.0,
        soft_max=1.0,
        subtype='COLOR',
        options={'SKIP_SAVE'},
    )
    strength: bpy.props.FloatProperty(
        name="Strength",
        description="Multiply the light of the group by a number",
        default=1.0,
        min=0.0,
        soft_max=10.0,
        options={'SKIP_SAVE'},
    )
    reset: bpy.props.BoolProperty(
        name="Reset", description="Bring all groups back to what was baked first", default=False, options={'SKIP_SAVE'}
    )

    @classmethod
    def poll(cls, context):
        return may_change_groups(cls, context)

    def execute(self, context):
        groups = context.scene.radiosity.groups
        if self.group and self.group not in groups:
            names = ", ".join(item.name for item in groups)
            self.report({'ERROR'}, rpt_("There is no light group {!r}: choose {:s}").format(self.group, names))
            return {'CANCELLED'}
        kept = [(item.use_group, tuple(item.color), item.strength) for item in groups]
        try:
            self._change(context.scene)
            count = write_mix(context.scene)
        except RadiosityError as error:
            with all_at_once():
                for item, values in zip(groups, kept, strict=True):
                    item.use_group, item.color, item.strength = values
            self.report({'ERROR'}, str(error))
            return {'CANCELLED'}
        self.report({'INFO'}, rpt_("Mixed {:d} light groups on {:d} meshes").format(len(groups), count))
        return {'FINISHED'}

    def _change(self, scene):
        """What was asked for; what was not given stays."""
        if self.reset:
            reset_mix(scene)
        if self.group:
            item = scene.radiosity.groups[self.group]
            with all_at_once():
                for name in ("use_group", "color", "strength"):
                    if self.properties.is_property_set(name):
                        setattr(item, name, getattr(self, name))


def may_change_groups(cls, context):
    """Whether there are light groups to be changed; a reason is set where not."""
    if state.is_running:
        cls.poll_message_set("A bake is running: press Esc to stop it")
    elif context.mode != 'OBJECT':
        cls.poll_message_set("Switch to Object Mode to change light groups")
    elif not len(context.scene.radiosity.groups):
        cls.poll_message_set("There are no light groups: choose Light Groups and bake")
    else:
        return True
    return False
