"""Shaders of a node tree as one diffuse look: how much is reflected, emitted and let through.

Every shader becomes a `Closure`, and Mix and Add Shader combine them. The bake knows diffuse light only, so that
each shader is replaced by the diffuse one of equal energy: gloss, metal, sheen and subsurface scattering reflect their
color (a metal has no diffuse color in Cycles, but its energy must go somewhere); glass, refraction, translucency and
transparency let the mean of their color through, straight on. Reflection at a coat or a dielectric's surface is
ignored, as are volumes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import bpy
import numpy as np

from .fields import Field, combine, constant
from .node_graph import Scope, follow
from .node_values import NodeInputs, ValueCompiler


@dataclass(frozen=True)
class Closure:
    """What a shader does with light.

    Parameters
    ----------
    reflectance, emission : Field
        Colors; emission is radiance in W/(m2 sr).
    transmittance : Field
        Value.
    """

    reflectance: Field
    emission: Field
    transmittance: Field


_BLACK = constant(0.0, 0.0, 0.0)
_ZERO = constant(0.0)
NOTHING = Closure(_BLACK, _BLACK, _ZERO)


def _clip(field: Field) -> Field:
    return combine(lambda array: np.clip(array, 0, 1), field)


def _mean(color: Field) -> Field:
    return combine(lambda array: array.mean(1, keepdims=True), color)


def _times(*fields: Field) -> Field:
    def product(first, *others):
        for other in others:
            first = first * other
        return first

    return combine(product, *fields)


def _rest(field: Field) -> Field:
    return combine(lambda array: 1 - array, field)


def _plus(a: Field, b: Field) -> Field:
    return combine(np.add, a, b)


def mix(first: Closure, second: Closure, factor: Field) -> Closure:
    """`second` by `factor`, `first` by the rest."""
    rest = _rest(factor)
    return Closure(
        *(
            _plus(_times(getattr(first, name), rest), _times(getattr(second, name), factor))
            for name in ("reflectance", "emission", "transmittance")
        )
    )


def compile_closure(socket: bpy.types.NodeSocket, scope: Scope | None, values: ValueCompiler) -> Closure:
    """The shader that feeds a socket; `NOTHING` where none does.

    Parameters
    ----------
    socket : bpy.types.NodeSocket
        A shader input.
    scope : Scope or None
        None at the top of a tree.
    values : ValueCompiler
        Compiles colors and factors, and collects what is not supported.
    """
    source = follow(socket, scope)
    if source.node is None:
        return NOTHING
    inputs = NodeInputs(values, source.node, source.scope)
    compiler = _COMPILERS.get(source.node.bl_idname)
    if compiler is None:
        values.report(source.node)
        return NOTHING
    closure = values.remember((*inputs.key, "closure"), lambda: compiler(inputs))
    return NOTHING if closure is None else closure


def _shader_inputs(inputs: NodeInputs) -> list[Closure]:
    sockets = [socket for socket in inputs.node.inputs if socket.type == 'SHADER']
    return [compile_closure(socket, inputs.scope, inputs.compiler) for socket in sockets]


def _mix_shader(inputs):
    first, second = _shader_inputs(inputs)
    return mix(first, second, _clip(inputs.get("Fac", "Factor")))


def _add_shader(inputs):
    first, second = _shader_inputs(inputs)
    return Closure(
        _plus(first.reflectance, second.reflectance),
        _plus(first.emission, second.emission),
        _clip(_plus(first.transmittance, second.transmittance)),
    )


def _reflecting(*names: str) -> Callable[[NodeInputs], Closure]:
    return lambda inputs: Closure(inputs.get(*names), _BLACK, _ZERO)


def _transmitting(inputs):
    return Closure(_BLACK, _BLACK, _clip(_mean(inputs.get("Color"))))


def _emitting(inputs):
    return Closure(_BLACK, _times(inputs.get("Color"), inputs.get("Strength", otherwise=1)), _ZERO)


def _background(inputs):
    strength = inputs.compiler.background_strength
    if strength is None:
        return _emitting(inputs)
    return Closure(_BLACK, _times(inputs.get("Color"), constant(strength)), _ZERO)


def _principled(inputs):
    # Names before and after 4.0; files from before are converted on loading, scripts may still use the old ones.
    color = inputs.get("Base Color")
    emission = inputs.get("Emission Color", "Emission")
    alpha = _clip(inputs.get("Alpha", otherwise=1))
    # A metal lets nothing through, whatever its transmission.
    transmission = _times(
        _clip(inputs.get("Transmission Weight", "Transmission")), _rest(_clip(inputs.get("Metallic")))
    )
    return Closure(
        _times(color, _rest(transmission), alpha),
        _times(emission, inputs.get("Emission Strength", otherwise=1), alpha),
        _plus(_rest(alpha), _times(alpha, transmission, _clip(_mean(color)))),
    )


def _eevee_specular(inputs):
    transparency = _clip(inputs.get("Transparency"))
    opacity = _rest(transparency)
    return Closure(
        _times(inputs.get("Base Color"), opacity), _times(inputs.get("Emissive Color"), opacity), transparency
    )


_COMPILERS = {
    'ShaderNodeMixShader': _mix_shader,
    'ShaderNodeAddShader': _add_shader,
    'ShaderNodeBsdfPrincipled': _principled,
    'ShaderNodeEeveeSpecular': _eevee_specular,
    'ShaderNodeBsdfDiffuse': _reflecting("Color"),
    'ShaderNodeBsdfGlossy': _reflecting("Color"),
    'ShaderNodeBsdfAnisotropic': _reflecting("Color"),
    'ShaderNodeBsdfMetallic': _reflecting("Base Color"),
    'ShaderNodeBsdfSheen': _reflecting("Color"),
    'ShaderNodeBsdfToon': _reflecting("Color"),
    'ShaderNodeBsdfHair': _reflecting("Color"),
    'ShaderNodeBsdfHairPrincipled': _reflecting("Color"),
    'ShaderNodeSubsurfaceScattering': _reflecting("Color"),
    'ShaderNodeBsdfTransparent': _transmitting,
    'ShaderNodeBsdfTranslucent': _transmitting,
    'ShaderNodeBsdfGlass': _transmitting,
    'ShaderNodeBsdfRefraction': _transmitting,
    'ShaderNodeEmission': _emitting,
    'ShaderNodeBackground': _background,
    'ShaderNodeHoldout': lambda inputs: NOTHING,
}
