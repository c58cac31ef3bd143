"""A scene for POV-Ray, to measure it beside the tracer.

The same geometry, camera and lights (POV-Ray's do not fall off either) and the
same Blinn-Phong lobe; only a coloured highlight comes out in its mean grey.
"""

from __future__ import annotations

from collections.abc import Sequence

from converters.camera import window_of
from tracer.arrays import Floats
from tracer.scene.model import Scene
from tracer.scene.objects import Phong, Shader

__all__ = ["to_pov"]


def _xyz(values: Sequence[float] | Floats) -> str:
    return "<" + ", ".join(repr(float(value)) for value in values) + ">"


def _texture(shader: Shader) -> str:
    lobe = ""
    if isinstance(shader, Phong) and any(shader.specular):
        lobe = f" specular {sum(shader.specular) / 3!r} roughness {1 / max(shader.exponent, 1)!r}"
    return (
        f"texture {{ pigment {{ rgb {_xyz(shader.diffuse)} }}"
        f" finish {{ ambient 0 diffuse 1{lobe} }} }}"
    )


def to_pov(scene: Scene, exposure: float = 1.0) -> str:
    """The scene description that POV-Ray 3.7 reads, its lights times `exposure`."""
    window = window_of(scene.camera)
    u, v, _ = window.axes
    ahead = window.points(0.5, 0.5)
    lines = [
        "#version 3.7;",
        "global_settings { assumed_gamma 1 }",
        "background { rgb 0 }",
        f"camera {{ location {_xyz(window.eye)} direction {_xyz(ahead)}"
        f" right {_xyz(window.width * u)}"
        f" up {_xyz(-window.height * v)} }}",
        *(
            f"light_source {{ {_xyz(light.position)} rgb {exposure!r} * {_xyz(light.intensity)} }}"
            for light in scene.lights
        ),
        *(f"#declare S{k} = {_texture(shader)}" for k, shader in enumerate(scene.surfaces.shaders)),
    ]
    s = scene.surfaces
    lines += [
        f"sphere {{ {_xyz(center)}, {radius!r} texture {{ S{shader} }} }}"
        for center, radius, shader in zip(
            s.center, s.radius.tolist(), s.sphere_shader.tolist(), strict=True
        )
    ]
    lines += [
        f"box {{ {_xyz(low)}, {_xyz(high)} texture {{ S{shader} }} }}"
        for low, high, shader in zip(s.min_pt, s.max_pt, s.box_shader.tolist(), strict=True)
    ]
    return "\n".join([*lines, ""])
