"""A ray tracer in plain NumPy for a small XML scene format.

>>> import tracer
>>> scene = tracer.load_scene("scenes/one-sphere.xml")
>>> tracer.write_png("one-sphere.png", tracer.render(scene))
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tracer.image import write_png
    from tracer.reader import SceneFileError, load_scene
    from tracer.render import render
    from tracer.scene import (
        Box,
        Camera,
        Lambertian,
        Phong,
        PointLight,
        Scene,
        SceneError,
        Shader,
        Sphere,
        Surfaces,
    )

__all__ = [
    "Box",
    "Camera",
    "Lambertian",
    "Phong",
    "PointLight",
    "Scene",
    "SceneError",
    "SceneFileError",
    "Shader",
    "Sphere",
    "Surfaces",
    "load_scene",
    "render",
    "write_png",
]

__version__ = "1.0.0"

if not TYPE_CHECKING:
    # Imported when it is first used, so that `python -m tracer` begins before NumPy is there.
    _MODULES = {
        "SceneFileError": "tracer.reader",
        "load_scene": "tracer.reader",
        "render": "tracer.render",
        "write_png": "tracer.image",
    }

    def __getattr__(name: str) -> object:
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        module = import_module(_MODULES.get(name, "tracer.scene"))
        value = globals()[name] = getattr(module, name)
        return value

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})

    class _Package(ModuleType):
        def __setattr__(self, name: str, value: object) -> None:
            # Importing the module `tracer.render` would put it in the place of the function.
            if name != "render" or not isinstance(value, ModuleType):
                super().__setattr__(name, value)

    sys.modules[__name__].__class__ = _Package
