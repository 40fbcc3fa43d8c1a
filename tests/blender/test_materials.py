"""Materials as looks. Cycles judges: what a node tree sends into an Emission shader is baked, and equal per vertex."""

from math import pi

import bpy
import numpy as np
import pytest
from radiosity.addon.adapters.images import ImageLibrary, reduce_by_area, srgb_to_linear
from radiosity.addon.adapters.materials import MaterialLibrary
from radiosity.addon.adapters.node_arithmetic import ARITHMETIC
from radiosity.addon.adapters.node_colors import BLEND_MODES
from radiosity.addon.adapters.node_math import MATH, VECTOR_MATH
from radiosity.addon.adapters.scene_reader import read_scene

STEPS = 6


def new_material(name="Material"):
    """A material with an empty tree and its output."""
    material = bpy.data.materials.new(name)
    if material.node_tree is None:  # always there from Blender 5.0
        material.use_nodes = True
    material.node_tree.nodes.clear()
    return material, material.node_tree.nodes.new('ShaderNodeOutputMaterial')


def add_node(tree, kind, **values):
    node = tree.nodes.new(kind)
    for name, value in values.items():
        setattr(node, name, value)
    return node


def shade(kind, **inputs):
    """A material of one shader with values for its inputs."""
    material, output = new_material()
    node = add_node(material.node_tree, kind)
    for name, value in inputs.items():
        node.inputs[name.replace("_", " ")].default_value = value
    material.node_tree.links.new(node.outputs[0], output.inputs["Surface"])
    return material, node


def look_values(material):
    """Reflectance, radiance and transmittance of a material that does not vary."""
    look = MaterialLibrary(ImageLibrary()).look(material)
    reflectance, emission, transmittance = look.values
    return reflectance, emission / pi, transmittance


