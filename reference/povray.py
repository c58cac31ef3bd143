"""POV-Ray, as a judge and as a rival: a scene in its language, and the picture that it makes.

Its lights do not fall off either, and its `specular` is the same Blinn-Phong lobe, so the picture
is to be the same.  Only highlights have no colours: a coloured one is drawn in its mean grey.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tracer import Phong, Scene, Shader, Sphere

WHITE = 4.0
"""Brightest radiance in `linear` pictures."""


def installed() -> bool:
    """Tell whether there is a POV-Ray."""
    return shutil.which("povray") is not None


def _xyz(values: Iterable[float]) -> str:
    return f"<{', '.join(repr(float(value)) for value in values)}>"


def _texture(shader: Shader) -> str:
    finish = "ambient 0 diffuse 1"
    if isinstance(shader, Phong) and any(shader.specular):
        # The exponent is 1 / roughness.
        roughness = 1 / max(shader.exponent, 1e-9)
        finish += f" specular {sum(shader.specular) / 3!r} roughness {roughness!r}"
    return f"texture {{ pigment {{ rgb {_xyz(shader.diffuse)} }} finish {{ {finish} }} }}"


def _camera(scene: Scene) -> str:
    """The window, by the vectors to its centre and along its sides: it may be oblique."""
    camera = scene.camera
    ahead, w, up = (np.array(v) for v in (camera.view_dir, camera.normal, camera.view_up))
    right = np.cross(up, -np.copysign(1, w @ ahead) * w)
    up = np.cross(right, w) * -np.copysign(1, w @ ahead)
    return (
        f"camera {{ location {_xyz(camera.view_point)}"
        f" direction {_xyz(camera.proj_distance * ahead / np.linalg.norm(ahead))}"
        f" right {_xyz(camera.view_width * right / np.linalg.norm(right))}"
        f" up {_xyz(camera.view_height * -up / np.linalg.norm(up))} }}"
    )


def to_pov(scene: Scene, exposure: float = 1.0) -> str:
    """Write the scene in POV-Ray 3.7's language, its lights times `exposure`."""
    head = "#version 3.7; global_settings { assumed_gamma 1 } background { rgb 0 }"
    lines = [head, _camera(scene)]
    for light in scene.lights:
        color = f"{exposure!r} * {_xyz(light.intensity)}"
        lines.append(f"light_source {{ {_xyz(light.position)} rgb {color} }}")
    shaders = {shader: k for k, shader in enumerate(scene.surfaces.shaders)}
    lines += [f"#declare S{k} = {_texture(shader)}" for shader, k in shaders.items()]
    for s in scene.surfaces:
        if isinstance(s, Sphere):
            shape = f"sphere {{ {_xyz(s.center)}, {s.radius!r}"
        else:
            shape = f"box {{ {_xyz(s.min_pt)}, {_xyz(s.max_pt)}"
        lines.append(f"{shape} texture {{ S{shaders[s.shader]} }} }}\n")
    return "\n".join(lines)


def command(scene: Scene, target: Path, *options: str, exposure: float = 1.0) -> list[str]:
    """Write a scene beside `target`, and return the command that draws it there as a PNG."""
    (source := target.with_suffix(".pov")).write_text(to_pov(scene, exposure), encoding="utf-8")
    size = (f"+W{scene.width}", f"+H{scene.height}")
    return ["povray", f"+I{source}", f"+O{target}", *size, "-D", *options]


def linear(scene: Scene, target: Path, *options: str) -> list[str]:
    """Return the `command` to a picture, linear and of 16 bits, that `picture` reads."""
    return command(scene, target, "+FP16", "File_Gamma=1.0", *options, exposure=1 / WHITE)


def picture(target: Path) -> NDArray[np.float64]:
    """Linear radiance (height, width, 3) of such a picture, clipped at `WHITE`."""
    data = target.read_bytes()
    header = re.match(rb"P6\s(?:#.*\n)*(\d+)\s+(\d+)\s+65535\s", data)
    if header is None:
        raise ValueError(f"{target} is not a PPM of 16 bits")
    codes = np.frombuffer(data, dtype=">u2", offset=header.end())
    return codes.reshape(int(header[2]), int(header[1]), 3) * (WHITE / 65535)


def trace(command: Sequence[str]) -> float:
    """Run POV-Ray, and return the seconds that it says it traced, without its start.

    It rounds them to milliseconds; 0 counts as half of one.  Raises RuntimeError if it fails.
    """
    done = subprocess.run(command, capture_output=True, text=True, errors="replace")
    found = re.search(r"Trace Time:.*\(([\d.]+) seconds\)", done.stderr)
    if done.returncode or not found:
        raise RuntimeError(f"POV-Ray failed:\n{done.stderr}")
    return max(float(found[1]), 0.0005)
