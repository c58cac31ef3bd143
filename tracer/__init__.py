"""A ray tracer in plain NumPy for a small XML scene format.

>>> import tracer
>>> scene = tracer.load_scene("scenes/one-sphere.xml")
>>> tracer.write_png("one-sphere.png", tracer.render(scene))
"""

from importlib import import_module
from typing import TYPE_CHECKING

from tracer.scene import display as _display
from tracer.version import __version__ as __version__

if TYPE_CHECKING:
    from tracer.picture.explanation import Explanation, LightPart, SurfaceRef, explain
    from tracer.picture.lint import SceneWarning
    from tracer.picture.png import to_codes, write_png
    from tracer.picture.render import render, to_png
    from tracer.scene.model import Box, Camera, Lambertian, Phong, PointLight, Scene, Shader, Sphere
    from tracer.scene.model import Surfaces as Surfaces
    from tracer.scene.reader import SceneFileError, load_scene
    from tracer.scene.schema import SceneError
    from tracer.scene.writer import save_scene
    from tracer.trace.first_hits import FirstHits, first_hits

__all__ = [
    "Box",
    "Camera",
    "Explanation",
    "FirstHits",
    "Lambertian",
    "LightPart",
    "Phong",
    "PointLight",
    "Scene",
    "SceneError",
    "SceneFileError",
    "SceneWarning",
    "Shader",
    "Sphere",
    "SurfaceRef",
    "Surfaces",
    "explain",
    "first_hits",
    "load_scene",
    "render",
    "save_scene",
    "to_codes",
    "to_png",
    "write_png",
]


def _make_scene_png(scene: "Scene") -> bytes:
    from tracer.picture.notebook import make_notebook_png

    return make_notebook_png(scene)


_display.make_scene_png = _make_scene_png

if not TYPE_CHECKING:
    # Names are imported when first used: `python -m tracer` must begin before NumPy is imported.
    _MODULES = (
        *("scene.model", "scene.reader", "scene.schema", "scene.writer", "trace.first_hits"),
        *("picture.render", "picture.png", "picture.lint", "picture.explanation"),
    )

    def __getattr__(name: str) -> object:
        for path in _MODULES if name in __all__ else ():
            if hasattr(module := import_module(f"tracer.{path}"), name):
                return globals().setdefault(name, getattr(module, name))
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

    def __dir__() -> list[str]:
        return [*__all__, "__version__"]  # the names that help() shows
