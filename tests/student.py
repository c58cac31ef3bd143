"""A tracer as a student writes it, and mistakes: changes of one or two places in its source.

The tests search for the mistakes with `reference.handins.formulas`, with which the source shares no
code.
"""

import numpy as np

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

# One mistake in each line: its keyword, a colon, and replacements "old => new" in `SOURCE`,
# separated by " ; ".
TABLE = r"""
projNormal-ignored: cam.proj_normal or cam.view_dir => cam.view_dir
viewUp-ignored: np.array(cam.view_up) => np.array((0.0, 1, 0))
viewDir-length: cam.proj_distance * norm(forward) => cam.proj_distance * forward
projDistance-ignored: cam.proj_distance * norm => 1 * norm
window-exchanged: * VW => * V_ ; * VH => * VW ; V_ => VH
viewHeight-ignored: * VH => * VW
window-ignored: * VW => * 1 ; * VH => * 1
pixel-upper-left: (i + 0.5) => i ; (j + 0.5) => j
shift-right: (i + 0.5) => (i - 0.5)
shift-left: (i + 0.5) => (i + 1.5)
shift-up: (j + 0.5) => (j + 1.5)
shift-down: (j + 0.5) => (j - 0.5)
shift-right-down: (i + 0.5) => (i - 0.5) ; (j + 0.5) => (j - 0.5)
size-minus-1: (i + 0.5) / W => i / (W - 1) ; (j + 0.5) / H => j / (H - 1)
mirrored: return codes => return codes[:, ::-1]
flipped: return codes => return codes[::-1]
hit-last: new = t < best => new = np.isfinite(t)
hit-farthest: new = t < best => new = np.isfinite(t) & (t > np.where(who < 0, -1, best))
root-far-all: np.where(near > least, near, far) => far
missing-sphere: if True => if isinstance(s, Box)
missing-box: if True => if isinstance(s, Sphere)
missing-surface-1: if True => if k != 1
radius-halved: RADIUS => (s.radius / 2)
radius-squared: RADIUS => (s.radius ** 2)
normal-length-sphere: (p - CENTER) / RADIUS => p - CENTER
normal-inwards: -n, n) => n, -n)
normal-center-box-turned: else box_normal(s, p) => else norm(p - np.add(s.min_pt, s.max_pt) / 2)
l-length: l = way / far => l = way
l-position: l = way / far => l = norm(np.array(light.position) + 0 * p)
l-reversed: l = way / far => l = -way / far
shadow-none: if m != k => if False
shadow-none-sphere: if m != k => if m != k and isinstance(other, Box)
shadow-none-box: if m != k => if m != k and isinstance(other, Sphere)
shadow-none-surface-0: if m != k => if m != k and m != 0
shadow-none-light-0: if m != k => if m != k and number != 0
shadow-from-behind: way, 1e-7) < 1) => way, 1e-7) < np.inf)
shadow-epsilon-.1: hit(other, p, way, 1e-7) < 1 => hit(other, p, l, 0.1) < far[:, 0]
shadow-diffuse: KD * np.maximum(nl, 0) => KD * np.maximum(nl, 0) * see ; see * part => part
light-missing-0: list(scene.lights) => list(scene.lights)[1:]
light-first: list(scene.lights) => list(scene.lights)[:1]
light-last: list(scene.lights) => list(scene.lights)[-1:]
light-average: part * light.intensity => part * light.intensity / len(lights)
intensity-ignored: part * light.intensity => part
falloff-1: part * light.intensity => part * light.intensity / far
falloff-2: part * light.intensity => part * light.intensity / far ** 2
nl-unclipped: KD * np.maximum(nl, 0) => KD * nl
nl-absolute-diffuse: KD * np.maximum(nl, 0) => KD * np.abs(nl)
nl-missing: KD * np.maximum(nl, 0) => KD + 0 * nl
diffuse-none: KD * np.maximum(nl, 0) => 0 * nl
diffuse-ignored: KD => 1.0
colors-exchanged: part + np.where(nl > 0, KS => KS * np.maximum(nl, 0) + np.where(nl > 0, KD
specular-none: if isinstance(sh, Phong) => if False
specular-ignored: KS => 1.0
specular-diffuse: KS => KD
h-length: h = norm(l + view) => h = l + view
h-light: h = norm(l + view) => h = l
h-difference: h = norm(l + view) => h = norm(l - view)
v-viewDir: view = -ray => view = -norm(forward)
v-position: view = -ray => view = norm(eye)
v-length: view = -ray => view = eye - p
reflection: nh = dot(n, h) => nh = dot(2 * nl * n - l, view)
exponent-1: EXPONENT => 1
exponent-halved: EXPONENT => (sh.exponent / 2)
exponent-times-4: EXPONENT => (4 * sh.exponent)
lobe-back: np.where(nl > 0, KS * shine, 0) => KS * shine
lobe-times-nl: KS * shine => KS * shine * nl
ambient-.1: color = np.zeros(p.shape) => color = 0.1 * KD + 0 * p
unshaded: image[mine] = color => image[mine] = KD
clipped-per-light: see * part * light.intensity => np.clip(see * part * light.intensity, 0, 1)
wrapped: np.clip(image, 0, 1) => np.maximum(image, 0)
whole-numbers: np.clip(image, 0, 1) => np.floor(np.clip(image, 0, 1))
gamma-none: np.clip(image, 0, 1) ** (1 / 2.2) => np.clip(image, 0, 1)
gamma-twice: (1 / 2.2) => (1 / 2.2 ** 2)
gamma-inverse: (1 / 2.2) => 2.2
gamma-srgb: np.clip(image, 0, 1) ** (1 / 2.2) => srgb(np.clip(image, 0, 1))
levels-truncated: 255 * shown + 0.5 => 255 * shown
channels-BGR: return codes => return codes[..., ::-1]
background: image = np.zeros((H, W, 3)) => image = np.zeros((H, W, 3)) + (0.1, 0.2, 0.5)
exponent-whole: EXPONENT => int(sh.exponent)
light-assigned: color += see * part => color = color * ~see + see * part
light-running-sum: color += see => color = color * (1 + (number > 0)) + see
shadow-resets: color += see * part => color = see * color + see * part
levels-before-gamma: np.clip(image, 0, 1) ** => (np.floor(255 * np.clip(image, 0, 1)) / 255) **
window-of-2: * VW => * 2 ; * VH => * 2 * H / W
row-last-missing: return codes => codes[-1] = 0; return codes
rows-even-only: return codes => codes[1::2] = 0; return codes
shift-left-up: (i + 0.5) => (i + 1.5) ; (j + 0.5) => (j + 1.5)
shift-left-down: (i + 0.5) => (i + 1.5) ; (j + 0.5) => (j - 0.5)
shift-right-up: (i + 0.5) => (i - 0.5) ; (j + 0.5) => (j + 1.5)
"""
# For each keyword of a mistake: pairs of old and new code.
MISTAKES = {
    kind: [change.split(" => ") for change in changes.split(" ; ")]
    for kind, changes in (line.split(": ", 1) for line in TABLE.strip().splitlines())
}


