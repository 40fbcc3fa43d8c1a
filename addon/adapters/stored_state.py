"""What a file was left in, mode and selection, must not decide what the command line bakes.

A selection is a trace of the artist's last click, and a file saved in Edit Mode is as good as any other. In a session
that somebody watches both mean something; there the bake keeps to the selection and asks to leave Edit Mode.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import bpy

from ...core.errors import EmptySceneError, RadiosityError


def leave_edit_mode(context: bpy.types.Context) -> None:
    """Bring every object of the view layer out of Edit Mode, the active one or not; its edits are kept.

    Raises
    ------
    RadiosityError
        If Blender does not let one go; the text names it.
    """
    objects = context.view_layer.objects
    active = objects.active
    for obj in objects:
        # Leaving it for one object does so for all of its type that are edited together.
        if obj.mode != 'EDIT':
            continue
        # Two things are asked for: the view layer's active object, whose mode is set, and the context's, which the
        # program's --command has none of, since no window belongs to it.
        objects.active = obj
        try:
            with context.temp_override(active_object=obj, object=obj):
                left = bpy.ops.object.mode_set.poll() and 'FINISHED' in bpy.ops.object.mode_set(mode='OBJECT')
        finally:
            objects.active = active
        if not left or obj.mode == 'EDIT':
            raise RadiosityError(
                f"{obj.name!r} cannot leave Edit Mode: open the file, switch to Object Mode and save it"
            )


@contextmanager
def receiving(context: bpy.types.Context, only_selected: bool) -> Iterator[None]:
    """While it lasts, a bake takes all meshes that render, or with `only_selected` the selected ones.

    The selection is put back at the end, whatever happens.

    Parameters
    ----------
    context : bpy.types.Context
    only_selected : bool

    Raises
    ------
    EmptySceneError
        If the selected ones are wanted and no mesh is selected.
    """
    view_layer = context.view_layer
    selected = [obj for obj in view_layer.objects if obj.select_get(view_layer=view_layer)]
    if only_selected:
        # A bake takes all meshes where it finds none selected.
        if not any(obj.type == 'MESH' for obj in selected):
            raise EmptySceneError("No mesh is selected in the file: leave out --selected to bake all that render")
        yield
        return
    names = [obj.name_full for obj in selected]
    _select(view_layer, selected, False)
    try:
        yield
    finally:
        # By name: a bake with meshes made single-user may have had objects freed and read again.
        by_name = {obj.name_full: obj for obj in view_layer.objects}
        _select(view_layer, [by_name[name] for name in names if name in by_name], True)


def _select(view_layer: bpy.types.ViewLayer, objects: list[bpy.types.Object], state: bool) -> None:
    for obj in objects:
        obj.select_set(state, view_layer=view_layer)
