"""Measure what each mechanism of speed or accuracy gains, by switching it off.

``python -m reference.mechanisms`` writes `mechanisms.md` into this folder.  A mechanism, one of
those in `mechanisms.json`, is switched off by a replacement of text in a copy of the tracer.  Both
tracers render the scene that needs the mechanism, alternately, each time in a process of its own.
"""

from __future__ import annotations

from tracer.command.process import run

# Called before the other imports, so that `run` already handles Ctrl-C, limits NumPy's threads and
# reports a missing package in one line.  It imports this module again and calls `main`.
if __name__ == "__main__":
    run(__spec__.name)

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from reference.benchmark import format_section
from reference.command import REFERENCE_FOLDER, SCENES, build_path, make_parser
from reference.judges.arrays import Floats
from reference.judges.certificate import certify
from reference.judges.sampling import compute_rms_error, render_supersampled
from reference.measured import workloads
from reference.measured.measurements import describe_origin
from tracer import Scene, load_scene, save_scene
from tracer.command.progress import track

_PROJECT = REFERENCE_FOLDER.parent

# Pictures differ by less than this fraction of their largest value if a mechanism only saves time:
# sums in another order differ in the last digits.
_SAME_PICTURE = 1e-10

# Largest error of the certified pictures from which errors are measured.
_CERTIFIED_ERROR = 1 / 4096

# Scenes with more than this many pairs of an object and a light are not certified, which would take
# minutes, but rendered with this many samples along each side of a pixel.
_MAX_CERTIFIED_PAIRS, _GRID_SIDE = 300, 24

# Numbers of rounds in which both tracers render a scene.
_ROUNDS, _QUICK_ROUNDS = 3, 1

# A program that renders a scene file with the tracer in the first folder of Python's path.  Its
# arguments are the scene file, the number of samples per pixel, and the file for the picture.  It
# prints two numbers: the CPU time of the picture in seconds, and the number of times that an object
# is tested with a ray, segment or capsule.  The first picture warms up the tracer and is not timed.
# A quick picture is rendered several times, and the least time is printed.
_MEASURE_SCRIPT = """
import json, sys, time, warnings
import numpy as np
warnings.simplefilter("ignore")
import tracer
from tracer.geometry.box import Boxes
from tracer.geometry.sphere import Spheres
count = 0
def count_tests(function):
    def counted(*arguments):
        global count
        result = function(*arguments)
        count += np.size(result[0] if isinstance(result, tuple) else result)
        return result
    return counted
for shape in (Spheres, Boxes):
    for name in ("intersect", "occludes", "test_capsules"):
        setattr(shape, name, count_tests(getattr(shape, name)))
scene = tracer.load_scene(sys.argv[1])
tracer.render(scene, int(sys.argv[2]))
seconds = []
while sum(seconds) < 0.3:
    count, start = 0, time.process_time()
    image = tracer.render(scene, int(sys.argv[2]))
    seconds.append(time.process_time() - start)
np.save(sys.argv[3], image)
print(json.dumps([min(seconds), count]))
"""


class Mechanism(NamedTuple):
    """A mechanism of the tracer, and how to switch it off."""

    name: str
    purpose: str  # one sentence: what it does
    lines: int  # lines of code that serve it; those that serve several mechanisms count for each
    module: str  # the file in tracer/ that contains `text`
    text: str  # occurs once in the module, and is replaced by `replacement`
    replacement: str
    scene: str  # the scene that needs it: see `load_named_scene`
    samples: int  # samples per pixel
    # Minimum ratios of the error and of the number of tests without the mechanism to those with it;
    # 0 if nothing is claimed.  An error ratio below 1 is a cost: the mechanism saves time, but the
    # picture is less accurate with it than without it.
    min_error_ratio: float = 0.0
    min_test_ratio: float = 0.0


class Measured(NamedTuple):
    """What one process measures."""

    seconds: float  # CPU time
    test_count: int  # how often an object is tested with a ray, segment or capsule
    image: Floats


class Gains(NamedTuple):
    """What a picture costs without a mechanism, divided by what it costs with it."""

    time_ratio: float  # of the least times of all rounds
    test_ratio: float
    error_ratio: float  # of the RMSE; 1 if the pictures are the same


_TABLE = Path(__file__).with_suffix(".json").read_text(encoding="utf-8")

MECHANISMS = tuple(Mechanism(**entry) for entry in json.loads(_TABLE))
"""All mechanisms of speed and accuracy in the tracer, as listed in `mechanisms.json`."""

WORKLOADS: dict[str, Callable[[], Scene]] = {
    "2,000 balls under a sun": partial(workloads.build_sun_scene, 2000),
    "heap of 1,000 balls": partial(workloads.build_heap_scene, 1000),
    "shadows of 20,000 balls": partial(workloads.build_dust_scene, 20_000),
    "small ball 2560×1440": workloads.build_small_ball_scene,
    "1,000 balls to the horizon": partial(workloads.build_horizon_scene, 1000),
    "1,000 rods": partial(workloads.build_rods_scene, 1000),
    "200 dim lights": partial(workloads.build_dim_lights_scene, 200),
    "field of 1,000": partial(workloads.build_field_scene, 1000),
    "field of 10,000": partial(workloads.build_field_scene, 10_000),
    "crowd of 3,000": partial(workloads.crowd, 3000, width=96, height=54),
}
"""Scenes that are built, by name."""