def srgb(x):
    """Return the sRGB codes, between 0 and 1, of linear values `x` between 0 and 1."""
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def source_with(*kinds: str) -> str | None:
    """Return the source code of the student's tracer with mistakes.

    Parameters
    ----------
    *kinds : str
        The mistakes, as keys of `MISTAKES`.

    Returns
    -------
    source : str or None
        A copy of `SOURCE` with all replacements of these mistakes.  It is None if two mistakes
        change the same place, so that one of them cannot be made.
    """
    source = SOURCE
    for kind in kinds:
        for old, new in MISTAKES[kind]:
            if old not in source:
                return None
            source = source.replace(old, new)
    return source


@np.errstate(all="ignore")
def render_with_source(source: str, scene: Scene):
    """Render a scene with the source code of a tracer.

    Parameters
    ----------
    source : str
        Source code such as `SOURCE`.  Words in capital letters are replaced as in `NAMES`.
    scene : Scene
        The scene.

    Returns
    -------
    codes : (height, width, 3) uint8 array
        The picture, gamma-encoded.
    """
    for name, code in NAMES.items():
        source = source.replace(name, code)
    variables = {"np": np, "Box": Box, "Sphere": Sphere, "Phong": Phong, "srgb": srgb}
    exec(source, variables)
    return np.ascontiguousarray(variables["encode"](variables["picture"](scene)))


def render_mistakes(scene: Scene, *kinds: str):
    """Render a scene with the student's tracer, into which mistakes are inserted.

    Parameters
    ----------
    scene : Scene
        The scene.
    *kinds : str
        The mistakes, as keys of `MISTAKES`.

    Returns
    -------
    codes : (height, width, 3) uint8 array, or None
        The picture, gamma-encoded.  It is None if two mistakes change the same place of the source.
    """
    source = source_with(*kinds)
    return None if source is None else render_with_source(source, scene)
