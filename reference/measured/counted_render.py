"""Render a scene several times, and print the CPU time and the number of intersection tests.

    python counted_render.py SCENE.xml SAMPLES PICTURE.npy

`reference.mechanisms` runs this file as a script, with the variable PYTHONPATH set to the folder
that contains the tracer to measure.  The script writes the linear radiance of the picture to a
file, and prints a JSON list of two numbers: the least CPU time of a picture in seconds, and the
number of times that an object was tested with a ray, segment or capsule in one picture.
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


def count_tests(function: Callable[..., Any]) -> Callable[..., Any]:
    """Make a function add the size of its result, or of its first result, to `test_count`."""

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
