"""Settings of a scene, `Scene.radiosity`: what the panel shows and what a bake uses unless told otherwise."""

from bpy.props import BoolProperty, CollectionProperty, FloatProperty, IntProperty
from bpy.types import PropertyGroup

from ...core.settings import ACCURACY_RANGE
from . import bake
from .light_group import RadiosityLightGroup

_FIXED = {'options': set()}  # settings of a bake are not animated


class RadiositySceneSettings(PropertyGroup):
    """All settings that are kept with a scene."""

    quality: bake.quality(**_FIXED)
    accuracy: bake.accuracy(min=ACCURACY_RANGE[0], max=ACCURACY_RANGE[1], **_FIXED)
    method: bake.method(**_FIXED)
    solver: bake.solver(**_FIXED)
    bake_type: bake.bake_type(**_FIXED)
    attribute_name: bake.attribute_name(**_FIXED)
    domain: bake.domain(**_FIXED)
    data_type: bake.data_type(**_FIXED)
    seed: bake.seed(min=0, **_FIXED)
    threads: bake.threads(min=0, **_FIXED)
    time_limit: bake.time_limit(min=0.0, **_FIXED)
    use_world_strength: BoolProperty(
        name="Override World Strength",
        description="Bake with another strength of the world's light than the world itself has",
        default=False,
        options=set(),
    )
    world_strength: bake.world_strength(min=0.0, **_FIXED)
    make_single_user: bake.make_single_user(**_FIXED)
    show_in_viewport: bake.show_in_viewport(**_FIXED)
    light_groups: bake.light_groups(**_FIXED)
    groups: CollectionProperty(
        name="Groups",
        description="Light groups of the last bake and how they are mixed",
        type=RadiosityLightGroup,
        options=set(),
    )
    subdivide_length: FloatProperty(
        name="Maximum Edge",
        description="Divide faces until none of their edges is longer than this; 0 proposes a length that suits them",
        default=0.0,
        min=0.0,
        soft_max=10.0,
        subtype='DISTANCE',
        unit='LENGTH',
        options=set(),
    )
    subdivide_limit: IntProperty(
        name="Vertex Limit",
        description="Refuse to divide when the selected meshes would get more vertices than this in all",
        default=1_000_000,
        min=1,
        soft_min=1000,
        soft_max=10_000_000,
        options=set(),
    )
