"""Render a scene several times, and print the CPU time and the number of intersection tests.

    python counted_render.py SCENE.xml SAMPLES PICTURE.npy

`reference.mechanisms` runs this file as a script, with the variable PYTHONPATH set to the folder
that contains the tracer to measure.  The script writes the linear radiance of the picture to a
file.  It prints a JSON list of two numbers: the least CPU time of a picture in seconds, and the
number of tests in one picture.  A *test* asks whether one object meets one ray, one segment or one
capsule (the points near a segment).
"""

from __future__ import annotations

import json
import sys
import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

import tracer
from tracer.geometry.box import Boxes
from tracer.geometry.sphere import Spheres

# A picture is rendered until all renders together have taken this many seconds.
_MIN_TOTAL_SECONDS = 0.3

test_count = 0
"""Number of tests since the current picture was begun."""


def count_tests(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that calls another one, and adds the number of its tests to `test_count`.

    The result of the other function has one element for each test.  If it is a tuple, this holds
    for its first element.
    """

    def count_and_call(*arguments: Any) -> Any:
        global test_count
        result = function(*arguments)
        test_count += np.size(result[0] if isinstance(result, tuple) else result)
        return result

    return count_and_call


for shape in (Spheres, Boxes):
    for method in ("intersect", "occludes", "test_capsules"):
        setattr(shape, method, count_tests(getattr(shape, method)))

warnings.simplefilter("ignore")
scene_file, samples, picture_file = sys.argv[1], int(sys.argv[2]), sys.argv[3]
scene = tracer.load_scene(scene_file)
tracer.render(scene, samples)  # fills the caches and is not timed
seconds: list[float] = []
while sum(seconds) < _MIN_TOTAL_SECONDS:
    test_count = 0
    start_time = time.process_time()
    image = tracer.render(scene, samples)
    seconds.append(time.process_time() - start_time)
np.save(picture_file, image)
print(json.dumps([min(seconds), test_count]))
