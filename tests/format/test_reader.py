"""The meaning of scene files: every default and every convention of the format."""

import gc
import io
import tracemalloc

import numpy as np
import pytest

from tracer import Box, Camera, Lambertian, Phong, PointLight, Scene, Sphere, load_scene
from tracer.scene import elements

EMPTY = "<camera/><image>4 3</image>"


def read_scene(content: str) -> Scene:
    """Read a scene from the text between <scene> and </scene>."""
    return load_scene(io.BytesIO(f"<scene>{content}</scene>".encode()))


def test_defaults():
    scene = read_scene("""
      <camera/> <image>4 3</image> <light><position>1 2 3</position></light>
      <surface type="Sphere"/>
      <surface type="Box"><minPt>-1 -2 -3</minPt><maxPt>1 2 3</maxPt></surface>
      <surface type="Sphere"><shader type="Phong"/></surface>""")
    assert (scene.width, scene.height) == (4, 3)
    vectors = {"view_point": (0, 0, 0), "view_dir": (0, 0, -1), "view_up": (0, 1, 0)}
    sizes = {"proj_distance": 1, "view_width": 1, "view_height": 1}
    assert scene.camera == Camera(**vectors, proj_normal=None, **sizes)
    assert scene.lights == (PointLight(position=(1, 2, 3), intensity=(1, 1, 1)),)
    white = Lambertian(diffuse=(1, 1, 1))
    plain = Phong(diffuse=(1, 1, 1), specular=(0, 0, 0), exponent=1)
    assert list(scene.surfaces) == [
        Sphere(center=(0, 0, 0), radius=1, shader=white),
        Box(min_pt=(-1, -2, -3), max_pt=(1, 2, 3), shader=white),
        Sphere(center=(0, 0, 0), radius=1, shader=plain),
    ]
    assert scene.surfaces.file_index.tolist() == [0, 2, 1]


EVERYTHING = """<?xml version="1.0" encoding="utf-8"?>
<!-- all elements of the format -->
<scene>
  <surface type="Sphere"><shader ref="red"/><radius>.5</radius><center>1 2 3</center></surface>
  <surface type="Box">
    <shader type="Lambertian"><diffuseColor>0 1 0</diffuseColor></shader>
    <minPt>-1 -2 -3</minPt><maxPt>1 2 3</maxPt>
  </surface>
  <image>640 480</image>
  <light><intensity>.7 .8 .9</intensity><position>-1 -2 -3</position></light>
  <light><position>-1 -2 -3</position><color>.7 .8 .9</color></light>
  <shader name="red" type="Phong">
    <exponent>2e1</exponent>
    <specularColor>.1 .2 .3</specularColor> <diffuseColor>.4 .5 .6</diffuseColor>
  </shader>
  <camera>
    <viewPoint>1 2 3</viewPoint> <viewDir>4 5 6</viewDir> <viewUp>0 0 1</viewUp>
    <projNormal>1 1 1</projNormal> <projDistance>7</projDistance>
    <viewWidth>.75</viewWidth> <viewHeight>.76</viewHeight>
  </camera>
</scene>
"""


def test_all_elements():
    vectors = {"view_point": (1, 2, 3), "view_dir": (4, 5, 6), "view_up": (0, 0, 1)}
    sizes = {"proj_distance": 7, "view_width": 0.75, "view_height": 0.76}
    camera = Camera(**vectors, proj_normal=(1, 1, 1), **sizes)
    light = PointLight(position=(-1, -2, -3), intensity=(0.7, 0.8, 0.9))
    shader = Phong(diffuse=(0.4, 0.5, 0.6), specular=(0.1, 0.2, 0.3), exponent=20)
    ball = Sphere(center=(1, 2, 3), radius=0.5, shader=shader)
    green = Lambertian(diffuse=(0, 1, 0))
    box = Box(min_pt=(-1, -2, -3), max_pt=(1, 2, 3), shader=green)
    expected = Scene(width=640, height=480, camera=camera, lights=[light] * 2, surfaces=[ball, box])
    assert load_scene(io.BytesIO(EVERYTHING.encode())) == expected