def add_sheet():
    """A grid of faces with UVs that leave the unit square and miss texel borders, two colors and a float attribute."""
    ticks = np.linspace(-0.53, 1.71, STEPS + 1)
    x, y = np.meshgrid(ticks, ticks * 0.9 + 0.037)
    corner = np.arange(STEPS)[:, None] * (STEPS + 1) + np.arange(STEPS)
    faces = np.stack([corner, corner + 1, corner + STEPS + 2, corner + STEPS + 1], axis=-1).reshape(-1, 4)
    mesh = bpy.data.meshes.new("Sheet")
    mesh.from_pydata(np.column_stack([x.ravel(), y.ravel(), x.ravel() * 0.1]).tolist(), [], faces.tolist())
    corners = np.empty(len(mesh.loops), dtype=np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    uv = np.column_stack([x.ravel(), y.ravel()])[corners].astype(np.float32)
    mesh.uv_layers.new(name="Other").uv.foreach_set("vector", (uv * 0.5 + 0.21).ravel())
    mesh.uv_layers.new(name="Main").uv.foreach_set("vector", uv.ravel())
    mesh.uv_layers["Main"].active_render = True
    random = np.random.default_rng(1)
    for name, kind, domain, count in (
        ("Float", 'FLOAT_COLOR', 'POINT', x.size),
        ("Byte", 'BYTE_COLOR', 'POINT', x.size),
    ):
        colors = mesh.color_attributes.new(name, kind, domain)
        # Away from zero, near which division would magnify what Cycles insets its corners by.
        colors.data.foreach_set("color", random.uniform(0.2, 1, 4 * count).astype(np.float32))
    mesh.attributes.new("Weight", 'FLOAT', 'POINT').data.foreach_set("value", random.random(x.size).astype(np.float32))
    mesh.color_attributes.new("Bake", 'FLOAT_COLOR', 'POINT')
    mesh.color_attributes.active_color = mesh.color_attributes["Bake"]
    mesh.color_attributes.render_color_index = [each.name for each in mesh.color_attributes].index("Byte")
    obj = bpy.data.objects.new("Sheet", mesh)
    obj.color = (0.3, 0.6, 0.9, 0.5)
    bpy.context.collection.objects.link(obj)
    bpy.context.view_layer.update()
    return obj


def emission_in_cycles(obj):
    """(vertices, 3) radiance, as Cycles bakes it."""
    scene = bpy.context.scene
    scene.render.engine = 'CYCLES'
    scene.cycles.samples = 1
    for each in bpy.context.view_layer.objects:
        each.select_set(each == obj)
    bpy.context.view_layer.objects.active = obj
    bpy.ops.object.bake(type='EMIT', target='VERTEX_COLORS')
    colors = np.empty(4 * len(obj.data.vertices), dtype=np.float32)
    obj.data.attributes["Bake"].data.foreach_get("color", colors)
    return colors.reshape(-1, 4)[:, :3]


def emission_here(obj):
    """(vertices, 3) radiance, as we read it, and the warnings."""
    reading = read_scene(bpy.context, receivers=[obj])
    (mesh,) = reading.scene.receivers
    emission = mesh.corner_emission
    if emission is None:
        emission = np.repeat(mesh.palette_emission[mesh.face_materials], np.diff(mesh.face_offsets), axis=0)
    result = np.zeros((len(mesh.positions), 3))
    result[mesh.corner_vertices] = emission / pi
    return result, reading.scene.warnings


def make_image(rows=8, columns=12, is_float=False, space='sRGB', alpha=None):
    random = np.random.default_rng(2)
    image = bpy.data.images.new("Picture", columns, rows, alpha=True, float_buffer=is_float)
    image.colorspace_settings.name = space
    pixels = random.random((rows, columns, 4)).astype(np.float32)
    pixels[..., 3] = 1 if alpha is None else alpha
    image.pixels.foreach_set(pixels.ravel())
    image.pack()
    return image


class Trees:
    """Node trees whose color Cycles and we must see alike; each method adds nodes and returns an output socket."""

    def color_attribute(self, tree):
        return add_node(tree, 'ShaderNodeVertexColor', layer_name="Float").outputs["Color"]

    def byte_color_attribute(self, tree):
        return add_node(tree, 'ShaderNodeVertexColor', layer_name="Byte").outputs["Color"]

    def render_color_attribute(self, tree):
        return add_node(tree, 'ShaderNodeVertexColor').outputs["Color"]

    def alpha_of_color_attribute(self, tree):
        return add_node(tree, 'ShaderNodeVertexColor', layer_name="Float").outputs["Alpha"]

    def missing_attribute(self, tree):
        return add_node(tree, 'ShaderNodeVertexColor', layer_name="Nothing").outputs["Color"]

    def attribute(self, tree):
        return add_node(tree, 'ShaderNodeAttribute', attribute_name="Float").outputs["Color"]

    def factor_of_attribute(self, tree):
        return add_node(tree, 'ShaderNodeAttribute', attribute_name="Weight").outputs["Fac"]

    def uv_as_color(self, tree):
        return add_node(tree, 'ShaderNodeTexCoord').outputs["UV"]

    def other_uv_as_color(self, tree):
        return add_node(tree, 'ShaderNodeUVMap', uv_map="Other").outputs["UV"]

    def generated(self, tree):
        return add_node(tree, 'ShaderNodeTexCoord').outputs["Generated"]

    def object_color(self, tree):
        return add_node(tree, 'ShaderNodeObjectInfo').outputs["Color"]

    def color_to_value(self, tree):
        node = add_node(tree, 'ShaderNodeMath', operation='MULTIPLY_ADD')
        tree.links.new(self.color_attribute(tree), node.inputs[0])
        tree.links.new(self.uv_as_color(tree), node.inputs[2])
        return node.outputs[0]

    def checker(self, tree):
        node = add_node(tree, 'ShaderNodeTexChecker')
        node.inputs["Scale"].default_value = 3.7
        return node.outputs["Color"]

    def gradient(self, tree):
        node = add_node(tree, 'ShaderNodeTexGradient', gradient_type='EASING')
        return node.outputs["Color"]

    def color_ramp(self, tree):
        node = add_node(tree, 'ShaderNodeValToRGB')
        node.color_ramp.elements[0].color = (0.1, 0.5, 0.2, 1)
        node.color_ramp.elements.new(0.4).color = (0.9, 0.2, 0.3, 1)
        tree.links.new(self.factor_of_attribute(tree), node.inputs["Fac"])
        return node.outputs["Color"]

    def rgb_curves(self, tree):
        node = add_node(tree, 'ShaderNodeRGBCurve')
        node.mapping.curves[3].points.new(0.4, 0.8)
        node.mapping.curves[0].points.new(0.6, 0.3)
        node.inputs["Fac"].default_value = 0.7
        tree.links.new(self.color_attribute(tree), node.inputs["Color"])
        return node.outputs["Color"]

    def hue_saturation(self, tree):
        node = add_node(tree, 'ShaderNodeHueSaturation')
        for name, value in {"Hue": 0.7, "Saturation": 1.3, "Value": 0.8, "Fac": 0.6}.items():
            node.inputs[name].default_value = value
        tree.links.new(self.color_attribute(tree), node.inputs["Color"])
        return node.outputs["Color"]

    def contrast_gamma_invert(self, tree):
        contrast = add_node(tree, 'ShaderNodeBrightContrast')
        contrast.inputs["Bright"].default_value = 0.1
        contrast.inputs["Contrast"].default_value = 0.4
        gamma = add_node(tree, 'ShaderNodeGamma')
        gamma.inputs["Gamma"].default_value = 1.8
        invert = add_node(tree, 'ShaderNodeInvert')
        invert.inputs[0].default_value = 0.3
        tree.links.new(self.color_attribute(tree), contrast.inputs["Color"])
        tree.links.new(contrast.outputs["Color"], gamma.inputs["Color"])
        tree.links.new(gamma.outputs["Color"], invert.inputs["Color"])
        return invert.outputs["Color"]

    def separate_and_combine(self, tree):
        apart = add_node(tree, 'ShaderNodeSeparateColor', mode='HSV')
        whole = add_node(tree, 'ShaderNodeCombineColor', mode='HSL')
        tree.links.new(self.color_attribute(tree), apart.inputs[0])
        for i, j in enumerate((2, 0, 1)):
            tree.links.new(apart.outputs[i], whole.inputs[j])
        return whole.outputs[0]

    def luminance(self, tree):
        node = add_node(tree, 'ShaderNodeRGBToBW')
        tree.links.new(self.color_attribute(tree), node.inputs[0])
        return node.outputs[0]

    def map_range(self, tree):
        node = add_node(tree, 'ShaderNodeMapRange', interpolation_type='SMOOTHSTEP')
        node.inputs["To Max"].default_value = 2.5
        tree.links.new(self.factor_of_attribute(tree), node.inputs["Value"])
        return node.outputs[0]

    def mix_of_floats(self, tree):
        node = add_node(tree, 'ShaderNodeMix', data_type='FLOAT')
        node.inputs["A"].default_value = 0.2
        node.inputs["B"].default_value = 3.0
        tree.links.new(self.factor_of_attribute(tree), node.inputs["Factor"])
        return node.outputs["Result"]

    def muted(self, tree):
        node = add_node(tree, 'ShaderNodeInvert')
        tree.links.new(self.color_attribute(tree), node.inputs["Color"])
        node.mute = True
        return node.outputs["Color"]

    def reroute(self, tree):
        first, second = add_node(tree, 'NodeReroute'), add_node(tree, 'NodeReroute')
        tree.links.new(self.color_attribute(tree), first.inputs[0])
        tree.links.new(first.outputs[0], second.inputs[0])
        return second.outputs[0]

    def nested_groups(self, tree):
        inner = bpy.data.node_groups.new("Inner", 'ShaderNodeTree')
        inner.interface.new_socket("Value", in_out='INPUT', socket_type='NodeSocketColor')
        inner.interface.new_socket("Tint", in_out='INPUT', socket_type='NodeSocketColor').default_value = (
            1,
            0.5,
            0.2,
            1,
        )
        inner.interface.new_socket("Color", in_out='OUTPUT', socket_type='NodeSocketColor')
        start, end = add_node(inner, 'NodeGroupInput'), add_node(inner, 'NodeGroupOutput')
        mix = add_node(inner, 'ShaderNodeMixRGB', blend_type='MULTIPLY')
        mix.inputs["Fac"].default_value = 1
        inner.links.new(start.outputs["Value"], mix.inputs["Color1"])
        inner.links.new(start.outputs["Tint"], mix.inputs["Color2"])
        inner.links.new(mix.outputs[0], end.inputs["Color"])
        outer = bpy.data.node_groups.new("Outer", 'ShaderNodeTree')
        outer.interface.new_socket("Color", in_out='INPUT', socket_type='NodeSocketColor')
        outer.interface.new_socket("Color", in_out='OUTPUT', socket_type='NodeSocketColor')
        start, end = add_node(outer, 'NodeGroupInput'), add_node(outer, 'NodeGroupOutput')
        use = add_node(outer, 'ShaderNodeGroup', node_tree=inner)
        outer.links.new(start.outputs["Color"], use.inputs["Value"])
        outer.links.new(use.outputs["Color"], end.inputs["Color"])
        node = add_node(tree, 'ShaderNodeGroup', node_tree=outer)
        tree.links.new(self.color_attribute(tree), node.inputs["Color"])
        return node.outputs["Color"]

    def group_that_turns_a_color_into_a_value(self, tree):
        inner = bpy.data.node_groups.new("Border", 'ShaderNodeTree')
        inner.interface.new_socket("Value", in_out='INPUT', socket_type='NodeSocketFloat')
        inner.interface.new_socket("Color", in_out='OUTPUT', socket_type='NodeSocketColor')
        start, end = add_node(inner, 'NodeGroupInput'), add_node(inner, 'NodeGroupOutput')
        inner.links.new(start.outputs["Value"], end.inputs["Color"])
        node = add_node(tree, 'ShaderNodeGroup', node_tree=inner)
        tree.links.new(self.color_attribute(tree), node.inputs["Value"])
        return node.outputs["Color"]

    def group_whose_open_value_becomes_a_color(self, tree):
        socket = self.group_that_turns_a_color_into_a_value(tree)
        socket.node.inputs["Value"].default_value = 0.6
        tree.links.remove(socket.node.inputs["Value"].links[0])
        return socket

    def image(self, tree, **values):
        return add_node(tree, 'ShaderNodeTexImage', image=make_image(), **values).outputs["Color"]

    def clipped_image(self, tree):
        return self.image(tree, extension='CLIP')

    def extended_image(self, tree):
        return self.image(tree, extension='EXTEND')

    def mirrored_image(self, tree):
        return self.image(tree, extension='MIRROR')

    def closest_image(self, tree):
        return self.image(tree, interpolation='Closest')

    def data_image(self, tree):
        return add_node(tree, 'ShaderNodeTexImage', image=make_image(space='Non-Color')).outputs["Color"]

    def float_image(self, tree):
        image = make_image(is_float=True, space='Linear Rec.709')
        return add_node(tree, 'ShaderNodeTexImage', image=image).outputs["Color"]

    def image_with_alpha(self, tree):
        return add_node(tree, 'ShaderNodeTexImage', image=make_image(alpha=0.4)).outputs["Color"]

    def image_whose_alpha_is_used(self, tree):
        node = add_node(tree, 'ShaderNodeTexImage', image=make_image(alpha=0.4))
        mix = add_node(tree, 'ShaderNodeMixRGB')
        tree.links.new(node.outputs["Alpha"], mix.inputs["Fac"])
        tree.links.new(node.outputs["Color"], mix.inputs["Color2"])
        return mix.outputs[0]

    def image_by_other_uv(self, tree):
        node = add_node(tree, 'ShaderNodeTexImage', image=make_image())
        tree.links.new(self.other_uv_as_color(tree), node.inputs["Vector"])
        return node.outputs["Color"]

    def mapping(self, tree, vector_type='POINT'):
        node = add_node(tree, 'ShaderNodeMapping', vector_type=vector_type)
        if vector_type in ('POINT', 'TEXTURE'):
            node.inputs["Location"].default_value = (0.3, -0.2, 0.4)
        node.inputs["Rotation"].default_value = (0.3, 0.5, 0.7)
        node.inputs["Scale"].default_value = (1.5, 0.7, 2.0)
        tree.links.new(self.color_attribute(tree), node.inputs["Vector"])
        return node.outputs["Vector"]

    def texture_mapping(self, tree):
        return self.mapping(tree, 'TEXTURE')

    def vector_mapping(self, tree):
        return self.mapping(tree, 'VECTOR')

    def normal_mapping(self, tree):
        return self.mapping(tree, 'NORMAL')


TREES = [name for name in vars(Trees) if not name.startswith("_")]


def emitting_sheet(build):
    """A sheet that emits what `build(tree)` gives."""
    obj = add_sheet()
    material, output = new_material()
    tree = material.node_tree
    emission = add_node(tree, 'ShaderNodeEmission')
    tree.links.new(build(tree), emission.inputs["Color"])
    tree.links.new(emission.outputs[0], output.inputs["Surface"])
    obj.data.materials.append(material)
    bpy.context.view_layer.update()
    return obj


def assert_as_in_cycles(obj, atol=2e-3):
    """Equal at every vertex; by default to what Cycles' tables of 256 entries and byte textures leave open."""
    ours, warnings = emission_here(obj)
    assert warnings == ()
    # Cycles bakes negative emission as black, as we read it.
    np.testing.assert_allclose(ours, np.maximum(emission_in_cycles(obj), 0), atol=atol)


@pytest.mark.parametrize("name", TREES)
def test_node_tree_reads_as_cycles_bakes_it(name):
    obj = emitting_sheet(getattr(Trees(), name))
    # Cycles rounds to bytes after multiplying by alpha: half a byte, over the alpha of 0.4, on a slope of up to 2.3.
    assert_as_in_cycles(obj, atol=0.5 / 255 / 0.4 * 2.3 if "image" in name else 2e-3)


@pytest.mark.parametrize("mode", BLEND_MODES)
def test_blend_mode_reads_as_cycles_bakes_it(mode):
    def build(tree):
        mix = add_node(tree, 'ShaderNodeMix', data_type='RGBA', blend_type=mode)
        colors = [socket for socket in mix.inputs if socket.type == 'RGBA']
        tree.links.new(Trees().color_attribute(tree), colors[0])
        tree.links.new(Trees().byte_color_attribute(tree), colors[1])
        tree.links.new(Trees().factor_of_attribute(tree), mix.inputs["Factor"])
        return next(socket for socket in mix.outputs if socket.type == 'RGBA')

    assert_as_in_cycles(emitting_sheet(build))


@pytest.mark.parametrize("operation", MATH)
def test_math_reads_as_cycles_bakes_it(operation):
    def build(tree):
        node = add_node(tree, 'ShaderNodeMath', operation=operation)
        separate = add_node(tree, 'ShaderNodeSeparateXYZ')
        tree.links.new(Trees().uv_as_color(tree), separate.inputs[0])
        tree.links.new(separate.outputs[0], node.inputs[0])
        if len(node.inputs) > 1:
            tree.links.new(separate.outputs[1], node.inputs[1])
        return node.outputs[0]

    obj = emitting_sheet(build)
    ours, _ = emission_here(obj)
    cycles = np.maximum(emission_in_cycles(obj), 0)
    np.testing.assert_allclose(ours, cycles, rtol=2e-3, atol=2e-3)


@pytest.mark.parametrize("operation", VECTOR_MATH)
def test_vector_math_reads_as_cycles_bakes_it(operation):
    def build(tree):
        node = add_node(tree, 'ShaderNodeVectorMath', operation=operation)
        tree.links.new(Trees().uv_as_color(tree), node.inputs[0])
        tree.links.new(Trees().color_attribute(tree), node.inputs[1])
        node.inputs[2].default_value = (-0.1, -0.2, -0.3)
        return next(socket for socket in node.outputs if socket.enabled)

    obj = emitting_sheet(build)
    ours, _ = emission_here(obj)
    cycles = np.maximum(emission_in_cycles(obj), 0)
    np.testing.assert_allclose(ours, cycles, rtol=2e-3, atol=2e-3)


COLOR = (0.7, 0.4, 0.2, 1.0)
RGB = np.array(COLOR[:3])
BLACK = np.zeros(3)


@pytest.mark.parametrize(
    ("kind", "inputs", "reflectance", "emission", "transmittance"),
    [
        ('BsdfDiffuse', dict(Color=COLOR), RGB, BLACK, 0),
        ('BsdfGlossy', dict(Color=COLOR), RGB, BLACK, 0),
        ('SubsurfaceScattering', dict(Color=COLOR), RGB, BLACK, 0),
        ('Emission', dict(Color=COLOR, Strength=3.0), BLACK, 3 * RGB, 0),
        ('BsdfTransparent', dict(Color=COLOR), BLACK, BLACK, RGB.mean()),
        ('BsdfTranslucent', dict(Color=COLOR), BLACK, BLACK, RGB.mean()),
        ('BsdfGlass', dict(Color=COLOR), BLACK, BLACK, RGB.mean()),
        ('Holdout', {}, BLACK, BLACK, 0),
        ('BsdfPrincipled', dict(Base_Color=COLOR), RGB, BLACK, 0),
        ('BsdfPrincipled', dict(Base_Color=COLOR, Metallic=1.0), RGB, BLACK, 0),
        ('BsdfPrincipled', dict(Base_Color=COLOR, Alpha=0.25), RGB / 4, BLACK, 0.75),
        ('BsdfPrincipled', dict(Base_Color=COLOR, Transmission_Weight=0.5), RGB / 2, BLACK, RGB.mean() / 2),
        ('BsdfPrincipled', dict(Base_Color=COLOR, Transmission_Weight=1.0, Metallic=1.0), RGB, BLACK, 0),
        (
            'BsdfPrincipled',
            dict(Base_Color=COLOR, Emission_Color=(1, 0.5, 0, 1), Emission_Strength=4.0, Alpha=0.5),
            RGB / 2,
            np.array([2, 1, 0]),
            0.5,
        ),
    ],
)
def test_shader_becomes_the_diffuse_one_of_equal_energy(kind, inputs, reflectance, emission, transmittance):
    material, _ = shade(f'ShaderNode{kind}', **inputs)
    found = look_values(material)
    np.testing.assert_allclose(found[0], reflectance, rtol=1e-6)
    np.testing.assert_allclose(found[1], emission, rtol=1e-6)
    assert found[2] == pytest.approx(transmittance, rel=1e-6)


@pytest.mark.parametrize("alpha", [0.0, 0.3])
def test_principled_emission_fades_with_alpha_as_in_cycles(alpha):
    obj = add_sheet()
    material, _ = shade('ShaderNodeBsdfPrincipled', Emission_Color=COLOR, Emission_Strength=2.0, Alpha=alpha)
    obj.data.materials.append(material)
    assert_as_in_cycles(obj)


def two_shaders(kind):
    """A material that combines Diffuse and Emission by a Mix or Add Shader."""
    material, output = new_material()
    tree = material.node_tree
    diffuse, emission, join = (
        add_node(tree, f'ShaderNode{each}') for each in ('BsdfDiffuse', 'Emission', f'{kind}Shader')
    )
    diffuse.inputs["Color"].default_value = COLOR
    emission.inputs["Strength"].default_value = 2.0
    shaders = [socket for socket in join.inputs if socket.type == 'SHADER']
    tree.links.new(diffuse.outputs[0], shaders[0])
    tree.links.new(emission.outputs[0], shaders[1])
    tree.links.new(join.outputs[0], output.inputs["Surface"])
    return material, join


def test_mix_and_add_shader_share_out_energy():
    material, join = two_shaders('Mix')
    join.inputs[0].default_value = 0.25
    reflectance, emission, _ = look_values(material)
    np.testing.assert_allclose(reflectance, 0.75 * RGB, rtol=1e-6)
    np.testing.assert_allclose(emission, (0.5, 0.5, 0.5), rtol=1e-6)
    reflectance, emission, _ = look_values(two_shaders('Add')[0])
    np.testing.assert_allclose(reflectance, RGB, rtol=1e-6)
    np.testing.assert_allclose(emission, (2, 2, 2), rtol=1e-6)


def test_emission_on_the_front_only_makes_a_one_sided_look():
    material, join = two_shaders('Mix')
    tree = material.node_tree
    geometry = add_node(tree, 'ShaderNodeNewGeometry')
    shaders = [socket for socket in join.inputs if socket.type == 'SHADER']
    diffuse, emission = (socket.links[0].from_node for socket in shaders)
    tree.links.new(geometry.outputs["Backfacing"], join.inputs[0])
    tree.links.new(emission.outputs[0], shaders[0])
    tree.links.new(diffuse.outputs[0], shaders[1])
    library = MaterialLibrary(ImageLibrary())
    look = library.look(material)
    assert not look.two_sided
    np.testing.assert_allclose(look.values[1], [2 * pi] * 3, rtol=1e-6)
    assert library.warnings() == []


def test_sides_that_differ_otherwise_are_named():
    material, join = two_shaders('Mix')
    tree = material.node_tree
    shaders = [socket for socket in join.inputs if socket.type == 'SHADER']
    transparent = add_node(tree, 'ShaderNodeBsdfTransparent')
    geometry = add_node(tree, 'ShaderNodeNewGeometry')
    tree.links.new(geometry.outputs["Backfacing"], join.inputs[0])
    tree.links.new(transparent.outputs[0], shaders[1])
    library = MaterialLibrary(ImageLibrary())
    assert library.look(material).values[2] == 0
    assert [material.name in text for text in library.warnings()] == [True]


def test_no_material_is_blenders_gray():
    np.testing.assert_allclose(look_values(None)[0], 0.8, rtol=1e-6)


def test_tree_without_output_is_black():
    material, output = new_material()
    material.node_tree.nodes.remove(output)
    assert not look_values(material)[0].any()


def test_volume_alone_lets_light_through():
    material, output = new_material()
    volume = add_node(material.node_tree, 'ShaderNodeVolumePrincipled')
    material.node_tree.links.new(volume.outputs[0], output.inputs["Volume"])
    assert look_values(material)[2] == 1


@pytest.mark.parametrize("targets", [('EEVEE', 'CYCLES'), ('CYCLES', 'EEVEE'), ('EEVEE', 'ALL'), ('EEVEE',)])
def test_output_of_cycles_counts_then_of_all_then_of_eevee(targets):
    material, output = new_material()
    tree = material.node_tree
    tree.nodes.remove(output)
    strengths = {'CYCLES': 1.0, 'ALL': 2.0, 'EEVEE': 3.0}
    for target in targets:
        output = add_node(tree, 'ShaderNodeOutputMaterial', target=target)
        emission = add_node(tree, 'ShaderNodeEmission')
        emission.inputs["Strength"].default_value = strengths[target]
        tree.links.new(emission.outputs[0], output.inputs["Surface"])
    assert look_values(material)[1][0] == pytest.approx(min(strengths[target] for target in targets), rel=1e-6)


def test_light_path_is_that_of_a_diffuse_bounce():
    material, join = two_shaders('Mix')
    path = add_node(material.node_tree, 'ShaderNodeLightPath')
    material.node_tree.links.new(path.outputs["Is Camera Ray"], join.inputs[0])
    reflectance, emission, _ = look_values(material)
    np.testing.assert_allclose(reflectance, RGB, rtol=1e-6)
    assert not emission.any()


def diffuse_reflectance(n):
    """Reflectance of a dielectric for diffuse light in closed form (Walsh 1926; Duntley, JOSA 32, 1942)."""
    return (
        0.5
        + (n - 1) * (3 * n + 1) / (6 * (n + 1) ** 2)
        + n**2 * (n**2 - 1) ** 2 / (n**2 + 1) ** 3 * np.log((n - 1) / (n + 1))
        - 2 * n**3 * (n**2 + 2 * n - 1) / ((n**2 + 1) * (n**4 - 1))
        + 8 * n**4 * (n**4 + 1) / ((n**2 + 1) * (n**4 - 1) ** 2) * np.log(n)
    )


@pytest.mark.parametrize("index", [1.2, 1.5, 2.5])
def test_fresnel_gives_its_mean_over_directions(index):
    material, join = two_shaders('Mix')
    fresnel = add_node(material.node_tree, 'ShaderNodeFresnel')
    fresnel.inputs["IOR"].default_value = index
    material.node_tree.links.new(fresnel.outputs[0], join.inputs[0])
    # 256 cosines leave 3e-4 of the steep end at grazing angles.
    assert look_values(material)[1][0] == pytest.approx(2 * diffuse_reflectance(index), abs=6e-4)


def test_nodes_that_cannot_be_read_fall_back_and_are_named_in_one_line():
    library = MaterialLibrary(ImageLibrary())
    for name in ("Marble", "Wood"):
        material, output = new_material(name)
        tree = material.node_tree
        diffuse, noise = add_node(tree, 'ShaderNodeBsdfDiffuse'), add_node(tree, 'ShaderNodeTexNoise')
        diffuse.inputs["Color"].default_value = COLOR
        tree.links.new(noise.outputs["Color"], diffuse.inputs["Color"])
        tree.links.new(diffuse.outputs[0], output.inputs["Surface"])
        np.testing.assert_allclose(library.look(material).values[0], RGB, rtol=1e-6)
    (text,) = library.warnings()
    assert "Marble (Noise Texture), Wood (Noise Texture)" in text


def test_missing_image_is_gray_and_named():
    obj = add_sheet()
    material, output = new_material()
    tree = material.node_tree
    image = bpy.data.images.new("Gone", 4, 4)
    image.source = 'FILE'
    image.filepath = "//nowhere/gone.png"
    node = add_node(tree, 'ShaderNodeTexImage', image=image)
    diffuse = add_node(tree, 'ShaderNodeBsdfDiffuse')
    tree.links.new(node.outputs["Color"], diffuse.inputs["Color"])
    tree.links.new(diffuse.outputs[0], output.inputs["Surface"])
    obj.data.materials.append(material)
    reading = read_scene(bpy.context, receivers=[obj])
    np.testing.assert_allclose(reading.scene.surfaces.reflectance[reading.scene.surfaces.palette_rows], 0.5, rtol=1e-6)
    assert [text for text in reading.scene.warnings if "Gone" in text and "issing" in text]


def test_cycle_of_nodes_ends():
    material, output = new_material()
    tree = material.node_tree
    first, second = (add_node(tree, 'ShaderNodeGamma') for _ in range(2))
    emission = add_node(tree, 'ShaderNodeEmission')
    tree.links.new(first.outputs[0], second.inputs[0])
    tree.links.new(second.outputs[0], first.inputs[0])
    tree.links.new(second.outputs[0], emission.inputs["Color"])
    tree.links.new(emission.outputs[0], output.inputs["Surface"])
    assert np.isfinite(look_values(material)[1]).all()


def test_value_that_feeds_many_nodes_is_evaluated_once():
    """Forty nodes, each fed twice by the one before: without memory 2^40 evaluations."""

    def build(tree):
        socket = Trees().color_attribute(tree)
        for _ in range(40):
            mix = add_node(tree, 'ShaderNodeMixRGB')
            tree.links.new(socket, mix.inputs["Color1"])
            tree.links.new(socket, mix.inputs["Color2"])
            socket = mix.outputs[0]
        return socket

    assert_as_in_cycles(emitting_sheet(build))


def test_reduction_by_area_keeps_the_mean():
    pixels = np.random.default_rng(3).random((37, 53, 4)).astype(np.float32)
    small = reduce_by_area(pixels, 16)
    assert small.shape == (16, 16, 4)
    np.testing.assert_allclose(small.mean((0, 1)), pixels.mean((0, 1)), rtol=1e-5)


def test_large_image_keeps_its_mean_light():
    random = np.random.default_rng(4)
    encoded = np.rint(random.random((1100, 4, 4)) * 255).astype(np.float32) / 255
    encoded[..., 3] = 1
    image = bpy.data.images.new("Tall", 4, 1100)
    image.pixels.foreach_set(encoded.ravel())
    texture = ImageLibrary().texture(image)
    assert texture.pixels.shape == (1024, 4, 4)
    linear = texture.colors(texture.pixels.reshape(-1, 4), False)[:, :3]
    np.testing.assert_allclose(linear.mean(0), srgb_to_linear(encoded[..., :3]).mean((0, 1)), rtol=1e-4)


def test_every_compiler_is_of_a_node_that_exists():
    known = {name for name in ARITHMETIC if hasattr(bpy.types, name)}
    # Kept for files that were not converted: replaced by Separate Color and Combine Color in 3.3.
    assert set(ARITHMETIC) - known <= {'ShaderNodeSeparateRGB', 'ShaderNodeCombineRGB'}
