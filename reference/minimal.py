"""How near the limit: compiles and calls `minimal.c`, where there is a C compiler."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from converters.camera import window_of
from reference.command import built
from tracer.arrays import Floats
from tracer.scene.model import Scene
from tracer.view.camera import raster_of

__all__ = ["Minimal", "compiler"]

_SOURCE = Path(__file__).with_name("minimal.c")


def compiler() -> str | None:
    """A C compiler, if there is one."""
    return shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")


class _Scene(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_double * 3) for name in ("eye", "corner", "right", "down")),
        *((name, ctypes.c_ssize_t) for name in ("width", "height", "spheres", "boxes", "lights")),
        *((name, ctypes.c_void_p) for name in ("sphere", "box", "light", "material")),
    ]


@cache
def _library() -> ctypes.CDLL:
    cc = compiler()
    if cc is None:
        raise FileNotFoundError("no C compiler (cc, gcc or clang) on the PATH")
    target = built("minimal.so")
    options = ["-O3", "-march=native", "-ffp-contract=fast", "-fno-math-errno", "-shared", "-fPIC"]
    subprocess.run([cc, *options, "-o", target, _SOURCE, "-lm"], check=True)
    return ctypes.CDLL(str(target))


class Minimal:
    """A scene for the compiled loops; the eye is outside of all objects.

    Raises
    ------
    FileNotFoundError
        If there is no C compiler.
    """

    def __init__(self, scene: Scene) -> None:
        surfaces = scene.surfaces
        raster = raster_of(scene.camera, scene.width, scene.height)
        u, v, _ = raster.axes
        shader = surfaces.shader_index
        # Kept alive: the pointers below point into these arrays.
        self._arrays = {
            "sphere": np.column_stack([surfaces.center, surfaces.radius]),
            "box": np.hstack([surfaces.min_pt, surfaces.max_pt]),
            "light": np.array([[*light.position, *light.intensity] for light in scene.lights]),
            "material": np.array(
                [
                    [*s.diffuse, *getattr(s, "specular", (0, 0, 0)), getattr(s, "exponent", 1)]
                    for s in surfaces.shaders
                ]
            )[shader],
        }
        self._scene = _Scene(
            eye=tuple(raster.eye),
            corner=tuple(window_of(scene.camera).points(0, 0)),
            right=tuple(raster.step_u * u),
            down=tuple(raster.step_v * v),
            width=scene.width,
            height=scene.height,
            spheres=surfaces.sphere_count,
            boxes=len(surfaces.min_pt),
            lights=len(scene.lights),
            **{name: array.ctypes.data for name, array in self._arrays.items()},
        )
        pixels = scene.width * scene.height
        self._owner = np.empty(pixels, dtype=np.int32)
        self._lit = np.empty(pixels, dtype=np.uint64)
        self._image = np.empty((scene.height, scene.width, 3))

    def find(self) -> None:
        """Every ray against every object: finds what `shade` is told."""
        _call(_library().find, self._scene, self._owner, self._lit)

    def shade(self) -> Floats:
        """Only what is seen, only by the light that reaches it: (h, w, 3) radiance."""
        _call(_library().shade, self._scene, self._owner, self._lit, self._image)
        return self._image


def _call(function: Callable[..., object], scene: _Scene, *arrays: NDArray[Any]) -> None:
    function(ctypes.byref(scene), *(ctypes.c_void_p(array.ctypes.data) for array in arrays))
