"""The renderers that the tracer is measured against: Mitsuba 3 and POV-Ray."""

from __future__ import annotations

import re
import shutil
import subprocess
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from converters.flavours import exact, normalisation, stock
from converters.variant import use
from reference.machine import BUILD
from reference.povray import to_pov
from tracer.scene import Floats, Scene

__all__ = [
    "MITSUBA_PROCESS",
    "mitsuba_exact",
    "mitsuba_merged",
    "mitsuba_stock",
    "mitsuba_text",
    "povray",
    "povray_command",
    "povray_installed",
]

MITSUBA_PROCESS = """
import sys
import mitsuba as mi
variant, source, target = sys.argv[1:]
mi.set_variant(variant)
if "unattenuated_point" in open(source).read():
    import converters.plugins
mi.util.write_bitmap(target, mi.render(mi.load_file(source)), write_async=False)
"""
"""What a script that renders one scene with Mitsuba comes to."""


# Brightest radiance that survives in POV-Ray's 16-bit PNG.
_POVRAY_WHITE = 4.0


def mitsuba_text(scene: Scene, samples: int = 1, samplers: Sequence[str] = ()) -> str:
    """The exact flavour's XML, with a sensor for each of these samplers of Mitsuba's.

    Without any, samples are stratified, and a single one is the pixel's centre.
    """
    text = exact(scene, samples)
    if not samplers:
        return text
    count = f'<integer name="sample_count" value="{samples}"/>'

    def with_samplers(sensor: re.Match[str]) -> str:
        return "\n".join(
            re.sub(
                "<sampler .*?</sampler>",
                f'<sampler type="{sampler}">{count}</sampler>',
                sensor[0],
                flags=re.DOTALL,
            )
            for sampler in samplers
        )

    return re.sub("<sensor .*?</sensor>", with_samplers, text, flags=re.DOTALL)


def mitsuba_exact(scene: Scene, samplers: Sequence[str] = ()) -> Any:
    """The same picture from Mitsuba, by this project's plugins, in the current variant.

    Mitsuba's kernels choose among all objects alive in the process: keep one scene at a time.
    """
    _plugins()
    return mi.load_string(mitsuba_text(scene, samplers=samplers))


def mitsuba_stock(scene: Scene, samples: int = 1) -> Any:
    """A similar picture from Mitsuba's own plugins, which are compiled."""
    if mi.variant() is None:
        use()
    return mi.load_string(stock(scene, samples))


def mitsuba_merged(scene: Scene) -> Any:
    """All objects merged into one mesh of one material, spheres as icosahedra.

    The wrong picture, but the fastest geometry that Mitsuba can be handed.
    """
    _plugins()
    BUILD.mkdir(exist_ok=True)
    root = ET.fromstring(exact(scene))
    for shape in root.findall("shape"):
        root.remove(shape)
    vertices, faces = _triangles(scene)
    mesh = mi.Mesh("merged", len(vertices), len(faces))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = np.float32(normalisation(scene)(vertices)).ravel()
    parameters["faces"] = np.uint32(faces).ravel()
    parameters.update()
    target = BUILD / "merged.ply"
    mesh.write_ply(str(target))
    shape = ET.SubElement(root, "shape", type="ply")
    ET.SubElement(shape, "string", name="filename", value=str(target))
    ET.SubElement(shape, "boolean", name="face_normals", value="true")
    ET.SubElement(shape, "ref", id="bsdf0")
    return mi.load_string(ET.tostring(root, encoding="unicode"))


def _plugins() -> None:
    import converters.plugins  # noqa: F401 (registers the plugins that scenes name)


def _triangles(scene: Scene) -> tuple[Floats, Floats]:
    """Vertices (n, 3) and faces (m, 3) of all objects."""
    s, golden = scene.surfaces, (1 + np.sqrt(5)) / 2
    ring = [(0, a, b * golden) for a in (-1, 1) for b in (-1, 1)]
    ball = np.array([np.roll(v, k) for k in range(3) for v in ring]) / np.hypot(1, golden)
    # Of a convex body, three vertices as near to each other as can be span a face.
    near = np.linalg.norm(ball[:, None] - ball, axis=2) < 1.1
    sides = [
        (i, j, k)
        for i in range(12)
        for j in range(i)
        for k in range(j)
        if near[i, j] and near[j, k] and near[i, k]
    ]
    cube = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    halves = [half for a, b, c, d in quads for half in ((a, b, c), (a, c, d))]
    balls = s.center[:, None] + s.radius[:, None, None] * ball
    boxes = s.min_pt[:, None] + (s.max_pt - s.min_pt)[:, None] * cube
    first = 12 * len(balls) + 8 * np.arange(len(boxes))
    faces = np.concatenate(
        [
            (12 * np.arange(len(balls))[:, None, None] + np.array(sides)).reshape(-1, 3),
            (first[:, None, None] + np.array(halves)).reshape(-1, 3),
        ]
    )
    return np.concatenate([balls.reshape(-1, 3), boxes.reshape(-1, 3)]), faces


def povray_installed() -> bool:
    """Whether there is a POV-Ray to measure."""
    return shutil.which("povray") is not None


def povray(scene: Scene, *options: str) -> tuple[Floats, float]:
    """Render with POV-Ray.

    Returns
    -------
    image : (h, w, 3) float64
        Linear RGB, clipped at `_POVRAY_WHITE`.
    seconds : float
        What POV-Ray says it spent on tracing alone.

    Raises
    ------
    RuntimeError
        If POV-Ray fails.
    """
    BUILD.mkdir(exist_ok=True)
    source, target = BUILD / "scene.pov", BUILD / "scene.png"
    source.write_text(to_pov(scene, exposure=1 / _POVRAY_WHITE))
    command = povray_command(scene, source, target, "+FN16", "File_Gamma=1.0", *options)
    done = subprocess.run(command, capture_output=True, text=True, errors="replace")
    found = re.search(r"Trace Time:.*\(([\d.]+) seconds\)", done.stderr)
    if done.returncode or not found:
        raise RuntimeError(f"POV-Ray failed:\n{done.stderr}")
    image = np.array(mi.Bitmap(str(target)), dtype=np.float64)[..., :3]
    return image / 65535 * _POVRAY_WHITE, float(found[1])


def povray_command(scene: Scene, source: Path, target: Path, *options: str) -> list[str]:
    """POV-Ray without a window, from a scene description to a PNG."""
    size = (f"+W{scene.width}", f"+H{scene.height}")
    return ["povray", f"+I{source}", f"+O{target}", *size, "-D", *options]
