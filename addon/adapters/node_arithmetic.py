"""Shader nodes that compute with numbers, colors and vectors: the Converter and Color menus, as compilers.

Each function takes the node's inputs (`node_values.NodeInputs`) and the output asked for, and gives a field, or None
where this setting of the node is not known.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from . import node_colors, node_math
from .fields import Field, as_value, combine, constant


def _clip(field: Field) -> Field:
    return combine(lambda array: np.clip(array, 0, 1), field)


def _value(inputs, output):
    return constant(output.default_value)


def _rgb(inputs, output):
    return constant(*output.default_value[:3])


def _mix_color(inputs, output):
    node = inputs.node
    color = combine(
        node_colors.BLEND_MODES[node.blend_type],
        inputs.get("Color1"),
        inputs.get("Color2"),
        _clip(inputs.get("Fac")),
    )
    return _clip(color) if node.use_clamp else color


def _mix(inputs, output):
    node = inputs.node
    by_axis = node.data_type == 'VECTOR' and node.factor_mode == 'NON_UNIFORM'
    factor = inputs.get("Factor_Vector" if by_axis else "Factor_Float")
    suffix = {'FLOAT': "Float", 'VECTOR': "Vector", 'RGBA': "Color"}.get(node.data_type)
    if suffix is None:
        return None
    mode = node_colors.BLEND_MODES[node.blend_type if node.data_type == 'RGBA' else 'MIX']
    if node.clamp_factor:
        factor = _clip(factor)
    mixed = combine(mode, inputs.get(f"A_{suffix}"), inputs.get(f"B_{suffix}"), factor)
    return _clip(mixed) if node.clamp_result and node.data_type == 'RGBA' else mixed


def _math(inputs, output):
    operation = node_math.MATH.get(inputs.node.operation)
    if operation is None:
        return None
    operands = [inputs.compiler.compile(socket, inputs.scope) for socket in inputs.node.inputs]
    result = combine(operation, *operands)
    return _clip(result) if inputs.node.use_clamp else result


def _vector_math(inputs, output):
    operation = node_math.VECTOR_MATH.get(inputs.node.operation)
    if operation is None:
        return None
    operands = [inputs.compiler.compile(socket, inputs.scope) for socket in inputs.node.inputs]
    return combine(operation, *operands)


def _clamp(inputs, output):
    value, low, high = inputs.get("Value"), inputs.get("Min"), inputs.get("Max")
    if inputs.node.clamp_type == 'RANGE':
        return combine(lambda v, a, b: np.clip(v, np.minimum(a, b), np.maximum(a, b)), value, low, high)
    return combine(lambda v, a, b: np.minimum(np.maximum(v, a), b), value, low, high)


def _map_range(inputs, output):
    node = inputs.node
    if node.data_type != 'FLOAT':
        return None
    names = ("Value", "From Min", "From Max", "To Min", "To Max", "Steps")
    interpolation = node.interpolation_type
    fields = [inputs.get(name) for name in names]
    result = combine(lambda *arrays: node_math.map_range(*arrays, interpolation), *fields)
    if node.clamp and interpolation in ('LINEAR', 'STEPPED'):
        result = combine(lambda v, a, b: np.clip(v, np.minimum(a, b), np.maximum(a, b)), result, fields[3], fields[4])
    return result


def _color_ramp(inputs, output):
    ramp = inputs.node.color_ramp
    places = np.linspace(0, 1, node_math.TABLE_SIZE)
    table = np.array([ramp.evaluate(place) for place in places], dtype=np.float32)
    table = table[:, 3:] if output.identifier == "Alpha" else table[:, :3]
    is_stepped = ramp.interpolation == 'CONSTANT'
    return combine(lambda place: node_math.look_up_table(table, place, is_stepped), inputs.get("Fac"))


def _curve_tables(node, low: float) -> list[np.ndarray]:
    """(TABLE_SIZE, 1) values of each curve of a node, from `low` to 1."""
    node.mapping.initialize()
    places = np.linspace(low, 1, node_math.TABLE_SIZE)
    return [
        np.array([[node.mapping.evaluate(curve, place)] for place in places], dtype=np.float32)
        for curve in node.mapping.curves
    ]


def _rgb_curves(inputs, output):
    *channels, combined = _curve_tables(inputs.node, 0)

    def bend(factor, color):
        bent = [
            node_math.look_up_table(channel, node_math.look_up_table(combined, color[:, i : i + 1]))
            for i, channel in enumerate(channels)
        ]
        return color + (np.concatenate(bent, axis=1) - color) * factor

    return combine(bend, inputs.get("Fac"), inputs.get("Color"))


def _vector_curves(inputs, output):
    tables = _curve_tables(inputs.node, -1)

    def bend(factor, vector):
        bent = [node_math.look_up_table(table, vector[:, i : i + 1] / 2 + 0.5) for i, table in enumerate(tables)]
        return vector + (np.concatenate(bent, axis=1) - vector) * factor

    return combine(bend, inputs.get("Fac"), inputs.get("Vector"))


def _float_curve(inputs, output):
    table = _curve_tables(inputs.node, 0)[0]
    return combine(
        lambda factor, value: value + (node_math.look_up_table(table, value) - value) * factor,
        inputs.get("Factor"),
        inputs.get("Value"),
    )


_MODELS_TO = {'HSV': node_colors.rgb_to_hsv, 'HSL': node_colors.rgb_to_hsl}
_MODELS_FROM = {'HSV': node_colors.hsv_to_rgb, 'HSL': node_colors.hsl_to_rgb}


def _separate(inputs, output):
    model = getattr(inputs.node, "mode", 'RGB')
    index = [each.identifier for each in inputs.node.outputs].index(output.identifier)
    source = inputs.compiler.compile(inputs.node.inputs[0], inputs.scope)
    change = _MODELS_TO.get(model, lambda array: array)
    return combine(lambda array: change(array)[:, index : index + 1], source)


def _combine(inputs, output):
    change = _MODELS_FROM.get(getattr(inputs.node, "mode", 'RGB'), lambda array: array)
    parts = [inputs.compiler.compile(socket, inputs.scope) for socket in inputs.node.inputs[:3]]
    return combine(lambda *arrays: change(np.concatenate(np.broadcast_arrays(*arrays), axis=1)), *parts)


def _named(function: Callable, *names: str):
    """A compiler for a node that is one function of these inputs."""
    return lambda inputs, output: combine(function, *(inputs.get(name) for name in names))


def _mapping(inputs, output):
    kind = inputs.node.vector_type
    fields = [inputs.get("Vector"), inputs.get("Location", otherwise=0), inputs.get("Rotation"), inputs.get("Scale")]
    return combine(lambda *arrays: node_math.map_vector(kind, *arrays), *fields)


ARITHMETIC = {
    'ShaderNodeValue': _value,
    'ShaderNodeRGB': _rgb,
    'ShaderNodeMixRGB': _mix_color,
    'ShaderNodeMix': _mix,
    'ShaderNodeMath': _math,
    'ShaderNodeVectorMath': _vector_math,
    'ShaderNodeClamp': _clamp,
    'ShaderNodeMapRange': _map_range,
    'ShaderNodeValToRGB': _color_ramp,
    'ShaderNodeRGBCurve': _rgb_curves,
    'ShaderNodeVectorCurve': _vector_curves,
    'ShaderNodeFloatCurve': _float_curve,
    'ShaderNodeSeparateColor': _separate,
    'ShaderNodeSeparateRGB': _separate,
    'ShaderNodeSeparateXYZ': _separate,
    'ShaderNodeCombineColor': _combine,
    'ShaderNodeCombineRGB': _combine,
    'ShaderNodeCombineXYZ': _combine,
    'ShaderNodeRGBToBW': lambda inputs, output: as_value(inputs.get("Color")),
    'ShaderNodeHueSaturation': _named(node_colors.adjust_hsv, "Hue", "Saturation", "Value", "Fac", "Color"),
    'ShaderNodeInvert': _named(node_colors.invert, "Fac", "Color"),
    'ShaderNodeGamma': _named(node_colors.adjust_gamma, "Color", "Gamma"),
    'ShaderNodeBrightContrast': _named(node_colors.adjust_contrast, "Color", "Bright", "Contrast"),
    'ShaderNodeMapping': _mapping,
}
