"""Shader nodes that read the surface: images, attributes, coordinates, simple procedural textures, the ray.

Each function takes the node's inputs (`node_values.NodeInputs`) and the output asked for, and gives a field, or None
where it cannot: of the procedural textures only those without noise are known.
"""

from __future__ import annotations

from math import pi

import numpy as np

from .fields import Field, attribute, combine, constant, convert
from .images import look_up

#: Gray that stands for an image that is missing: it neither blackens the room nor lights it.
MISSING_GRAY = 0.5

#: What a ray of diffuse light knows of its path; everything else is 0.
_LIGHT_PATH = {"Is Diffuse Ray": 1.0, "Is Reflection Ray": 1.0, "Ray Depth": 1.0, "Diffuse Depth": 1.0}


def _image_pixels(inputs, max_side):
    """(n, 4) field of an image texture, its colors as its Color output gives them; None where the image is missing."""
    node = inputs.node
    library = inputs.compiler.images
    if node.image is None:
        library.problems.append(("missing", f"no image in node {node.name}"))
        return constant(MISSING_GRAY, MISSING_GRAY, MISSING_GRAY, 1)
    texture = library.texture(node.image, max_side)
    if texture is None:
        return constant(MISSING_GRAY, MISSING_GRAY, MISSING_GRAY, 1)
    pixels, interpolation = texture.pixels, node.interpolation
    alpha_output = node.outputs.get("Alpha")
    divide_alpha = alpha_output is not None and alpha_output.is_linked

    if node.bl_idname == 'ShaderNodeTexEnvironment':
        if node.projection != 'EQUIRECTANGULAR':
            return None
        place = inputs.coordinates("Vector", otherwise='object')
        return combine(
            lambda vectors: texture.colors(_look_around(pixels, vectors, interpolation), divide_alpha), place
        )
    if node.projection != 'FLAT':
        inputs.compiler.report(node)  # the mean color is right for a patch that is not much smaller than the image
        return constant(*texture.colors(pixels.reshape(-1, 4), divide_alpha).mean(0))
    extension = node.extension
    place = inputs.coordinates("Vector", otherwise='uv')
    return combine(lambda uv: texture.colors(look_up(pixels, uv, extension, interpolation), divide_alpha), place)


def _look_around(pixels, vectors, interpolation):
    """Equirectangular look-up: azimuth repeats, the poles extend."""
    azimuth = np.arctan2(vectors[:, 1], vectors[:, 0])
    height = np.arctan2(vectors[:, 2], np.hypot(vectors[:, 0], vectors[:, 1]))
    # One row of texels beyond each pole, so that repeating in height does not mix zenith and nadir.
    rows = pixels.shape[0]
    v = (height / pi + 0.5).clip(0.5 / rows, 1 - 0.5 / rows)
    return look_up(pixels, np.stack([0.5 - azimuth / (2 * pi), v], axis=1), 'REPEAT', interpolation)


def _image_texture(inputs, output):
    pixels = inputs.compiler.remember((*inputs.key, "pixels"), lambda: _image_pixels(inputs, inputs.compiler.max_side))
    if pixels is None:
        return None
    part = slice(3, 4) if output.identifier == "Alpha" else slice(0, 3)
    return combine(lambda array: array[:, part], pixels)


def _texture_coordinate(inputs, output):
    if inputs.compiler.is_world:
        return attribute(('direction', "")) if output.name in ("Generated", "Normal", "Object") else None
    kind = {"UV": 'uv', "Generated": 'generated', "Object": 'object'}.get(output.name)
    if kind is None or (kind == 'object' and inputs.node.object is not None):
        return None
    return attribute((kind, ""))


def _uv_map(inputs, output):
    return None if inputs.compiler.is_world else attribute(('uv', inputs.node.uv_map))


def _part_of_color(color: Field, output) -> Field:
    """Color, Vector, Fac (mean) or Alpha of a four-column attribute."""
    if output.identifier == "Alpha":
        return combine(lambda array: array[:, 3:], color)
    if output.identifier == "Fac":
        return combine(lambda array: array[:, :3].mean(1, keepdims=True), color)
    return combine(lambda array: array[:, :3], color)


def _attribute(inputs, output):
    node = inputs.node
    if node.attribute_type != 'GEOMETRY' or inputs.compiler.is_world:
        return None
    return _part_of_color(attribute(('attribute' if node.attribute_name else 'color', node.attribute_name)), output)


