"""`radiosity.bake`: in steps under a timer from the panel, to its end from scripts and in background."""

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from ..addon.adapters.bake_job import bake_job_steps
from ..addon.adapters.bake_settings import bake_options
from ..addon.adapters.report import messages
from ..addon.properties import bake as bake_properties
from ..addon.properties.progress import state
from ..core.errors import RadiosityError
from .step_runner import StepRunner, run_to_end

#: Events that only turn, move or measure the view: they pass while a bake runs.
_NAVIGATION = frozenset(
    "MOUSEMOVE INBETWEEN_MOUSEMOVE MIDDLEMOUSE WHEELUPMOUSE WHEELDOWNMOUSE WHEELINMOUSE WHEELOUTMOUSE TRACKPADPAN "
    "TRACKPADZOOM MOUSEROTATE MOUSESMARTZOOM NDOF_MOTION WINDOW_DEACTIVATE TIMER_REGION".split()
)

_PANEL_TAB = "Radiosity"
_ARGUMENTS = (
    "quality", "accuracy", "method", "solver", "bake_type", "attribute_name", "domain", "data_type", "seed", "threads",
    "time_limit", "world_strength", "make_single_user", "show_in_viewport",
)  # fmt: skip
_ONCE = {'options': {'SKIP_SAVE'}}  # an argument given once must not stick to later calls


class RADIOSITY_OT_bake(bpy.types.Operator):
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

    _runner = None
    _timer = None
    _workspace = ""

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

    def execute(self, context):
        manager = context.window_manager
        state.start()
        manager.progress_begin(0.0, 1.0)
        try:
            report = run_to_end(bake_job_steps(context, self._options(context)), manager.progress_update)
        except RadiosityError as error:
            self.report({'ERROR'}, str(error))
            return {'CANCELLED'}
        finally:
            manager.progress_end()
            state.finish()
        self._report_result(report)
        return {'FINISHED'}

    def invoke(self, context, event):
        if context.window is None:  # a timer needs one
            return self.execute(context)
        try:
            options = self._options(context)
        except RadiosityError as error:
            self.report({'ERROR'}, str(error))
            return {'CANCELLED'}
        self._runner = StepRunner(bake_job_steps(context, options))
        state.start()
        self._timer = context.window_manager.event_timer_add(0.01, window=context.window)
        self._workspace = context.workspace.name
        context.window_manager.modal_handler_add(self)
        self._show_progress(context)
        return {'RUNNING_MODAL'}

    def modal(self, context, event):
        status = {'CANCELLED'}
        try:
            status = self._handle(context, event)
        finally:  # an exception is a way out too
            if status in ({'FINISHED'}, {'CANCELLED'}):
                self._release(context)
        return status

    def cancel(self, context):
        self._release(context)

    def _handle(self, context, event):
        if state.stop_requested or (event.type == 'ESC' and event.value == 'PRESS'):
            self.report({'INFO'}, rpt_("Bake stopped: nothing was changed"))
            return {'CANCELLED'}
        if event.type == 'TIMER':
            try:
                done = self._runner.advance()
            except RadiosityError as error:
                self.report({'ERROR'}, str(error))
                return {'CANCELLED'}
            if done:
                self._report_result(self._runner.result)
                return {'FINISHED'}
            self._show_progress(context)
            return {'PASS_THROUGH'}  # others may wait for the same timer
        if event.type in _NAVIGATION or event.type.startswith('NDOF') or _is_over_panel(context, event):
            return {'PASS_THROUGH'}
        return {'RUNNING_MODAL'}  # swallowed: an edit would be lost on the result, or spoil it

    def _options(self, context):
        given = {name: getattr(self, name) for name in _ARGUMENTS if self.properties.is_property_set(name)}
        return bake_options(context.scene.radiosity, **given)

    def _show_progress(self, context):
        state.fraction, state.message = self._runner.fraction, self._runner.message or "Starting"
        state.seconds_left = self._runner.seconds_left
        context.workspace.status_text_set(rpt_("Radiosity: {:s}. Esc to stop").format(state.text))
        _redraw_sidebars(context)

    def _release(self, context):
        """The one way out of a modal bake: gives back the work, the timer and the status text, in any state."""
        if self._runner is not None:
            self._runner.close()
            self._runner = None
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
        workspace = bpy.data.workspaces.get(self._workspace)
        if workspace is not None:
            workspace.status_text_set(None)
        state.finish()
        _redraw_sidebars(context)

    def _report_result(self, report):
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


def _is_over_panel(context, event):
    """Whether the mouse is over our own tab, whose buttons stay usable: the only one that acts then is Stop."""
    if event.type not in ('LEFTMOUSE', 'MOUSEMOVE'):
        return False
    for area in context.screen.areas:
        if area.type != 'VIEW_3D':
            continue
        for region in area.regions:
            inside = (
                region.type == 'UI'
                and 0 <= event.mouse_x - region.x < region.width
                and 0 <= event.mouse_y - region.y < region.height
            )
            if inside and region.active_panel_category == _PANEL_TAB:
                return True
    return False


def _redraw_sidebars(context):
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == 'VIEW_3D':
                for region in area.regions:
                    if region.type == 'UI':
                        region.tag_redraw()
