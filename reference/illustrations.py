"""Draw the illustrations of study.md again: ``python -m reference.illustrations``.

Each picture shows one data structure of the tracer, as the tracer itself computes it for a scene of
this project.  Only the colours and the frames are added here.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)

from collections.abc import Iterable
from dataclasses import replace
from unittest.mock import patch

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection

from reference.command import HERE, SCENES, make_parser
from reference.judges import certificate
from reference.measured.charts import plt
from tracer import Scene, load_scene, render, to_codes
from tracer.antialias.classify import Cells, Classification, classify
from tracer.antialias.edges import find_silhouette_pixels
from tracer.antialias.lattice import CENTERS, Lattice
from tracer.arrays import Floats, join_ranges
from tracer.trace.occlusion import build_packet_levels
from tracer.trace.samples import Rows
from tracer.trace.visibility import find_nearest_hits
from tracer.world.light_grid import LightGrid
from tracer.world.prepared_scene import PreparedScene

_FOLDER = HERE / "study"

# Resolution of the pictures, and width of a picture in inches.
_DOTS_PER_INCH, _WIDTH = 100, 9.0

# Colours of pixels by class: smooth, crossed by straight edges, unresolved.  They stay apart for
# colour-blind eyes.
_CLASS_COLORS = np.array([[0.86, 0.93, 0.98], [0.99, 0.86, 0.6], [0.94, 0.62, 0.5]])


def _load_and_prepare(name: str, width: int) -> tuple[Scene, PreparedScene, Rows]:
    """Load a scene of this project with a picture of another width, and prepare it for rendering.

    Parameters
    ----------
    name : str
        Name of the scene file without its suffix.
    width : int
        Width of the picture in pixels.  The ratio of width and height stays the same.

    Returns
    -------
    scene : Scene
        The scene, with the picture's new size.
    prepared : PreparedScene
        The scene, prepared for its camera.
    samples : Rows
        The samples through the centres of all pixels.
    """
    scene = load_scene(SCENES / f"{name}.xml")
    scene = replace(scene, width=width, height=round(width * scene.height / scene.width))
    return scene, PreparedScene(scene), CENTERS.samples(slice(0, scene.height), slice(0, width))


def _show_picture(axes: Axes, colors: Floats, title: str) -> None:
    """Show a picture in a panel of a figure, with one square for each pixel.

    Parameters
    ----------
    axes : Axes
        The panel.
    colors : (height, width, 3) float array
        Colours from 0 to 1.
    title : str
        Title of the panel.
    """
    height, width, _ = colors.shape
    axes.imshow(colors, extent=(0, width, height, 0), interpolation="nearest")
    axes.set(xticks=[], yticks=[], title=title)
    axes.grid(visible=False)


def draw_spans() -> None:
    """Draw the spans (intervals of columns) of all objects in one row of a picture's pixels.

    Only camera rays in an object's span are tested against the object.
    """
    scene, prepared, samples = _load_and_prepare("four-spheres", 96)
    row, count, ray_count = scene.height // 2, len(scene.surfaces), 0
    _, (left, right) = plt.subplots(1, 2, figsize=(_WIDTH, 3.6), width_ratios=(1, 1.6))
    _show_picture(left, to_codes(render(scene, samples=16)) / 255, f"Row {row} of the picture")
    left.axhspan(row, row + 1, fc="none", ec="#d55e00", lw=2)
    for shape in prepared.shapes:
        object_index, span_row, start, length = samples.find_spans(shape, prepared)
        kept = np.flatnonzero(span_row == row)
        object_index, length = object_index[kept], length[kept]
        color = prepared.diffuse[:, object_index].T ** (1 / 2.2)
        first_column = start[kept] - row * scene.width
        right.barh(object_index, length, 0.7, first_column, color=color, ec="k", zorder=2)
        ray_count += int(length.sum())
    right.set(yticks=range(count), ylim=(count - 0.5, -0.5), xlim=(0, scene.width))
    right.set(xlabel="column of the pixel", ylabel="object")
    right.set_title(f"Its spans: {ray_count} rays to test, of {count} × {scene.width}")
    _save_figure("spans")


def draw_packets() -> None:
    """Draw the packets (groups of neighbouring hits) in a picture, each in a random colour."""
    scene, prepared, samples = _load_and_prepare("room", 96)
    hits = find_nearest_hits(prepared, samples)
    frontlit = np.ones((1, hits.sample.size), dtype=np.bool_)
    squares, rows = build_packet_levels(hits, frontlit, None)
    # The hits sorted by row packet, and the row packets sorted by square packet.
    hit = join_ranges(rows.child_start, rows.child_count)
    row_packet = np.arange(rows.child_count.size).repeat(rows.child_count)
    square_packet = np.arange(squares.child_count.size).repeat(squares.child_count)[row_packet]
    _, panels = plt.subplots(1, 3, figsize=(_WIDTH, 2.2))
    _show_picture(panels[0], to_codes(render(scene)) / 255, f"{hits.sample.size:,} hits")
    packets = {"row": row_packet, "square": square_packet}
    for panel, (name, packet) in zip(panels[1:], packets.items(), strict=True):
        image, count = np.ones((samples.size, 3)), packet[-1] + 1
        image[hits.sample[hit]] = np.random.default_rng(3).uniform(0.3, 1, (count, 3))[packet]
        _show_picture(panel, image.reshape(scene.height, scene.width, 3), f"{count} {name} packets")
    _save_figure("packets")


def _cell_polygons(grid: LightGrid) -> tuple[Floats, Floats]:
    """Compute the outlines of a light grid's cells in the octahedral map of directions.

    The map unfolds all directions to the square from -1 to 1.  Octants towards positive z fill the
    inner diamond, and the others are folded outwards.

    Parameters
    ----------
    grid : LightGrid
        The grid of a single light.

    Returns
    -------
    polygons : (n, 4, 2) float array
        The four corners (x, y) of each cell.
    object_count : (n,) float array
        Number of objects listed in each cell.
    """
    polygons, fraction = [], np.linspace(0, 1, grid.side + 1)
    for octant, patch_index in enumerate(grid.patch.tolist()):
        if patch_index >= 0:
            origin, size = grid.origin[:, patch_index, None], grid.size[:, patch_index, None]
            u, v = np.meshgrid(*(origin + size * fraction))
            # Bit k of `octant` is set where component k of the direction is negative.
            x, y = (1 - v, 1 - u) if octant & 4 else (u, v)
            corner = np.stack([-x if octant & 1 else x, -y if octant & 2 else y], axis=-1)
            cell = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
            polygons.append(np.stack(cell, axis=2).reshape(-1, 4, 2))
    # Each cell has four lists, which follow each other.
    return np.concatenate(polygons), np.diff(grid.list_start[::4].astype(np.float64))


def draw_light_grid() -> None:
    """Draw the grid of directions around a light, coloured by the number of objects per cell."""
    scene, prepared, _ = _load_and_prepare("many-objects", 320)
    grid = prepared.prepare_lights(slice(1, 2)).grid
    assert grid is not None
    polygons, object_count = _cell_polygons(grid)
    _, (left, right) = plt.subplots(1, 2, figsize=(_WIDTH, 2.6), width_ratios=(1, 1.1))
    _show_picture(left, to_codes(render(scene)) / 255, f"{len(scene.surfaces)} objects")
    cells = PolyCollection([*polygons], array=object_count, cmap="cividis", ec="w", lw=0.2)
    right.add_collection(cells)
    right.set(xticks=[], yticks=[], title=f"{object_count.size:,} cells around a light")
    right.axis("image")
    plt.colorbar(cells, ax=right, label="objects listed")
    _save_figure("light-grid")


def _clip_lines(classified: Classification) -> Iterable[Floats]:
    """Clip straight edges to the cells (pixels or parts of pixels) that they cross.

    Parameters
    ----------
    classified : Classification
        The cells, and the lines along the edges.

    Yields
    ------
    segment : (2, 2) float array
        Both ends (x, y) of a line's part in its cell, in pixels.
    """
    cells, side = classified.cells, np.array([-0.5, 0.5])
    for cell, a, b, c in zip(*classified.lines, strict=True):
        # The line a x + b y + c = 0 meets each of the four sides of the square at most once.
        ends = [*zip(side, -(c + a * side) / b, strict=True)]
        ends += [*zip(-(c + b * side) / a, side, strict=True)]
        ends_inside = [end for end in ends if np.abs(end).max() <= 0.5 + 1e-9]
        if len(ends_inside) >= 2:
            yield np.array(ends_inside[:2]) + np.array([cells.center_x[cell], cells.center_y[cell]])


def draw_classes() -> None:
    """Draw pixels coloured by class, the edges that cross them, and their samples."""
    scene, prepared, _ = _load_and_prepare("four-spheres", 64)
    rows, columns = slice(28, 48), slice(20, 48)
    samples, every_pixel = CENTERS.samples(rows, columns), np.arange(20 * 28)
    row, column, object_index = find_silhouette_pixels(prepared, rows, columns)
    pixel = (row - rows.start) * 28 + column - columns.start
    cells = Cells(1.0, 4, 1e-3, *samples.positions(every_pixel), pixel, object_index)
    classified = classify(prepared, cells, samples, every_pixel)
    class_index = np.zeros(every_pixel.size, dtype=np.intp)
    class_index[classified.lines.cell] = 1
    class_index[classified.is_unresolved] = 2
    _, (left, right) = plt.subplots(1, 2, figsize=(_WIDTH, 4.1))
    _show_picture(left, to_codes(render(scene)[rows, columns]) / 255, "One sample per pixel")
    colors = _CLASS_COLORS[class_index].reshape(20, 28, 3)
    _show_picture(right, colors, "Classes, edges and samples")
    corner = np.array([columns.start, rows.start])
    segments = [segment - corner for segment in _clip_lines(classified)]
    right.add_collection(LineCollection(segments, colors="k", lw=1))
    sampled = np.flatnonzero(class_index == 1)
    for point in Lattice(1, 25).points():
        x, y = cells.positions(sampled, np.full(sampled.size, point))
        right.plot(x - corner[0], y - corner[1], ",", color="#0072b2")
    for color, name in zip(_CLASS_COLORS, ("smooth", "straight edges", "other edges"), strict=True):
        right.plot([], [], "s", color=color, markeredgecolor="k", label=name)
    right.legend(loc="upper center", bbox_to_anchor=(0.5, 0), ncols=3)
    _save_figure("classes")


def draw_certificate() -> None:
    """Draw the cells into which the certificate divides a picture."""
    scene, _, _ = _load_and_prepare("four-spheres", 48)
    picture_class = certificate._Picture
    with patch.object(picture_class, "add", autospec=True, side_effect=picture_class.add) as add:
        proof = certificate.certify(scene, 1 / 256)
    corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    squares: list[Floats] = []
    for _, cells, index, _ in (call.args for call in add.call_args_list):
        center = np.stack([cells.x[index], cells.y[index]], axis=-1)
        squares += [*(center[:, None] + cells.width * corners)]
    _, (left, right) = plt.subplots(1, 2, figsize=(_WIDTH, 4.7))
    _show_picture(left, to_codes(proof.image) / 255, "Certified within 1/256")
    _show_picture(right, np.ones((scene.height, scene.width, 3)), f"{len(squares):,} cells")
    right.add_collection(PolyCollection(squares, fc="#dbeefb", ec="#0072b2", lw=0.3))
    _save_figure("certificate")


def _save_figure(name: str) -> None:
    """Write the current figure to the folder of illustrations as NAME.png, and close it."""
    figure = plt.gcf()
    figure.tight_layout()
    figure.savefig(_FOLDER / f"{name}.png", dpi=_DOTS_PER_INCH, bbox_inches="tight")
    plt.close(figure)


@np.errstate(all="ignore")  # as the tracer does when it renders
def main() -> None:
    """Draw all illustrations and write them to the folder of the study."""
    make_parser("reference.illustrations").parse_args()
    for draw in (draw_spans, draw_packets, draw_light_grid, draw_classes, draw_certificate):
        draw()
