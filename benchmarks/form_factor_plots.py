"""A picture for each scene of the comparison of form factors: largest error against CPU time, both in powers of ten;
and one of error against resolution, technique by technique.

Left all methods with all visibilities, each a line from coarse to fine; right the options of the methods. Color tells
the method, the mark the visibility. The gray stairs are the least error that anything reaches within a time. Where
something occludes, what ignores occlusion (``none``) is not drawn.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

try:
    import matplotlib
except ModuleNotFoundError:  # no dependency of the project: the tables are complete without it
    matplotlib = None

#: Colors of Okabe and Ito, which the color-blind can tell apart.
COLORS = {
    "hemisphere": "#0072B2",
    "hemicube": "#E69F00",
    "single_plane": "#B8A800",
    "point_to_polygon": "#000000",
    "point_to_point": "#CC79A7",
    "disk": "#56B4E9",
    "hybrid": "#009E73",
    "contour_integral": "#D55E00",
}
MARKS = {"embree": "o", "zbuffer": "s", "bsp": "D", "brute_force": "^", "silhouettes": "v", "none": "x"}
DASHES = ("--", ":", "-.")

#: Errors below it are drawn here.
LEAST_ERROR = 1e-16


def draw_slopes(path: Path, lines: list[dict]) -> None:
    """Draw the error of each technique against its resolution, with the slope, or say how to get what draws it."""
    if not can_draw(path) or not lines:
        return
    from matplotlib import pyplot

    figure, panel = pyplot.subplots(figsize=(9.5, 5), layout="constrained")
    drawn = []
    for technique in dict.fromkeys(line["technique"] for line in lines):
        runs = [line for line in lines if line["technique"] == technique]
        panel.plot(
            [run["resolution"] for run in runs],
            [run["rms_error"] for run in runs],
            color=COLORS[runs[0]["method"]],
            marker="o",
            markersize=5,
            linestyle=("-", *DASHES)[drawn.count(runs[0]["method"])],
            label=f"{technique}: {runs[0]['slope']:.2f} by {runs[0]['unit']}",
        )
        drawn.append(runs[0]["method"])
    panel.set(xscale="log", yscale="log", xlabel="resolution", ylabel="RMS error of a factor")
    panel.grid(color="0.9")
    title = "power by which the error falls"
    panel.legend(fontsize=7.5, frameon=False, title=title, title_fontsize=8, loc="center left", bbox_to_anchor=(1, 0.5))
    figure.savefig(path, dpi=100)
    pyplot.close(figure)


def can_draw(path: Path) -> bool:
    """Whether there is what draws a picture; says how to get it where not."""
    if matplotlib is None:
        print(f"{path.name} is not drawn: python -m pip install matplotlib")
        return False
    matplotlib.use("Agg")
    return True


def draw(path: Path, lines: list[dict]) -> None:
    """Draw the runs of one scene, or say how to get what draws them."""
    if not can_draw(path):
        return
    from matplotlib import pyplot

    hidden = ("none",) if any(line["occluded"] for line in lines) else ()
    runs = [line for line in lines if line["status"] == "done" and line["visibility"] not in hidden]
    if not runs:
        return
    figure, panels = pyplot.subplots(1, 2, figsize=(11, 6.4), sharex=True, sharey=True, layout="constrained")
    for panel, title, with_options in zip(panels, ("methods and visibilities", "options"), (False, True), strict=True):
        _draw_panel(panel, runs, with_options)
        panel.set(title=title, xscale="log", yscale="log", xlabel="CPU seconds")
        panel.grid(color="0.9")
        panel.axhspan(LEAST_ERROR / 10, runs[0]["reference_error"], color="0.93", zorder=0)
        panel.legend(fontsize=7.5, ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.12), frameon=False)
    panels[0].set_ylabel("largest error of a factor")
    largest = max(run["max_error"] for run in runs)
    panels[0].set_ylim(_drawn([runs[0]["reference_error"], *(run["max_error"] for run in runs)]).min() / 2, 2 * largest)
    title = f"{runs[0]['scene']}, {runs[0]['patches']} patches"
    figure.suptitle(f"{title}; gray stairs: the best of all; gray band: less than the reference's own error")
    figure.savefig(path, dpi=100)
    pyplot.close(figure)


def _drawn(errors) -> np.ndarray:
    return np.maximum(np.array(errors, dtype=float), LEAST_ERROR)


def _draw_panel(panel, runs: list[dict], with_options: bool) -> None:
    """Stairs of what all runs reach, and a line for each series that has options, or has none."""
    order = sorted(runs, key=lambda run: run["cpu_seconds"])
    times, errors = [run["cpu_seconds"] for run in order], _drawn([run["max_error"] for run in order])
    panel.step(times, np.minimum.accumulate(errors), where="post", color="0.7", linewidth=5, zorder=1)
    drawn = []
    for key in dict.fromkeys((run["method"], run["visibility"], run["label"]) for run in runs):
        method, visibility, label = key
        if bool(label) != with_options:
            continue
        chosen = [run for run in runs if (run["method"], run["visibility"], run["label"]) == key]
        panel.plot(
            [run["cpu_seconds"] for run in chosen],
            _drawn([run["max_error"] for run in chosen]),
            color=COLORS[method],
            marker=MARKS[visibility],
            markersize=5,
            linewidth=1.4,
            linestyle=DASHES[drawn.count(method) % len(DASHES)] if with_options else "-",
            label=f"{method} {label or visibility}",
        )
        drawn.append(method)