def _color_attribute(inputs, output):
    return _part_of_color(attribute(('color', inputs.node.layer_name)), output)


def _object_info(inputs, output):
    if output.name not in ("Color", "Alpha"):
        return None
    return _part_of_color(attribute(('object_color', "")), output)


def _checker(inputs, output):
    place = inputs.coordinates("Vector", otherwise='generated')

    def factor(vectors, scale):
        cells = np.floor(vectors * scale + 1e-6 * np.sign(scale)).astype(np.int64)
        return 1.0 * (cells.sum(1, keepdims=True) % 2)

    share = combine(factor, place, inputs.get("Scale"))
    if output.identifier == "Fac":
        return share
    return combine(lambda t, a, b: np.where(t > 0, a, b), share, inputs.get("Color1"), inputs.get("Color2"))


def _gradient(inputs, output):
    kind = inputs.node.gradient_type

    def value(vectors):
        x, y = vectors[:, 0], vectors[:, 1]
        radius = np.maximum(0.999999 - np.sqrt((vectors**2).sum(1)), 0)
        share = {
            'LINEAR': lambda: x,
            'QUADRATIC': lambda: np.maximum(x, 0) ** 2,
            'EASING': lambda: np.clip(x, 0, 1) ** 2 * (3 - 2 * np.clip(x, 0, 1)),
            'DIAGONAL': lambda: (x + y) / 2,
            'RADIAL': lambda: np.arctan2(y, x) / (2 * pi) + 0.5,
            'QUADRATIC_SPHERE': lambda: radius**2,
            'SPHERICAL': lambda: radius,
        }[kind]()
        return np.clip(share, 0, 1)[:, None]

    share = combine(value, inputs.coordinates("Vector", otherwise='generated'))
    return share if output.identifier == "Fac" else convert(share, 'VALUE', 'RGBA')


def _geometry(inputs, output):
    return constant(inputs.compiler.backfacing) if output.name == "Backfacing" else None


def _light_path(inputs, output):
    return constant(_LIGHT_PATH.get(output.name, 0.0))


def _mean_over_directions(function):
    """Mean over the hemisphere, as a diffuse surface sees it, of (n, 1) -> (n, m) at m cosines."""
    cosines = np.sqrt((np.arange(256) + 0.5) / 256)[None, :]  # equal steps in cos^2 are equal shares of diffuse light
    return lambda *arrays: function(cosines, *arrays).mean(1, keepdims=True)


def _dielectric(cosines, index):
    """Fresnel reflectance of unpolarized light at an interface."""
    refracted = np.sqrt(np.maximum(index**2 - 1 + cosines**2, 0))
    ratio = (refracted - cosines) / (refracted + cosines)
    turn = (cosines * (refracted + cosines) - 1) / (cosines * (refracted - cosines) + 1)
    return np.where(index**2 - 1 + cosines**2 > 0, ratio**2 * (1 + turn**2) / 2, 1)


def _fresnel(inputs, output):
    back = inputs.compiler.backfacing

    def mean(index):
        index = np.maximum(index, 1e-5)
        return _mean_over_directions(_dielectric)(1 / index if back else index)

    return combine(mean, inputs.get("IOR"))


def _layer_weight(inputs, output):
    back = inputs.compiler.backfacing

    def fresnel(blend):
        index = np.maximum(1 - blend, 1e-5)
        return _mean_over_directions(_dielectric)(index if back else 1 / index)

    def facing(blend):
        blend = np.clip(blend, 0, 1 - 1e-5)
        exponent = np.where(blend < 0.5, 2 * blend, 0.5 / (1 - blend))
        return _mean_over_directions(lambda cosines, power: 1 - cosines**power)(exponent)

    return combine(fresnel if output.name == "Fresnel" else facing, inputs.get("Blend"))


TEXTURES = {
    'ShaderNodeTexImage': _image_texture,
    'ShaderNodeTexEnvironment': _image_texture,
    'ShaderNodeTexCoord': _texture_coordinate,
    'ShaderNodeUVMap': _uv_map,
    'ShaderNodeAttribute': _attribute,
    'ShaderNodeVertexColor': _color_attribute,
    'ShaderNodeObjectInfo': _object_info,
    'ShaderNodeTexChecker': _checker,
    'ShaderNodeTexGradient': _gradient,
    'ShaderNodeNewGeometry': _geometry,
    'ShaderNodeLightPath': _light_path,
    'ShaderNodeFresnel': _fresnel,
    'ShaderNodeLayerWeight': _layer_weight,
}
