"""Sub-panel: the report of the last bake in figures an artist can read."""

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..adapters.report import messages, read_report
from ..properties.progress import duration, state
from .sidebar import RadiositySubPanel


class VIEW3D_PT_radiosity_statistics(RadiositySubPanel, bpy.types.Panel):
    bl_label = "Statistics"

    @classmethod
    def poll(cls, context):
        return read_report(context.scene) is not None

    def draw(self, context):
        layout = self.layout
        report = read_report(context.scene)
        if report is None:
            return
        column = layout.column(align=True)
        for label, value in _rows(report):
            split = column.split(factor=0.55)
            split.label(text=label)
            split.label(text=value, translate=False)
        row = layout.row()
        row.enabled = not state.is_running
        row.operator("radiosity.verify", icon='VIEWZOOM')
        warnings = messages(report)
        if warnings:
            column = layout.column(align=True)
            column.label(text=iface_("Warnings: {:d}").format(len(warnings)), icon='ERROR', translate=False)
            width = max(int(context.region.width / context.preferences.system.ui_scale / 7) - 2, 20)
            for warning in warnings[:_SHOWN_WARNINGS]:
                for line in wrapped(warning, width):
                    column.label(text=line, translate=False)


#: More would push everything else out of the sidebar; the report holds them all.
_SHOWN_WARNINGS = 8


def _rows(report):
    """Label and value of each figure that the report knows."""
    scene = report["scene"]
    numbers = (
        ("Objects", scene.get("objects"), _count),
        ("Faces", scene.get("faces"), _count),
        ("Receivers", scene.get("receivers"), _count),
        ("Patches", scene.get("patches"), _count),
        ("Lights", scene.get("lights"), _count),
        ("Rays", report["rays"], _count),
        ("Time", report["seconds"].get("total"), _seconds),
        ("Memory", report["peak_memory_above_start"], _bytes),
        ("Estimated Error", report["estimated_error"], _percent),
        ("Measured Error", _interval(report), str),
        ("Light Absorbed", report["light_absorbed"], _percent),
        ("Energy Error", report["energy_balance_error"], _percent),
        ("Iterations", report["iterations"], _count),
        ("Converged", report["converged"], lambda value: iface_("Yes") if value else iface_("No")),
    )
    return [(label, text(value)) for label, value, text in numbers if value is not None]


def _interval(report):
    """The measured error and the ends of its interval, None where nothing was measured."""
    if report.get("measured_error") is None:
        return None
    error, low, high = (report[f"measured_error{end}"] for end in ("", "_low", "_high"))
    return f"{100 * error:.2g} % ({100 * low:.2g} to {100 * high:.2g})"


def _count(value):
    return f"{value:,d}" if isinstance(value, int) else str(value)


def _seconds(value):
    return f"{value:.1f} s" if value < 60 else duration(value)


def _percent(value):
    return f"{100 * value:.3g} %"


def _bytes(value):
    return f"{value / 1e6:,.0f} MB"


def wrapped(text, width):
    """Text in lines of at most `width` characters, cut between words; labels do not wrap by themselves."""
    lines = [""]
    for word in text.split():
        if lines[-1] and len(lines[-1]) + 1 + len(word) > width:
            lines.append("")
        lines[-1] += (" " if lines[-1] else "") + word
    return lines
