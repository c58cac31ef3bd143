"""A ray tracer in plain NumPy for a small XML scene format.

>>> import tracer
>>> scene = tracer.load_scene("scenes/one-sphere.xml")
>>> tracer.write_png("one-sphere.png", tracer.render(scene))
"""

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
