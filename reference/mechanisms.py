"""Measure what each mechanism of speed or accuracy gains, by switching it off.

``python -m reference.mechanisms`` writes `mechanisms.md` into this folder.  `mechanisms.json` lists
the mechanisms.  Each is switched off by replacing text in a copy of the tracer.  Then the tracer
with the mechanism and the one without it render a scene alternately, each picture in a process of
its own.
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
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated as Shaped
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

# A mechanism that only saves time may change pictures by this fraction of their largest value: sums
# in another order differ in the last digits.
_SAME_PICTURE = 1e-10

# Largest error of the certified pictures from which errors are measured.
_CERTIFIED_ERROR = 1 / 4096

# Maximum product of the numbers of objects and of lights in a scene that is certified.  Certifying
# larger scenes would take minutes.
_MAX_CERTIFIED_PAIRS = 300

# Larger scenes are rendered with this many samples along each side of a pixel.
_GRID_SIDE = 24

# Number of times that both tracers render a scene, and the number with the option --quick.
_ROUNDS = 3
_QUICK_ROUNDS = 1

# The program that renders a picture, and counts the tests.
_MEASURE_SCRIPT = REFERENCE_FOLDER / "measured" / "counted_render.py"


class Mechanism(NamedTuple):
    """A mechanism of the tracer, and how to switch it off."""

    name: str
    purpose: str  # one sentence: what it does
    lines: int  # lines of code that serve it; other mechanisms may share some of them
    module: str  # the file in tracer/ that contains `text`
    text: str  # occurs once in the module, and is replaced by `replacement`
    replacement: str
    scene: str  # the scene that needs it: see `load_named_scene`
    samples: int  # samples per pixel
    # Minimum values of the fields of `Gains`, which tests/tools/test_mechanisms.py checks; 0 if
    # nothing is claimed.  An error ratio below 1 is a cost: the mechanism saves time, but makes the
    # picture less accurate.
    min_error_ratio: float = 0.0
    min_test_ratio: float = 0.0


class Measured(NamedTuple):
    """A picture, and what it cost."""

    seconds: float  # CPU time
    test_count: int  # how often an object is tested with a ray, segment or capsule
    image: Shaped[Floats, "height width 3"]  # linear radiance


class Gains(NamedTuple):
    """What a picture costs without a mechanism, divided by what it costs with it."""

    time_ratio: float  # of the CPU times
    test_ratio: float  # of the numbers of tests
    error_ratio: float  # of the root mean square errors; 1 if the pictures are the same


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
    "crowd of 3,000": partial(workloads.build_crowd_scene, 3000, width=96, height=54),
}
"""Scenes that are built, by name."""


def load_named_scene(name: str) -> Scene:
    """Load the scene that a mechanism of `mechanisms.json` names.

    The name is a key of `WORKLOADS`, or the name of a file in `tests/scenes` or `scenes` without
    the suffix, as in "room".  A size may follow the name of a file, as in "room 640×360".  It
    replaces the size of the picture in the file.
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
    """Return the source of the mechanism's module, in which other text replaces the mechanism's.

    Raise ValueError if the mechanism's text does not occur exactly once in the module.
    """
    source = (_PROJECT / "tracer" / mechanism.module).read_text(encoding="utf-8")
    if source.count(mechanism.text) != 1:
        raise ValueError(f"{mechanism.name}: not once in {mechanism.module}: {mechanism.text}")
    return source.replace(mechanism.text, mechanism.replacement)


def copy_tracer(folder: Path, mechanism: Mechanism | None = None) -> Path:
    """Copy the tracer into a new folder, without a mechanism if one is given.

    Return `folder`, which then contains the package `tracer`.
    """
    shutil.copytree(_PROJECT / "tracer", folder / "tracer")
    if mechanism is not None:
        path = folder / "tracer" / mechanism.module
        path.write_text(remove_mechanism(mechanism), encoding="utf-8")
    return folder


