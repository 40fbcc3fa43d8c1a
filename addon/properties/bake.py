"""What a bake can be told: each property defined once, for the scene's settings and for the operator's arguments.

The operator's arguments have no default of their own: one that was not given takes the scene's value. Identifiers and
numbers of enum items stay as they are, since files and scripts hold them.
"""

from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from ...core.settings import ACCURACY_RANGE, BAKE_TYPES, METHODS, QUALITY_ACCURACY, SOLVERS

DEFAULT_ATTRIBUTE = "Radiosity"

_QUALITY_TEXTS = {
    "draft": ("Draft", "For a first look"),
    "preview": ("Preview", "For work in progress"),
    "final": ("Final", "For the finished picture"),
}
QUALITY_ITEMS = [
    (name.upper(), *_QUALITY_TEXTS[name][:1], f"{_QUALITY_TEXTS[name][1]}: {accuracy:.0%} error", number)
    for number, (name, accuracy) in enumerate(QUALITY_ACCURACY.items())
]
QUALITY_ITEMS.append(('CUSTOM', "Custom", "Ask for an error of your own", 9))

_BAKE_TYPE_TEXTS = {
    "combined": ("Combined", "What the surface looks like: emitted and reflected light, with the material's color"),
    "lighting": ("Lighting", "Light that arrives, direct and indirect, without the material's color"),
    "direct": ("Direct", "Light that arrives straight from lamps, emitting faces and the world"),
    "indirect": ("Indirect", "Light that arrives after at least one bounce"),
    "emission": ("Emission", "Light that the surface itself emits"),
}
BAKE_TYPE_ITEMS = [(name.upper(), *_BAKE_TYPE_TEXTS[name], number) for number, name in enumerate(BAKE_TYPES)]

DOMAIN_ITEMS = [
    ('CORNER', "Face Corner", "Keep sharp edges, flat faces and material borders apart", 0),
    ('POINT', "Vertex", "Store one color per vertex, the mean of its corners", 1),
]
DATA_TYPE_ITEMS = [
    ('FLOAT_COLOR', "Color", "Store 32-bit numbers, which keep light brighter than white", 0),
    ('BYTE_COLOR', "Byte Color", "Store 8-bit numbers, a quarter of the size, cut off at white", 1),
]


_METHOD_TEXTS = {
    "auto": ("Automatic", "Rays to patches that are kept: the fastest and the most accurate, for scenes of any size"),
    "hemisphere": ("Ray-Cast Hemisphere", "Rays of equal contribution (Nusselt): as fast, on fewer patches"),
    "hemicube": ("Hemicube", "Five item buffers on each patch (Cohen and Greenberg 1985): no ray engine, seconds"),
    "single_plane": ("Single Plane", "One item buffer above each patch (Sillion and Puech 1989): loses light at the "
                     "horizon"),
    "point_to_polygon": ("Point to Polygon", "Closed form from many points, rays for what is hidden: slow, smooth"),
    "point_to_point": ("Point to Point", "From vertices, shadows by silhouettes (Nishita and Nakamae 1985): slow"),
    "disk": ("Ray-Traced Disks", "Pieces of patches as disks seen from vertices (Wallace 1989): slow"),
    "hybrid": ("Hybrid", "Contour integral where near or bright, visible pieces elsewhere (Baum 1989): slowest"),
    "contour_integral": ("Contour Integral", "Exact by Stokes' theorem (Goral 1984); has no shadows of its own, which "
                         "rays add"),
}  # fmt: skip
_SOLVER_TEXTS = {
    "auto": ("Automatic", "Choose the solver that suits the scene: no matrix, unless a method asks for one"),
    "direct": ("Direct", "Elimination: exact, in a time that grows with the cube of the patches"),
    "jacobi": ("Jacobi", "All patches gather at once: a product with the matrix per bounce, many in bright rooms"),
    "gauss_seidel": ("Gauss-Seidel", "Patches gather one after the other: half the bounces of Jacobi, each slower"),
    "gmres": ("GMRES", "The best mix of all bounces so far: the fewest products, for many patches and bright rooms"),
    "progressive_refinement": ("Progressive Refinement", "The brightest patches shoot first (Cohen 1988): quick to a "
                               "first look, slowest to the end"),
}  # fmt: skip


def _name_items(names, texts):
    return [
        (name.upper(), *texts.get(name, (name.replace("_", " ").title(), "")), number)
        for number, name in enumerate(names)
    ]


def quality(**more):
    return EnumProperty(
        name="Quality",
        description="Set how close the light comes to the exact one",
        items=QUALITY_ITEMS,
        default='PREVIEW',
        **more,
    )


def accuracy(**more):
    """Limits are left to the caller: the panel clamps, an argument out of range is an error."""
    return FloatProperty(
        name="Accuracy",
        description="Error of the light to aim for, as a share of its mean: 0.03 is 3 %",
        default=QUALITY_ACCURACY["preview"],
        soft_min=ACCURACY_RANGE[0],
        soft_max=ACCURACY_RANGE[1],
        step=1,
        precision=3,
        **more,
    )


def method(**more):
    return EnumProperty(
        name="Method",
        description="Choose how the exchange of light between surfaces is found: by form factors of this method, on "
        "fewer patches than Automatic has",
        items=_name_items(METHODS, _METHOD_TEXTS),
        default='AUTO',
        **more,
    )


def solver(**more):
    return EnumProperty(
        name="Solver",
        description="Choose how the bounces of light are summed: by a full matrix, on fewer patches than Automatic has",
        items=_name_items(SOLVERS, _SOLVER_TEXTS),
        default='AUTO',
        **more,
    )


def bake_type(**more):
    return EnumProperty(
        name="Bake Type",
        description="Choose which part of the light is stored",
        items=BAKE_TYPE_ITEMS,
        default='COMBINED',
        **more,
    )


def attribute_name(**more):
    return StringProperty(
        name="Attribute",
        description="Name the color attribute that takes the light; it is made where there is none",
        default=DEFAULT_ATTRIBUTE,
        **more,
    )


def domain(**more):
    return EnumProperty(
        name="Domain",
        description="Choose where on the mesh colors are stored",
        items=DOMAIN_ITEMS,
        default='CORNER',
        **more,
    )


def data_type(**more):
    return EnumProperty(
        name="Data Type",
        description="Choose the kind of number that stores the colors",
        items=DATA_TYPE_ITEMS,
        default='FLOAT_COLOR',
        **more,
    )


def seed(**more):
    return IntProperty(
        name="Seed",
        description="Vary the pattern of random numbers; the same seed gives the same result",
        default=0,
        **more,
    )


def threads(**more):
    return IntProperty(
        name="Threads",
        description="Set how many processor cores to use, 0 for all; the result is the same",
        default=0,
        soft_max=64,
        **more,
    )


def time_limit(**more):
    return FloatProperty(
        name="Time Limit",
        description="Refine no further after this many seconds, 0 for no limit",
        default=0.0,
        soft_max=3600.0,
        subtype='TIME_ABSOLUTE',
        unit='TIME_ABSOLUTE',
        **more,
    )


def world_strength(**more):
    return FloatProperty(
        name="World Strength",
        description="Set the strength of the world's light, white where the world is black",
        default=1.0,
        soft_max=10.0,
        **more,
    )


def make_single_user(**more):
    return BoolProperty(
        name="Make Single User",
        description="Give each object that shares its mesh with others a mesh of its own",
        default=False,
        **more,
    )


def show_in_viewport(**more):
    return BoolProperty(
        name="Show in Viewport",
        description="Switch the 3D viewports of this screen to flat solid shading with the baked colors",
        default=True,
        **more,
    )
