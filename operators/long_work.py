"""Operators whose work takes long: in steps under a timer from the window, to its end from scripts and in background.

While one runs, the view can be turned and moved and the mouse measured, Esc stops, and all else is swallowed: an edit
would be lost on the result, or spoil it.
"""

from collections.abc import Generator
from typing import Any

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from ..addon.properties.progress import state
from ..core.errors import RadiosityError
from .step_runner import StepRunner, run_to_end

#: Events that only turn, move or measure the view: they pass while work runs.
_NAVIGATION = frozenset(
    "MOUSEMOVE INBETWEEN_MOUSEMOVE MIDDLEMOUSE WHEELUPMOUSE WHEELDOWNMOUSE WHEELINMOUSE WHEELOUTMOUSE TRACKPADPAN "
    "TRACKPADZOOM MOUSEROTATE MOUSESMARTZOOM NDOF_MOTION WINDOW_DEACTIVATE TIMER_REGION".split()
)

_PANEL_TAB = "Radiosity"


class LongWork:
    """Mixin of an operator that gives its work as a generator of `Progress` and tells what came of it.

    Subclasses write `steps`, `tell` and `stopped_text`.
    """

    _runner = None
    _timer = None
    _workspace = ""

    #: What is said after Esc.
    stopped_text = ""

    def steps(self, context: bpy.types.Context) -> Generator[Any, None, Any]:
        """The work; what it raises as `RadiosityError`, now or later, becomes an error message."""
        raise NotImplementedError

    def tell(self, result: Any) -> None:
        """Report the result to the user."""
        raise NotImplementedError

    def execute(self, context):
        manager = context.window_manager
        state.start()
        manager.progress_begin(0.0, 1.0)
        try:
            result = run_to_end(self.steps(context), manager.progress_update)
        except RadiosityError as error:
            self.report({'ERROR'}, str(error))
            return {'CANCELLED'}
        finally:
            manager.progress_end()
            state.finish()
        self.tell(result)
        return {'FINISHED'}

    def invoke(self, context, event):
        if context.window is None:  # a timer needs one
            return self.execute(context)
        try:
            steps = self.steps(context)
        except RadiosityError as error:
            self.report({'ERROR'}, str(error))
            return {'CANCELLED'}
        self._runner = StepRunner(steps)
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
            self.report({'INFO'}, rpt_(self.stopped_text))
            return {'CANCELLED'}
        if event.type == 'TIMER':
            try:
                done = self._runner.advance()
            except RadiosityError as error:
                self.report({'ERROR'}, str(error))
                return {'CANCELLED'}
            if done:
                self.tell(self._runner.result)
                return {'FINISHED'}
            self._show_progress(context)
            return {'PASS_THROUGH'}  # others may wait for the same timer
        if event.type in _NAVIGATION or event.type.startswith('NDOF') or _is_over_panel(context, event):
            return {'PASS_THROUGH'}
        return {'RUNNING_MODAL'}

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
