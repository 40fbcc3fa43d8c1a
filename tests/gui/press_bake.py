"""Runs inside the program, under a virtual display: a bake from the button to its end, and one stopped by Esc.

Input goes through the display, as a user's hands give it. Where a button is, the program itself tells: with the mouse
over it, it copies the Python command of the button to the clipboard.
"""

import hashlib

import bpy
import numpy as np


def over_button(gui, command, across=0.45):
    """Generator: move the mouse onto the button of the sidebar that runs a command, at a share of its width."""
    region = gui.region("UI")
    manager = bpy.context.window_manager
    for down in range(20, region.height, 8):
        gui.move(region.x + across * region.width, region.y + region.height - down)
        yield 0.15
        manager.clipboard = ""
        with bpy.context.temp_override(window=gui.window, area=gui.area(), region=region):
            if bpy.ops.ui.copy_python_command_button.poll():
                bpy.ops.ui.copy_python_command_button()
        if manager.clipboard.startswith(command):
            return
    raise RuntimeError(f"no button in the sidebar runs {command}")


def press(gui, command, across=0.45):
    """Generator: press that button with the mouse."""
    yield from over_button(gui, command, across)
    gui._xdotool("click", 1)
    yield 0.3


def state(mesh):
    """A digest of all that a bake could change in a mesh."""
    digest = hashlib.sha256()
    for attribute in sorted(mesh.attributes, key=lambda item: item.name):
        digest.update(f"{attribute.name} {attribute.domain} {attribute.data_type}".encode())
        if attribute.data_type in ('FLOAT_COLOR', 'BYTE_COLOR'):
            values = np.empty(4 * len(attribute.data), np.float32)
            attribute.data.foreach_get("color", values)
            digest.update(values.tobytes())
    digest.update(f"{mesh.attributes.active_color_name} {dict(mesh.items())}".encode())
    return digest.hexdigest()


def make_floor(count):
    """A floor of count x count faces below the cube and the lamp of the startup file, selected with the cube."""
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=count, y_subdivisions=count, size=8, location=(0, 0, -1))
    floor = bpy.context.object
    floor.name = "Floor"
    bpy.data.objects["Cube"].select_set(True)
    return floor


def wait_until(condition, seconds, what):
    """Generator: wait for a condition, at most that long."""
    for _ in range(int(seconds / 0.1)):
        if condition():
            return
        yield 0.1
    raise RuntimeError(f"waited {seconds} s for {what}")


def main(gui):
    manager = bpy.context.window_manager
    space = gui.area().spaces.active
    with gui.override():
        floor = make_floor(60)
    settings = bpy.context.scene.radiosity
    settings.quality = 'DRAFT'
    yield from gui.sidebar("Radiosity")
    yield 0.5
    gui.snap("tab")

    # The whole way: press, wait, look.
    yield from press(gui, "bpy.ops.radiosity.bake(")
    yield from wait_until(lambda: not manager.radiosity.is_running, 60, "the bake to end")
    for name in ("Cube", "Floor"):
        assert bpy.data.objects[name].data.attributes.active_color_name == "Radiosity", name
    assert space.shading.color_type == 'VERTEX' and space.shading.type == 'SOLID'
    assert "radiosity_report" in bpy.context.scene
    bpy.ops.object.select_all(action='DESELECT')
    floor.select_set(True)
    bpy.data.objects["Cube"].select_set(True)
    yield 1.0
    gui.snap("baked")

    # A long bake, stopped half-way by Esc: nothing changed, and the interface takes the next bake.
    with gui.override():
        bpy.ops.object.select_all(action='DESELECT')
        bpy.data.objects.remove(floor)
        floor = make_floor(500)
    settings.quality, settings.accuracy = 'CUSTOM', 0.002
    before = {obj.name: state(obj.data) for obj in (floor, bpy.data.objects["Cube"])}
    report = bpy.context.scene["radiosity_report"]
    yield from press(gui, "bpy.ops.radiosity.bake(")
    yield from wait_until(lambda: manager.radiosity.is_running, 10, "the bake to start")
    yield from wait_until(lambda: manager.radiosity.fraction > 0.05, 60, "progress")
    gui.snap("running")
    # A bake swallows what would edit: G would start to move the selected objects.
    gui.over_viewport()
    yield 0.2
    place = floor.location.copy()
    gui.key("g")
    yield 0.3
    assert manager.radiosity.is_running and floor.location == place
    gui.key("Escape")
    yield from wait_until(lambda: not manager.radiosity.is_running, 20, "the bake to stop")
    after = {obj.name: state(obj.data) for obj in (bpy.data.objects["Floor"], bpy.data.objects["Cube"])}
    assert after == before, "a stopped bake changed a mesh"
    assert bpy.context.scene["radiosity_report"] == report
    yield 0.5
    gui.snap("stopped")

    # The button beside the bar does the same.
    yield from press(gui, "bpy.ops.radiosity.bake(")
    yield from wait_until(lambda: manager.radiosity.fraction > 0.05, 60, "progress")
    yield from press(gui, "bpy.ops.radiosity.stop(", across=0.83)
    yield from wait_until(lambda: not manager.radiosity.is_running, 20, "the bake to stop")
    assert {name: state(bpy.data.objects[name].data) for name in before} == before

    settings.quality = 'DRAFT'
    yield from press(gui, "bpy.ops.radiosity.bake(")
    yield from wait_until(lambda: not manager.radiosity.is_running, 120, "the bake to end")
    assert bpy.data.objects["Floor"].data.attributes.active_color_name == "Radiosity"
    yield 0.5
    gui.snap("again")

    yield from press(gui, "bpy.ops.radiosity.clear(")
    assert "Radiosity" not in bpy.data.objects["Floor"].data.attributes
    assert space.shading.color_type == 'MATERIAL' and space.shading.light == 'STUDIO'
    assert "radiosity_report" not in bpy.context.scene
    yield 0.5
    gui.snap("cleared")
