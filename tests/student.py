"""A tracer as a student writes it, and mistakes: changes of one or two places in its source.

`student.txt` lists the mistakes.

The tests search for the mistakes with the formulas of `reference.handins`, with which the source
shares no code.
"""

import re
from pathlib import Path
from typing import Annotated as Shaped
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reference.pictures import Codes
from tracer import Box, Phong, Scene, Sphere

SOURCE = """
def dot(a, b):
    return np.einsum("...k,...k", a, b)

def norm(a):
    return a / np.sqrt(dot(a, a))[..., None]

def hit_sphere(s, o, d):
    q = o - CENTER
    a, b, c = dot(d, d), 2 * dot(d, q), dot(q, q) - RADIUS ** 2
    root = np.sqrt(b * b - 4 * a * c)
    return (-b - root) / (2 * a), (-b + root) / (2 * a)

def hit_box(s, o, d):
    lo, hi = np.array(s.min_pt), np.array(s.max_pt)
    t1, t2 = (lo - o) / d, (hi - o) / d
    near, far = -np.inf, np.inf
    for k in range(3):
        near = np.maximum(near, np.minimum(t1[..., k], t2[..., k]))
        far = np.minimum(far, np.maximum(t1[..., k], t2[..., k]))
    miss = ~(near <= far)
    return np.where(miss, np.nan, near), np.where(miss, np.nan, far)

def hit(s, o, d, least):
    near, far = (hit_sphere if isinstance(s, Sphere) else hit_box)(s, o, d)
    t = np.where(near > least, near, far)
    return np.where(t > least, t, np.inf)

def box_normal(s, p):
    lo, hi = np.array(s.min_pt), np.array(s.max_pt)
    distance = np.abs(np.concatenate([p - lo, p - hi], -1))
    normals = np.concatenate([-np.eye(3), np.eye(3)])
    return normals[distance.argmin(-1)]

def picture(scene):
    cam, W, H, lights = scene.camera, scene.width, scene.height, list(scene.lights)
    surfaces = [s for k, s in enumerate(scene.surfaces) if True]
    eye, forward, up = np.array(cam.view_point), np.array(cam.view_dir), np.array(cam.view_up)
    w = norm(np.array(cam.proj_normal or cam.view_dir)) * -1.0
    if w @ forward > 0:
        w = -w
    u = norm(np.cross(up, w))
    v = np.cross(w, u)
    j, i = np.mgrid[0:H, 0:W]
    x = (i + 0.5) / W - 0.5
    y = 0.5 - (j + 0.5) / H
    middle = cam.proj_distance * norm(forward)
    d = middle + (x * VW)[..., None] * u + (y * VH)[..., None] * v
    d = norm(d)
    best, who = np.full((H, W), np.inf), np.full((H, W), -1)
    for k, s in enumerate(surfaces):
        t = hit(s, eye, d, 1e-9)
        new = t < best
        best[new], who[new] = t[new], k
    image = np.zeros((H, W, 3))
    for k, s in enumerate(surfaces):
        mine = who == k
        p = eye + best[mine][:, None] * d[mine]
        ray, sh = d[mine], s.shader
        n = (p - CENTER) / RADIUS if isinstance(s, Sphere) else box_normal(s, p)
        n = np.where((dot(n, ray) > 0)[:, None], -n, n)
        color = np.zeros(p.shape)
        for number, light in enumerate(lights):
            way = np.array(light.position) - p
            far = np.sqrt(dot(way, way))[:, None]
            l = way / far
            view = -ray
            h = norm(l + view)
            lit = np.ones(len(p), bool)
            for m, other in enumerate(surfaces):
                if m != k:
                    lit &= ~(hit(other, p, way, 1e-7) < 1)
            nl = dot(n, l)[:, None]
            nh = dot(n, h)[:, None]
            see = lit[:, None]
            part = KD * np.maximum(nl, 0)
            if isinstance(sh, Phong):
                shine = np.maximum(nh, 0) ** EXPONENT
                part = part + np.where(nl > 0, KS * shine, 0)
            color += see * part * light.intensity
        image[mine] = color
    return image

def encode(image):
    shown = np.clip(image, 0, 1) ** (1 / 2.2)
    codes = np.floor(255 * shown + 0.5).astype(int).astype(np.uint8)
    return codes
"""
# For each word in capital letters in `SOURCE`: the expression that replaces it.
NAMES = {
    "CENTER": "np.array(s.center)",
    "RADIUS": "s.radius",
    "KD": "np.array(sh.diffuse)",
    "KS": "np.array(sh.specular)",
    "EXPONENT": "sh.exponent",
    "VW": "cam.view_width",
    "VH": "cam.view_height",
}

MISTAKES_FILE = Path(__file__).with_name("student.txt")
# For each keyword of a mistake: pairs of old and new code.
MISTAKES = {
    kind: [change.split(" => ") for change in changes.split(" ; ")]
    for kind, changes in re.findall(r"^([^#].*?): (.*)$", MISTAKES_FILE.read_text(), re.MULTILINE)
}


def srgb(x: Shaped[NDArray[Any], "..."]) -> Shaped[NDArray[Any], "..."]:
    """Return the sRGB codes, between 0 and 1, of linear values `x` between 0 and 1."""
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def source_with(*kinds: str) -> str | None:
    """Return a copy of `SOURCE` with mistakes, which are keys of `MISTAKES`.

    None if two of them change the same place, so that one of them cannot be made.
    """
    source = SOURCE
    for kind in kinds:
        for old, new in MISTAKES[kind]:
            if old not in source:
                return None
            source = source.replace(old, new)
    return source


@np.errstate(all="ignore")
def render_with_source(source: str, scene: Scene) -> Shaped[Codes, "height width 3"]:
    """Render a scene with source code such as `SOURCE`, and return the 8-bit codes.

    Words in capital letters are replaced as in `NAMES`.
    """
    for name, code in NAMES.items():
        source = source.replace(name, code)
    variables: dict[str, Any] = {
        "np": np,
        "Box": Box,
        "Sphere": Sphere,
        "Phong": Phong,
        "srgb": srgb,
    }
    exec(source, variables)
    return np.ascontiguousarray(variables["encode"](variables["picture"](scene)))


def render_mistakes(scene: Scene, *kinds: str) -> Shaped[Codes, "height width 3"] | None:
    """Render a scene with the student's tracer and mistakes; None if `source_with` gives None."""
    source = source_with(*kinds)
    return None if source is None else render_with_source(source, scene)