def measure(tracer_folder: Path, scene_file: Path, samples: int) -> Measured:
    """Render a scene file in a new process, with the package `tracer` in `tracer_folder`.

    `samples` is the number of samples per pixel.  The picture is also stored in the folder.
    """
    picture_file = tracer_folder / "picture.npy"
    arguments = _MEASURE_SCRIPT, scene_file, samples, picture_file
    command = sys.executable, *map(str, arguments)
    environment = {**os.environ, "PYTHONPATH": str(tracer_folder), "OPENBLAS_NUM_THREADS": "1"}
    process = subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE)
    seconds, test_count = json.loads(process.stdout)
    return Measured(seconds=seconds, test_count=test_count, image=np.load(picture_file))


def compute_gains(mechanism: Mechanism, rounds: int) -> Gains:
    """Render the scene that needs a mechanism with it and without it, and compare the costs.

    Both pictures are rendered `rounds` times, and their least times are compared.
    """
    scene = load_named_scene(mechanism.scene)
    results_with: list[Measured] = []
    results_without: list[Measured] = []
    with TemporaryDirectory() as name:
        scene_file = Path(name, "scene.xml")
        save_scene(scene, scene_file)
        folder_with = copy_tracer(Path(name, "with"))
        folder_without = copy_tracer(Path(name, "without"), mechanism)
        for _ in range(rounds):
            results_with.append(measure(folder_with, scene_file, mechanism.samples))
            results_without.append(measure(folder_without, scene_file, mechanism.samples))
    seconds_with = min(result.seconds for result in results_with)
    seconds_without = min(result.seconds for result in results_without)
    # Only the times vary from round to round.
    with_it = results_with[0]
    without_it = results_without[0]
    return Gains(
        time_ratio=seconds_without / seconds_with,
        test_ratio=without_it.test_count / with_it.test_count,
        error_ratio=_compute_error_ratio(scene, with_it.image, without_it.image),
    )


def _compute_error_ratio(
    scene: Scene,
    image_with: Shaped[Floats, "height width 3"],
    image_without: Shaped[Floats, "height width 3"],
) -> float:
    """Divide the error of the picture without a mechanism by that of the picture with it.

    The ratio is 1 if the pictures differ only in the last digits.
    """
    if np.abs(image_with - image_without).max() <= _SAME_PICTURE * image_with.max():
        return 1.0
    truth = compute_truth(scene)
    return compute_rms_error(image_without, truth) / compute_rms_error(image_with, truth)


def compute_truth(scene: Scene) -> Shaped[Floats, "height width 3"]:
    """Compute the mean radiance of each pixel, so accurately that pictures can be judged by it."""
    if len(scene.surfaces) * len(scene.lights) > _MAX_CERTIFIED_PAIRS:
        return render_supersampled(scene, _GRID_SIDE)
    return certify(scene, _CERTIFIED_ERROR).image


def main() -> None:
    """Switch off each mechanism in turn, and write `mechanisms.md`."""
    arguments = make_parser("reference.mechanisms", quick_help="one round").parse_args()
    rounds = _QUICK_ROUNDS if arguments.quick else _ROUNDS
    rows: list[tuple[object, ...]] = []
    for mechanism in track(MECHANISMS, len(MECHANISMS), "mechanisms"):
        gains = compute_gains(mechanism, rounds)
        scene = f"{mechanism.scene}, {mechanism.samples}"
        rows.append((mechanism.name, mechanism.lines, mechanism.purpose, scene, *gains))
    path = build_path("mechanisms.md") if arguments.quick else REFERENCE_FOLDER / "mechanisms.md"
    path.write_text(_format_page(rows, rounds), encoding="utf-8")


def _format_page(rows: Sequence[Sequence[object]], rounds: int) -> str:
    """Format `mechanisms.md`: what was measured in how many rounds, and a table with the rows."""
    section = format_section(
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
    return section.removeprefix("#") + "\n"  # the heading of the section is that of the page
