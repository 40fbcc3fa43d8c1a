"""`radiosity.verify`: how wrong the last bake is, measured."""

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from ..addon.adapters.report import read_report
from ..addon.adapters.verify_job import verify_job_steps
from ..addon.properties.progress import state
from ..core.verification.verification import PLACES
from .long_work import LongWork


class RADIOSITY_OT_verify(LongWork, bpy.types.Operator):
    """Measure the error of the last bake: follow light to some hundred of its vertices without short-cuts"""

    bl_idname = "radiosity.verify"
    bl_label = "Measure Error"
    bl_options = {'REGISTER'}

    places: bpy.props.IntProperty(
        name="Places",
        description="Vertices whose light is compared; four times as many halve the width of the interval",
        default=PLACES,
        min=16,
        max=100_000,
        options={'SKIP_SAVE'},
    )
    seed: bpy.props.IntProperty(
        name="Seed", description="Other numbers choose other vertices", default=0, min=0, options={'SKIP_SAVE'}
    )

    stopped_text = "Measuring stopped: nothing was changed"

    @classmethod
    def poll(cls, context):
        if state.is_running:
            cls.poll_message_set("A bake is running: press Esc to stop it")
        elif context.mode != 'OBJECT':
            cls.poll_message_set("Switch to Object Mode to measure")
        elif read_report(context.scene) is None:
            cls.poll_message_set("Bake first: there is nothing to measure")
        else:
            return True
        return False

    def steps(self, context):
        return verify_job_steps(context, self.places, self.seed)

    def tell(self, report):
        self.report(
            {'INFO'},
            rpt_("Measured error {:.2f} %, 95 % interval {:.2f} to {:.2f} %, at {:,d} vertices").format(
                100 * report["measured_error"],
                100 * report["measured_error_low"],
                100 * report["measured_error_high"],
                report["measured_places"],
            ),
        )
