"""Convert scenes for POV-Ray, render them with it, and read its pictures.

POV-Ray serves as an independent reference, and as a renderer to compare times with.  Its lights do
not fall off with distance by default, and its `specular` is the same Blinn-Phong lobe.  So its
picture should equal that of the tracer, with one exception: its highlights have no colours, and a
coloured highlight is converted to the grey of its mean.
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
"""Maximum radiance in pictures that `linear` renders; larger radiance is clipped."""

# Exponents are at least this large, so that their reciprocal is finite.
_MIN_EXPONENT = 1e-9

# POV-Ray rounds times to milliseconds.  A time of 0 counts as half of one, as it must have a place
# on a logarithmic axis.
_MIN_SECONDS = 0.0005

_HEADER = "#version 3.7; global_settings { assumed_gamma 1 } background { rgb 0 }"


def installed() -> bool:
    """Return whether the command `povray` is installed."""
    return shutil.which("povray") is not None


def _xyz(values: Iterable[float]) -> str:
    """Format a vector or a colour."""
    return f"<{', '.join(repr(float(value)) for value in values)}>"


def _texture(shader: Shader) -> str:
    """Convert a shader."""
    finish = "ambient 0 diffuse 1"
    if isinstance(shader, Phong) and any(shader.specular):
        roughness = 1 / max(shader.exponent, _MIN_EXPONENT)
        finish += f" specular {sum(shader.specular) / 3!r} roughness {roughness!r}"
    return f"texture {{ pigment {{ rgb {_xyz(shader.diffuse)} }} finish {{ {finish} }} }}"


def _camera(scene: Scene) -> str:
    """Convert the camera: vectors to the window's centre and along its sides.

    The window may be oblique, so these vectors need not be perpendicular.
    """
    camera = scene.camera
    ahead, w, up = (np.array(v) for v in (camera.view_dir, camera.normal, camera.view_up))
    w = -np.copysign(1, w @ ahead) * w  # towards the eye
    right = np.cross(up, w)
    up = np.cross(w, right)
    return (
        f"camera {{ location {_xyz(camera.view_point)}"
        f" direction {_xyz(camera.proj_distance * ahead / np.linalg.norm(ahead))}"
        f" right {_xyz(camera.view_width * right / np.linalg.norm(right))}"
        f" up {_xyz(camera.view_height * up / np.linalg.norm(up))} }}"
    )


def to_pov(scene: Scene, exposure: float = 1.0) -> str:
    """Convert a scene to the language of POV-Ray 3.7.

    Parameters
    ----------
    scene : Scene
        The scene.
    exposure : float
        Factor for the intensities of the lights.

    Returns
    -------
    text : str
        The text of POV-Ray's scene file.
    """
    lines = [_HEADER, _camera(scene)]
    for light in scene.lights:
        color = f"{exposure!r} * {_xyz(light.intensity)}"
        lines.append(f"light_source {{ {_xyz(light.position)} rgb {color} }}")
    shaders = {shader: k for k, shader in enumerate(scene.surfaces.shaders)}
    lines += [f"#declare S{k} = {_texture(shader)}" for shader, k in shaders.items()]
    for surface in scene.surfaces:
        if isinstance(surface, Sphere):
            shape = f"sphere {{ {_xyz(surface.center)}, {surface.radius!r}"
        else:
            shape = f"box {{ {_xyz(surface.min_pt)}, {_xyz(surface.max_pt)}"
        lines.append(f"{shape} texture {{ S{shaders[surface.shader]} }} }}\n")
    return "\n".join(lines)


def command(scene: Scene, target: Path, *options: str, exposure: float = 1.0) -> list[str]:
    """Write the converted scene next to a picture, and return the command that renders the picture.

    Parameters
    ----------
    scene : Scene
        The scene.
    target : Path
        The picture, a PNG file by default.  The scene gets the same name with the suffix .pov.
    *options : str
        More options of POV-Ray.
    exposure : float
        Factor for the intensities of the lights.
    """
    (source := target.with_suffix(".pov")).write_text(to_pov(scene, exposure), encoding="utf-8")
    size = (f"+W{scene.width}", f"+H{scene.height}")
    return ["povray", f"+I{source}", f"+O{target}", *size, "-D", *options]


def linear(scene: Scene, target: Path, *options: str) -> list[str]:
    """Return the command that renders a linear picture with 16 bits per channel.

    The function `picture` reads it.  For the arguments, and the scene file that is written, see
    `command`.
    """
    return command(scene, target, "+FP16", "File_Gamma=1.0", *options, exposure=1 / WHITE)


def picture(target: Path) -> NDArray[np.float64]:
    """Read a picture of `linear`: radiance (height, width, 3), clipped at `WHITE`.

    Raises
    ------
    ValueError
        If the file is not a PPM file with 16 bits per channel.
    """
    data = target.read_bytes()
    header = re.match(rb"P6\s(?:#.*\n)*(\d+)\s+(\d+)\s+65535\s", data)
    if header is None:
        raise ValueError(f"{target} is not a PPM file with 16 bits per channel")
    codes = np.frombuffer(data, dtype=">u2", offset=header.end())
    return codes.reshape(int(header[2]), int(header[1]), 3) * (WHITE / 65535)


def trace(command: Sequence[str]) -> float:
    """Run a command, and return the tracing time that POV-Ray reports, in seconds.

    The time does not include the start of the program.

    Raises
    ------
    RuntimeError
        If POV-Ray fails.
    """
    result = subprocess.run(command, capture_output=True, text=True, errors="replace")
    time = re.search(r"Trace Time:.*\(([\d.]+) seconds\)", result.stderr)
    if result.returncode or not time:
        raise RuntimeError(f"POV-Ray failed:\n{result.stderr}")
    return max(float(time[1]), _MIN_SECONDS)
