"""`radiosity.subdivide`: vertices where the light needs them."""

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy.app.translations import pgettext_rpt as rpt_

from ..addon.adapters.subdivision import predicted_counts, proposed_length, subdivide_targets, subdivision_targets
from ..addon.properties.progress import state
from ..core.errors import RadiosityError


class RADIOSITY_OT_subdivide(bpy.types.Operator):
    """Divide the faces of the selected meshes until no edge is longer than a given length in the scene"""

    bl_idname = "radiosity.subdivide"
    bl_label = "Subdivide"
    bl_options = {'REGISTER', 'UNDO'}

    max_edge_length: bpy.props.FloatProperty(
        name="Maximum Edge",
        description=(
            "Divide faces until none of their edges is longer than this; 0 takes the scene's setting, or a length that"
            " gives about 20,000 vertices where none was set"
        ),
        default=0.0,
        min=0.0,
        soft_max=10.0,
        subtype='DISTANCE',
        unit='LENGTH',
        options={'SKIP_SAVE'},
    )
    limit: bpy.props.IntProperty(
        name="Vertex Limit",
        description=(
            "Refuse when the selected meshes would get more vertices than this in all; 0 takes the scene's setting"
        ),
        default=0,
        min=0,
        options={'SKIP_SAVE'},
    )

    _targets = ()
    _proposal = 0.0
    _shown = (None, None)

    @classmethod
    def poll(cls, context):
        if state.is_running:
            cls.poll_message_set("A bake is running: press Esc to stop it")
        elif context.mode != 'OBJECT':
            cls.poll_message_set("Switch to Object Mode to subdivide")
        elif not any(obj.type == 'MESH' for obj in context.selected_objects):
            cls.poll_message_set("Select the meshes to subdivide")
        else:
            return True
        return False

    def invoke(self, context, event):
        try:
            self._targets = subdivision_targets(context.selected_objects)
        except RadiosityError as error:
            self.report({'ERROR'}, str(error))
            return {'CANCELLED'}
        self._proposal = proposed_length(self._targets)
        self._complete(context)
        return context.window_manager.invoke_props_dialog(self, width=340)

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(self, "max_edge_length")
        layout.prop(self, "limit")
        column = layout.column(align=True)
        if not self._targets:  # redone from the redo panel: the result is in view
            return
        asked = (self.max_edge_length, self.limit)
        if self._shown[0] != asked:
            counts = predicted_counts(self._targets, *asked) if self.max_edge_length > 0.0 else None
            self._shown = (asked, counts)
        existing = sum(len(target.mesh.vertices) for target in self._targets)
        column.label(text=iface_("Now: {:,d} vertices").format(existing), translate=False)
        if self._shown[1] is None:
            column.alert = True
            column.label(text=iface_("Then: more than the limit"), translate=False, icon='ERROR')
        else:
            column.label(text=iface_("Then: {:,d} vertices, {:,d} faces").format(*self._shown[1]), translate=False)
        column.label(text=iface_("Proposed: {:g} m").format(self._proposal), translate=False)

    def execute(self, context):
        try:
            targets = subdivision_targets(context.selected_objects)
            if self.max_edge_length == 0.0:
                self._proposal = proposed_length(targets)
            self._complete(context)
            meshes, vertices, faces = subdivide_targets(targets, self.max_edge_length, self.limit)
        except RadiosityError as error:
            self.report({'ERROR'}, str(error))
            return {'CANCELLED'}
        finally:
            self._targets = ()
        if meshes == 0:
            text = rpt_("Nothing to divide: no edge of the selected meshes is longer than {:g} m")
            self.report({'INFO'}, text.format(self.max_edge_length))
            return {'CANCELLED'}
        text = rpt_("Divided {:d} meshes to edges of at most {:g} m: {:,d} vertices, {:,d} faces")
        self.report({'INFO'}, text.format(meshes, self.max_edge_length, vertices, faces))
        return {'FINISHED'}

    def _complete(self, context):
        """Arguments that were left out, from the scene."""
        settings = context.scene.radiosity
        if self.max_edge_length == 0.0:
            # A length that nobody has set knows nothing about this scene.
            is_set = settings.is_property_set("subdivide_length") and settings.subdivide_length > 0.0
            self.max_edge_length = settings.subdivide_length if is_set else self._proposal
        if self.limit == 0:
            self.limit = settings.subdivide_limit
