"""One light group of a scene and how it takes part in the mix."""

from bpy.props import BoolProperty, FloatProperty, FloatVectorProperty, StringProperty
from bpy.types import PropertyGroup

from ..adapters.group_mix import mix_changed


def _update(self, _context):
    mix_changed(self.id_data)


class RadiosityLightGroup(PropertyGroup):
    """What one light group adds to the light that is shown; a change is written to the meshes at once."""

    name: StringProperty(name="Name", description="Light or collection whose light this is", default="", options=set())
    attribute: StringProperty(
        name="Attribute", description="Color attribute that keeps its light", default="", options=set()
    )
    use_group: BoolProperty(
        name="Use Group", description="Let this light take part", default=True, options=set(), update=_update
    )
    color: FloatVectorProperty(
        name="Color",
        description="Multiply this light by a color",
        default=(1.0, 1.0, 1.0),
        size=3,
        min=0.0,
        soft_max=1.0,
        subtype='COLOR',
        options=set(),
        update=_update,
    )
    change: FloatVectorProperty(
        name="Change",
        description="By what this light has changed in the scene since the bake, as the last update has found",
        default=(1.0, 1.0, 1.0),
        size=3,
        min=0.0,
        options=set(),
    )
    strength: FloatProperty(
        name="Strength",
        description="Multiply this light by a number: 1 is as it was baked",
        default=1.0,
        min=0.0,
        soft_max=10.0,
        options=set(),
        update=_update,
    )
