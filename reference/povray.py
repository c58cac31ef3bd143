"""Convert scenes for POV-Ray, run it, and read its pictures.

POV-Ray serves as an independent reference, and for comparisons of times.  By default, its lights do
not fall off with distance, and its `specular` is the Blinn-Phong lobe of the scene format.  So its
picture should equal that of the tracer, with one exception: its highlights have no colours.  A
coloured highlight becomes grey, with the mean of its three components.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated as Shaped

import numpy as np
from numpy.typing import NDArray

from tracer import Phong, Scene, Shader, Sphere

MAX_RADIANCE = 4.0
"""Maximum radiance in pictures that `read_linear_picture` reads; larger radiance is clipped."""

# Exponents are at least this large, so that their reciprocal is finite.
_MIN_EXPONENT = 1e-9

# POV-Ray rounds times to milliseconds.  A time of 0 is replaced by half a millisecond, because
# times are drawn on a logarithmic axis.
_MIN_SECONDS = 0.0005

_HEADER = "#version 3.7; global_settings { assumed_gamma 1 } background { rgb 0 }"


def is_installed() -> bool:
    """Test whether POV-Ray's command, `povray`, is installed."""
    return shutil.which("povray") is not None


def _format_vector(numbers: Iterable[float]) -> str:
    """Format the three components of a vector or colour, as "<x, y, z>"."""
    return f"<{', '.join(repr(float(number)) for number in numbers)}>"


def _convert_shader(shader: Shader) -> str:
    """Convert a shader to a texture in the POV-Ray language; a coloured highlight becomes grey."""
    finish = "ambient 0 diffuse 1"
    if isinstance(shader, Phong) and any(shader.specular):
        roughness = 1 / max(shader.exponent, _MIN_EXPONENT)
        finish += f" specular {sum(shader.specular) / 3!r} roughness {roughness!r}"
    return f"texture {{ pigment {{ rgb {_format_vector(shader.diffuse)} }} finish {{ {finish} }} }}"


def _convert_camera(scene: Scene) -> str:
    """Convert a scene's camera to the POV-Ray language.

    POV-Ray defines a camera by a vector to the centre of the window and vectors along its sides.
    These vectors need not be perpendicular, because the window may be oblique.
    """
    camera = scene.camera
    forward, normal = np.array(camera.view_dir), np.array(camera.normal)
    towards_eye = -np.copysign(1, normal @ forward) * normal
    right = np.cross(camera.view_up, towards_eye)
    up = np.cross(towards_eye, right)
    return (
        f"camera {{ location {_format_vector(camera.view_point)}"
        f" direction {_format_vector(camera.proj_distance * forward / np.linalg.norm(forward))}"
        f" right {_format_vector(camera.view_width * right / np.linalg.norm(right))}"
        f" up {_format_vector(camera.view_height * up / np.linalg.norm(up))} }}"
    )


def convert_scene(scene: Scene, exposure: float = 1.0) -> str:
    """Convert a scene to POV-Ray 3.7, with all lights multiplied by the exposure."""
    lines = [_HEADER, _convert_camera(scene)]
    for light in scene.lights:
        color = f"{exposure!r} * {_format_vector(light.intensity)}"
        lines.append(f"light_source {{ {_format_vector(light.position)} rgb {color} }}")
    texture_names = {shader: f"S{index}" for index, shader in enumerate(scene.surfaces.shaders)}
    for shader, name in texture_names.items():
        lines.append(f"#declare {name} = {_convert_shader(shader)}")
    for surface in scene.surfaces:
        if isinstance(surface, Sphere):
            shape = f"sphere {{ {_format_vector(surface.center)}, {surface.radius!r}"
        else:
            shape = f"box {{ {_format_vector(surface.min_pt)}, {_format_vector(surface.max_pt)}"
        lines.append(f"{shape} texture {{ {texture_names[surface.shader]} }} }}\n")
    return "\n".join(lines)


def prepare_command(
    scene: Scene, picture_path: Path, *options: str, exposure: float = 1.0
) -> list[str]:
    """Write a scene as a POV-Ray scene file, and return the command that renders it.

    The command writes the picture, by default as a PNG file.  The scene file has the path of the
    picture, with the suffix .pov.  `options` are further arguments of the command.  The intensities
    of all lights are multiplied by the exposure.
    """
    scene_path = picture_path.with_suffix(".pov")
    scene_path.write_text(convert_scene(scene, exposure), encoding="utf-8")
    size_options = (f"+W{scene.width}", f"+H{scene.height}")
    return ["povray", f"+I{scene_path}", f"+O{picture_path}", *size_options, "-D", *options]


def prepare_linear_command(scene: Scene, picture_path: Path, *options: str) -> list[str]:
    """Do the same as `prepare_command` for a picture that `read_linear_picture` can read.

    The picture is a PPM file of linear radiance, clipped at `MAX_RADIANCE`, with 16 bits per
    channel.
    """
    linear_options = ("+FP16", "File_Gamma=1.0", *options)
    return prepare_command(scene, picture_path, *linear_options, exposure=1 / MAX_RADIANCE)


def read_linear_picture(picture_path: Path) -> Shaped[NDArray[np.float64], "height width 3"]:
    """Read a picture that POV-Ray wrote for `prepare_linear_command`, as linear RGB radiance.

    Raise ValueError if the file is not a PPM file with 16 bits per channel.
    """
    data = picture_path.read_bytes()
    header = re.match(rb"P6\s(?:#.*\n)*(\d+)\s+(\d+)\s+65535\s", data)
    if header is None:
        raise ValueError(f"{picture_path} is not a PPM file with 16 bits per channel")
    codes = np.frombuffer(data, dtype=">u2", offset=header.end())
    return codes.reshape(int(header[2]), int(header[1]), 3) * (MAX_RADIANCE / 65535)


def render_and_time(command: Sequence[str]) -> float:
    """Run a POV-Ray command, and return the rendering time that POV-Ray reports, in seconds.

    The time excludes the start of the program.  Raise RuntimeError, with POV-Ray's messages, if
    POV-Ray fails or reports no time.
    """
    result = subprocess.run(command, capture_output=True, text=True, errors="replace")
    time_match = re.search(r"Trace Time:.*\(([\d.]+) seconds\)", result.stderr)
    if result.returncode or not time_match:
        raise RuntimeError(f"POV-Ray failed:\n{result.stderr}")
    return max(float(time_match[1]), _MIN_SECONDS)
