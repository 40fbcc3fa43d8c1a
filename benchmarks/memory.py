"""Peak memory of a bake above Blender's own, per vertex, and the time, at two sizes: a process of its own for each.

    python -m benchmarks.memory [--vertices 20000,500000] [--scene cornell_box] [--threads 0] [--shading smooth]

How it is measured: a scene of one receiving mesh is built and evaluated once; then the system's record of the largest
resident memory of the process starts anew from the present size (Linux: 5 written to ``/proc/self/clear_refs``), the
panel's default bake runs once (``bpy.ops.radiosity.bake()``: preview, floats at face corners), and the record is read
again (``VmHWM`` in ``/proc/self/status``). The difference is what the bake took above Blender: everything is counted,
also the attribute that it leaves in the mesh (16 bytes a corner), the normals and triangles that Blender makes and
keeps when asked for them, and what does not grow with the mesh, about 8 MB of it for each thread. Linux only.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

import bpy

from . import scenes

#: Scenes of one receiving mesh.
SCENES = {"cornell_box": scenes.cornell_box, "furnished_room": scenes.furnished_room, "two_rooms": scenes.two_rooms}

#: Bytes of a stored color: four floats.
COLOR_BYTES = 16


def resident_memory(name: str) -> int:
    """Bytes of this process: ``VmRSS`` now, ``VmHWM`` at most since `start_peak_anew`."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return 1024 * int(next(line for line in lines if line.startswith(f"{name}:")).split()[1])


def start_peak_anew() -> None:
    """Let the record of the largest resident memory start from the present size."""
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def measure(scene: str, vertices: int, threads: int, shading: str) -> dict:
    """Memory and seconds of the first bake in this process."""
    obj = SCENES[scene](vertices)
    if shading == "flat":
        obj.data.shade_flat()
    bpy.context.evaluated_depsgraph_get().update()
    start_peak_anew()
    before = resident_memory("VmRSS")
    start = time.perf_counter()
    bpy.ops.radiosity.bake(threads=threads)
    seconds = time.perf_counter() - start
    above = resident_memory("VmHWM") - before
    count = len(obj.data.vertices)
    return {
        "vertices": count,
        "seconds": round(seconds, 2),
        "MB_before": round(before / 1e6, 1),
        "MB_above": round(above / 1e6, 1),
        "bytes_per_vertex": round(above / count, 1),
        "of_that_attribute": round(COLOR_BYTES * len(obj.data.attributes.active_color.data) / count, 1),
    }


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.memory", description=__doc__.splitlines()[0])
    parser.add_argument("--vertices", default="20000,500000", help="sizes, 20000,500000,...")
    parser.add_argument("--scene", choices=SCENES, default="cornell_box")
    parser.add_argument("--threads", type=int, default=0, help="0 takes all cores")
    parser.add_argument("--shading", choices=("smooth", "flat"), default="smooth")
    parser.add_argument("--here", action="store_true", help=argparse.SUPPRESS)  # one size, in this process
    return parser


def main() -> None:
    options = _parser().parse_args()
    if not sys.platform.startswith("linux"):
        sys.exit("Only Linux can start the record of the largest memory anew")
    if options.here:
        import radiosity

        radiosity.register()
        try:
            print(json.dumps(measure(options.scene, int(options.vertices), options.threads, options.shading)))
        finally:
            # With the bpy module, classes that are still registered hang or crash Python's own exit.
            radiosity.unregister()
        return
    for size in options.vertices.split(","):
        command = [sys.executable, "-m", "benchmarks.memory", "--here", "--vertices", size, "--scene", options.scene]
        command += ["--threads", str(options.threads), "--shading", options.shading]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            sys.exit(f"The measurement at {size} vertices failed:\n{done.stderr}")
        # Blender talks on standard output too; the measurement is the line of JSON.
        print(next(line for line in done.stdout.splitlines() if line.startswith("{")), flush=True)


if __name__ == "__main__":
    main()
