"""What the render sees: objects hidden in the viewport only must block light, those hidden from the render must not.

Blender evaluates a scene for the viewport or for a render, and the latter only for a render engine at work. The reader
therefore shows for a moment what is hidden in the viewport alone, and puts everything back before anything is drawn.
Modifiers keep their viewport settings: what the artist sees is what is baked. Local view does not matter.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import bpy


def rendered_objects(view_layer: bpy.types.ViewLayer) -> set[bpy.types.Object]:
    """Objects of a view layer that a render shows: not hidden themselves, and in a collection that is not."""
    found: set[bpy.types.Object] = set()

    def collect(layer):
        if layer.exclude or layer.collection.hide_render:
            # Children of an excluded collection have their own switch; those of one hidden from the render do not.
            if layer.exclude and not layer.collection.hide_render:
                for child in layer.children:
                    collect(child)
            return
        found.update(obj for obj in layer.collection.objects if not obj.hide_render)
        for child in layer.children:
            collect(child)

    collect(view_layer.layer_collection)
    return found


def instanced_objects(collection: bpy.types.Collection) -> set[bpy.types.Object]:
    """Objects that an instance of a collection shows in a render, those of instances within it included."""
    found: set[bpy.types.Object] = set()
    visited: set[bpy.types.Collection] = set()

    def collect(each):
        if each in visited or each.hide_render:
            return
        visited.add(each)
        for obj in each.objects:
            if not obj.hide_render:
                found.add(obj)
                if obj.instance_type == 'COLLECTION' and obj.instance_collection is not None:
                    collect(obj.instance_collection)
        for child in each.children:
            collect(child)

    # The switch of the instanced collection itself is for its own place in the scene.
    visited.add(collection)
    for obj in collection.objects:
        if not obj.hide_render:
            found.add(obj)
            if obj.instance_type == 'COLLECTION' and obj.instance_collection is not None:
                collect(obj.instance_collection)
    for child in collection.children:
        collect(child)
    return found


@contextmanager
def shown_as_rendered(context: bpy.types.Context) -> Iterator[bpy.types.Depsgraph]:
    """The evaluated scene with everything in it that a render shows, whatever is hidden in the viewport.

    Parameters
    ----------
    context : bpy.types.Context

    Yields
    ------
    bpy.types.Depsgraph
        Holds objects that are hidden from the render too: filter by `rendered_objects`. Not to be used after.
    """
    view_layer = context.view_layer
    undo = []
    try:
        _show(view_layer, undo)
        if undo:
            view_layer.update()
        yield context.evaluated_depsgraph_get()
    finally:
        for restore in reversed(undo):
            restore()
        if undo:
            view_layer.update()


def _show(view_layer, undo) -> None:
    """Show what is hidden in the viewport only; fills `undo` with functions that hide it again."""

    def switch(owner, name, value):
        before = getattr(owner, name)
        if before != value:
            setattr(owner, name, value)
            undo.append(lambda: setattr(owner, name, before))

    def walk(layer):
        if not layer.collection.hide_render:
            switch(layer.collection, "hide_viewport", False)
            if not layer.exclude:
                switch(layer, "hide_viewport", False)
            for child in layer.children:
                walk(child)

    rendered = rendered_objects(view_layer)
    # Eye icons first: they can be read only while collections and monitors are as the artist left them.
    hidden = [obj for obj in rendered if obj.hide_get(view_layer=view_layer)]
    walk(view_layer.layer_collection)
    instanced = {obj.instance_collection for obj in rendered if obj.instance_type == 'COLLECTION'} - {None}
    shown = set(rendered)
    for collection in instanced:
        shown |= instanced_objects(collection)
        for child in collection.children_recursive:
            if not child.hide_render:
                switch(child, "hide_viewport", False)
    for obj in sorted(shown, key=lambda each: each.name_full):
        switch(obj, "hide_viewport", False)
        switch(obj, "show_instancer_for_viewport", obj.show_instancer_for_render)
    for obj in hidden:
        obj.hide_set(False, view_layer=view_layer)
        undo.append(lambda obj=obj: obj.hide_set(True, view_layer=view_layer))
