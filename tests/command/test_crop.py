"""A part of a picture: every pixel is that of the whole picture, to the last bit."""

import io
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image
from probe import scene_of, sphere_scene
from running import ROOT, run, write_ball

import tracer
from tracer import Camera, PointLight, Sphere
from tracer.command import cli
from tracer.picture.lint import SceneWarning
from tracer.picture.render_job import RenderJob

# Corners, a row, a column, a pixel, a part inside, and the whole picture of 96 x 54 pixels.
CROPS = [
    (0, 0, 7, 5),
    (89, 49, 7, 5),
    (0, 20, 96, 1),
    (50, 0, 1, 54),
    (48, 27, 1, 1),
    (13, 11, 61, 29),
    (0, 0, 96, 54),
]


def select(image: np.ndarray, crop: tuple[int, int, int, int]) -> np.ndarray:
    """Return the part of a picture to which a crop refers."""
    left, top, width, height = crop
    return image[top : top + height, left : left + width]


@pytest.mark.parametrize("max_samples", [None, 40], ids=["usual tiles", "parts of rows"])
@pytest.mark.parametrize("samples", [1, 4, 30, 900])
@pytest.mark.parametrize("name", ["room", "sticks-perspective", "four-spheres"])
def test_every_pixel_is_that_of_the_whole_picture(name, samples, max_samples, monkeypatch):
    size = {"width": 96, "height": 54}
    scene = replace(tracer.load_scene(ROOT / "scenes" / f"{name}.xml"), **size)
    whole = tracer.render(scene, samples)
    if max_samples:
        monkeypatch.setattr("tracer.picture.tiles._MAX_TILE_SAMPLES", max_samples)
        monkeypatch.setattr("tracer.picture.tiles._ADAPTIVE_FACTOR", 1)
    crops = [(13, 11, 61, 2)] if max_samples or samples == 900 else CROPS
    for crop in crops:
        part = tracer.render(scene, samples, crop=crop)
        assert part.tobytes() == select(whole, crop).tobytes(), crop
        # In a worker, the job is made from its pickled arguments.
        job = pickle.loads(pickle.dumps(RenderJob(scene, samples, crop=crop)))
        rectangle = job.work.divide(None)[-1]
        assert job.render_tile(rectangle).tobytes() == whole[rectangle].tobytes(), crop


def test_png_files_of_parts():
    scene = sphere_scene(96, 54)
    codes = tracer.to_codes(tracer.render(scene))
    for crop in CROPS:
        with Image.open(io.BytesIO(tracer.to_png(scene, crop=crop))) as picture:
            assert np.array_equal(np.asarray(picture), select(codes, crop))


@pytest.mark.parametrize("processes", [1, 2])
def test_files_of_parts(processes, tmp_path):
    """The pictures are large enough to be shared by processes."""
    scene = write_ball(tmp_path / "ball.xml", 900, 700)
    other = write_ball(tmp_path / "other.xml", 800, 600)
    crop = (301, 202, 403, 304)
    for file_format in ("png", "npy", "exr"):
        options = ["--crop", "301,202,403,304", "--samples", "16", "--format", file_format]
        status, out, err = run(scene, other, *options, "--processes", processes, cwd=tmp_path)
        assert (status, err) == (0, "")
        assert out.count(": 403 x 304 pixels in ") == 2
    for path in (scene, other):
        expected = select(tracer.render(tracer.load_scene(path), 16), crop)
        assert np.load(f"{path}.npy").tobytes() == expected.tobytes()
        with Image.open(f"{path}.png") as picture:
            assert np.array_equal(np.asarray(picture), tracer.to_codes(expected))
        with OpenEXR.File(f"{path}.exr") as file:
            assert np.array_equal(file.channels()["RGB"].pixels, expected.astype(np.float32))


def test_a_crop_is_measured_in_pixels_of_the_requested_size(tmp_path):
    scene = write_ball(tmp_path / "ball.xml", 90, 70)
    arguments = ["--size", "180", "--crop", "60,70,50,40", "--format", "npy", "--quiet"]
    assert cli.main([str(scene), *arguments]) == 0
    resized = replace(tracer.load_scene(scene), width=180, height=140)
    assert np.array_equal(np.load(f"{scene}.npy"), tracer.render(resized)[70:110, 60:110])


@pytest.mark.filterwarnings("error::tracer.SceneWarning")
def test_nothing_is_said_about_the_brightness_of_a_part(tmp_path, capsys):
    camera = Camera(view_point=(0, 0, 5))
    lights = [PointLight(position=(3, 4, 5), intensity=(9, 9, 9))]
    scene = scene_of(Sphere(radius=0.4), camera=camera, size=(40, 40), lights=lights)
    tracer.save_scene(scene, path := tmp_path / "scene.xml")
    for crop in ((0, 0, 3, 3), (18, 16, 4, 4)):  # black, and too bright
        tracer.render(scene, crop=crop)
        assert cli.main([str(path), "--crop", ",".join(map(str, crop))]) == 0
        assert capsys.readouterr().err == ""
    with pytest.warns(SceneWarning, match="brighter than 1"):
        tracer.render(scene, crop=(0, 0, 40, 40))


def test_other_warnings_are_given(tmp_path: Path, capsys):
    scene = write_ball(tmp_path / "ball.xml", 40, 30)
    assert cli.main([str(scene), "--size", "20x20", "--crop", "0,0,2,2"]) == 0
    assert "would make them square" in capsys.readouterr().err