def load_named_scene(name: str) -> Scene:
    """Build a workload, or read a file of `tests/scenes` or of `scenes`.

    A name such as "room 640×360" asks for a picture of this size.
    """
    if name in WORKLOADS:
        return WORKLOADS[name]()
    stem, _, size = name.partition(" ")
    paths = [folder / f"{stem}.xml" for folder in (_PROJECT / "tests" / "scenes", SCENES)]
    scene = load_scene(next(path for path in paths if path.exists()))
    if size:
        width, height = map(int, size.split("×"))
        scene = replace(scene, width=width, height=height)
    return scene


def remove_mechanism(mechanism: Mechanism) -> str:
    """Return the source of the mechanism's module without the mechanism.

    Raises
    ------
    ValueError
        If the mechanism's text does not occur exactly once.
    """
    source = (_PROJECT / "tracer" / mechanism.module).read_text(encoding="utf-8")
    if source.count(mechanism.text) != 1:
        raise ValueError(f"{mechanism.name}: not once in {mechanism.module}: {mechanism.text}")
    return source.replace(mechanism.text, mechanism.replacement)


def copy_tracer(folder: Path, mechanism: Mechanism | None = None) -> Path:
    """Copy the tracer into a new folder, without a mechanism if one is given; return the folder."""
    shutil.copytree(_PROJECT / "tracer", folder / "tracer")
    if mechanism is not None:
        path = folder / "tracer" / mechanism.module
        path.write_text(remove_mechanism(mechanism), encoding="utf-8")
    return folder


def measure(tracer_folder: Path, scene_file: Path, samples: int) -> Measured:
    """Render a scene file with the tracer in a folder, in a process of its own."""
    picture_file = tracer_folder / "picture.npy"
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    command = [
        sys.executable,
        "-c",
        _MEASURE_SCRIPT,
        *map(str, (scene_file, samples, picture_file)),
    ]
    # Python looks for the tracer in the working folder first.
    process = subprocess.run(
        command, cwd=tracer_folder, env=environment, check=True, stdout=subprocess.PIPE
    )
    seconds, test_count = json.loads(process.stdout)
    return Measured(seconds=seconds, test_count=test_count, image=np.load(picture_file))


def compute_truth(scene: Scene) -> Floats:
    """Compute the mean radiance of each pixel, so accurately that pictures can be judged by it."""
    if len(scene.surfaces) * len(scene.lights) > _MAX_CERTIFIED_PAIRS:
        return render_supersampled(scene, _GRID_SIDE)
    return certify(scene, _CERTIFIED_ERROR).image


def compute_gains(mechanism: Mechanism, rounds: int) -> Gains:
    """Render the scene that needs a mechanism with it and without it, and compare the costs."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        scene = load_named_scene(mechanism.scene)
        save_scene(scene, scene_file := folder / "scene.xml")
        folders = copy_tracer(folder / "with"), copy_tracer(folder / "without", mechanism)
        results = [
            [measure(each, scene_file, mechanism.samples) for each in folders]
            for _ in range(rounds)
        ]
    with_it, without_it = results[0]
    least_with, least_without = (
        min(result.seconds for result in each) for each in zip(*results, strict=True)
    )
    error_ratio = 1.0
    if np.abs(with_it.image - without_it.image).max() > _SAME_PICTURE * with_it.image.max():
        truth = compute_truth(scene)
        errors = [compute_rms_error(result.image, truth) for result in results[0]]
        error_ratio = errors[1] / errors[0]
    return Gains(
        time_ratio=least_without / least_with,
        test_ratio=without_it.test_count / with_it.test_count,
        error_ratio=error_ratio,
    )


def main() -> None:
    """Switch off each mechanism in turn, and write `mechanisms.md`."""
    arguments = make_parser("reference.mechanisms", quick_help="one round").parse_args()
    rounds = _QUICK_ROUNDS if arguments.quick else _ROUNDS
    rows: list[tuple[object, ...]] = []
    for mechanism in track(MECHANISMS, len(MECHANISMS), "mechanisms"):
        gains = compute_gains(mechanism, rounds)
        scene = f"{mechanism.scene}, {mechanism.samples}"
        rows.append((mechanism.name, mechanism.lines, mechanism.purpose, scene, *gains))
    page = format_section(
        "Mechanisms",
        "Written by `python -m reference.mechanisms`: what a picture takes without each mechanism,"
        " divided by what it takes with it. Lines of code that serve several mechanisms count for"
        " each. CPU times are those of one process (the least of at"
        f" least {rounds}); tests are those of an object and a ray, segment or capsule; the error"
        " is the RMSE from the certified picture, 1.0× where the pictures are the same. The scene"
        " (of `tests/scenes`, `scenes`, or `reference/measured/workloads.py`) with its number of"
        f" samples per pixel is the one that needs the mechanism. Measured on {describe_origin()}.",
        ("mechanism", "lines", "what it does", "scene, samples", "time", "tests", "error"),
        rows,
    )
    path = build_path("mechanisms.md") if arguments.quick else REFERENCE_FOLDER / "mechanisms.md"
    path.write_text(page.removeprefix("#") + "\n", encoding="utf-8")