def test_shaders_are_named_nested_or_referred_to_before_they_are_defined():
    """Each shader is stored once, however often it is used."""
    scene = read_scene(f"""{EMPTY}
      <surface type="Sphere"><shader ref="late"/></surface>
      <surface type="Sphere"><shader ref="nested"/></surface>
      <surface type="Sphere"><shader name="nested" type="Phong"/></surface>
      <shader type="Lambertian" name="late"><diffuseColor>0 1 0</diffuseColor></shader>
      <surface type="Sphere"><shader ref="late"/></surface>""")
    green = Lambertian(diffuse=(0, 1, 0))
    assert [surface.shader for surface in scene.surfaces] == [green, Phong(), Phong(), green]
    assert len(scene.surfaces.shaders) == 3  # with white


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1 2 3", (1, 2, 3)),
        ("\n 1\t2\r\n\n3 ", (1, 2, 3)),
        (".5 1e-3 -2", (0.5, 1e-3, -2)),
        ("+1. -0 1E+2", (1, 0, 100)),
        ("1<!-- x --> 2 <!-- \n --> 3", (1, 2, 3)),
        ("1<!-- x --> <!-- x -->2 3", (1, 2, 3)),
        ("<![CDATA[1 2]]> 3", (1, 2, 3)),
        ("&#49; 2 3", (1, 2, 3)),
        ("1e-308 0e-400 1.7976931348623157e308", (1e-308, 0, np.finfo(float).max)),
        (f"{'0' * 5000}1 2 {'3' * 300}", (1, 2, float("3" * 300))),
    ],
)
def test_numbers(text, value):
    scene = read_scene(f"<camera><viewDir>{text}</viewDir></camera><image>4 3</image>")
    assert scene.camera.view_dir == value


def test_the_largest_picture():
    scene = read_scene("<camera/><image>16384 16384</image>")
    assert scene.width * scene.height == 2**28
    assert scene.lights == ()
    assert len(scene.surfaces) == 0


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "iso-8859-15", "koi8-r"])
def test_encodings_comments_and_processing_instructions(encoding):
    declared = encoding.removesuffix("-sig")
    text = f"""<?xml version="1.0" encoding="{declared}"?>
      <?hint at all?> <!DOCTYPE scene> <!-- before --><scene>{EMPTY}</scene><!-- after -->
    """
    assert load_scene(io.BytesIO(text.encode(encoding))).width == 4


def test_a_token_may_be_divided_between_chunks():
    """The file is parsed in chunks of 16 KiB, which may begin anywhere."""
    sphere = '<surface type="Sphere"><center>1 2 3</center><radius>4</radius></surface>'
    for shift in range(0, len(sphere), 7):
        scene = read_scene(EMPTY + " " * shift + sphere * 2000)
        assert (scene.surfaces.center == (1, 2, 3)).all()
        assert (scene.surfaces.radius == 4).all()
        assert len(scene.surfaces) == 2000


def test_surfaces_take_little_memory():
    """The reader stores arrays, not a tree: they take fewer bytes than the file."""
    sphere = '<surface type="Sphere"><center>1 2 3</center><radius>4</radius></surface>\n'
    file = io.BytesIO(f"<scene>{EMPTY}{sphere * 20_000}</scene>".encode())
    load_scene(file)
    file.seek(0)
    tracemalloc.start()
    scene = load_scene(file)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(scene.surfaces) == 20_000
    # 32 bytes of numbers, 8 each of shader and index, 22 of line numbers and tags; arrays grow in
    # steps and are copied once into the scene: under 2 x 64 bytes per surface, and the buffers.
    assert peak < 20_000 * 128 + 2**20


def test_the_reader_leaves_no_reference_cycles():
    gc.collect()
    gc.disable()
    try:
        read_scene(EMPTY + '<surface type="Sphere"/>')
        assert gc.collect() == 0
    finally:
        gc.enable()


def test_a_chunk_of_white_space_separates_numbers():
    """The file is parsed in chunks: the first number ends one, and the second begins another."""
    size = elements._CHUNK_BYTES
    start = "<scene><camera/><image>4 3</image><light><position>".ljust(size - 1)
    scene = f"{start}1{' ' * size}2 3</position></light></scene>"
    assert load_scene(io.BytesIO(scene.encode())).lights[0].position == (1, 2, 3)
