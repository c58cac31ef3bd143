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

from reference.command import REFERENCE_FOLDER, SCENES, make_parser
from reference.judges.certificate import _Picture, certify
from reference.measured.charts import plt
from tracer import Scene, load_scene, render, to_codes
from tracer.antialias.classify import Cells, Classification, classify_cells
from tracer.antialias.edges import find_silhouette_pixels
from tracer.antialias.lattice import PIXEL_CENTERS, Lattice
from tracer.arrays import Floats, join_ranges
from tracer.trace.occlusion import build_packet_levels
from tracer.trace.samples import Rows
from tracer.trace.visibility import find_nearest_hits
from tracer.world.light_grid import LightGrid
from tracer.world.prepared_scene import PreparedScene

_STUDY_FOLDER = REFERENCE_FOLDER / "study"

# Resolution of the pictures, and width of a picture in inches.
_DOTS_PER_INCH, _WIDTH = 100, 9.0

# Colours of pixels by class: smooth, crossed by straight edges, unresolved.  Colour-blind readers
# can tell them apart.
_CLASS_COLORS = np.array([[0.86, 0.93, 0.98], [0.99, 0.86, 0.6], [0.94, 0.62, 0.5]])


def _load_prepared_scene(name: str, width: int) -> tuple[Scene, PreparedScene, Rows]:
    """Load a scene of this project, with a new picture size, and prepare it for rendering.

    Parameters
    ----------
    name : str
        Name of the scene file without its suffix.
    width : int
        Width of the picture in pixels.  The aspect ratio stays the same.

    Returns
    -------
    scene : Scene
        The scene, with the new picture size.
    prepared_scene : PreparedScene
        The same scene, prepared for rendering.
    samples : Rows
        The samples at the centres of all pixels.
    """
    scene = load_scene(SCENES / f"{name}.xml")
    scene = replace(scene, width=width, height=round(width * scene.height / scene.width))
    samples = PIXEL_CENTERS.place_in_pixels(slice(0, scene.height), slice(0, width))
    return scene, PreparedScene(scene), samples


def _show_picture(axes: Axes, colors: Floats, title: str) -> None:
    """Show a picture in a panel of a figure, with each pixel as a square.

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


def draw_spans() -> None:
    """Draw `spans.png`: the spans of all objects in one row of pixels.

    The span of an object is an interval of columns.  Only camera rays in these columns are tested
    against the object.
    """
    scene, prepared_scene, samples = _load_prepared_scene("four-spheres", 96)
    row, object_count, ray_count = scene.height // 2, len(scene.surfaces), 0
    _, (image_axes, spans_axes) = plt.subplots(1, 2, figsize=(_WIDTH, 3.6), width_ratios=(1, 1.6))
    colors = to_codes(render(scene, samples=16)) / 255
    _show_picture(image_axes, colors, f"Row {row} of the picture")
    image_axes.axhspan(row, row + 1, fc="none", ec="#d55e00", lw=2)
    for shape in prepared_scene.shapes:
        fields = samples.find_spans(shape, prepared_scene)
        spans = np.stack([field for field in fields if field is not None])
        object_index, _, span_start, span_length = spans[:, spans[1] == row]
        color = prepared_scene.diffuse[:, object_index].T ** (1 / 2.2)
        first_column = span_start - row * scene.width
        spans_axes.barh(object_index, span_length, 0.7, first_column, color=color, ec="k", zorder=2)
        ray_count += int(span_length.sum())
    spans_axes.set(xlabel="column of the pixel", xlim=(0, scene.width))
    spans_axes.set(ylabel="object", ylim=(object_count - 0.5, -0.5), yticks=range(object_count))
    spans_axes.set_title(f"Its spans: {ray_count} rays to test, of {object_count} × {scene.width}")
    _save_figure("spans")


def draw_packets() -> None:
    """Draw `packets.png`: a picture's packets (groups of neighbouring hits) in random colours."""
    scene, prepared_scene, samples = _load_prepared_scene("room", 96)
    hits = find_nearest_hits(prepared_scene, samples)
    is_facing_light = np.ones((1, hits.sample_index.size), dtype=np.bool_)
    square_level, row_level = build_packet_levels(hits, is_facing_light, None)
    # Sort the hits by row packet, and the row packets by square packet.
    hit_index = join_ranges(row_level.child_count, row_level.child_start)
    row_packet_index = np.arange(row_level.child_count.size).repeat(row_level.child_count)
    square_packet_index = np.arange(square_level.child_count.size).repeat(square_level.child_count)
    _, axes = plt.subplots(1, 3, figsize=(_WIDTH, 2.2))
    _show_picture(axes[0], to_codes(render(scene)) / 255, f"{hits.sample_index.size:,} hits")
    packet_indices = {"row": row_packet_index, "square": square_packet_index[row_packet_index]}
    for packet_axes, (name, packet_index) in zip(axes[1:], packet_indices.items(), strict=True):
        image, packet_count = np.ones((scene.height, scene.width, 3)), packet_index[-1] + 1
        packet_color = np.random.default_rng(3).uniform(0.3, 1, (packet_count, 3))
        image.reshape(-1, 3)[hits.sample_index[hit_index]] = packet_color[packet_index]
        _show_picture(packet_axes, image, f"{packet_count} {name} packets")
    _save_figure("packets")


def _compute_cell_polygons(grid: LightGrid) -> tuple[Floats, Floats]:
    """Compute the outlines of a light grid's cells in the octahedral map of directions.

    The map unfolds all directions into the square from -1 to 1.  The octants with positive z fill
    the inner diamond, and the other octants fill the square's corners.

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
    polygons, fractions = [], np.linspace(0, 1, grid.cells_per_side + 1)
    for octant, patch_index in enumerate(grid.patch_of_octant.tolist()):
        if patch_index >= 0:
            origin, size = grid.patch_origin[:, patch_index], grid.patch_size[:, patch_index]
            # Positions of the grid's lines: u and v are |x| and |y| in the inner diamond.
            u, v = np.meshgrid(*(origin + size * fractions[:, None]).T)
            # Bit k of `octant` is set where component k of the direction is negative.
            x, y = (1 - v, 1 - u) if octant & 4 else (u, v)
            nodes = np.stack([-x if octant & 1 else x, -y if octant & 2 else y], axis=-1)
            cell_corners = nodes[:-1, :-1], nodes[:-1, 1:], nodes[1:, 1:], nodes[1:, :-1]
            polygons.append(np.stack(cell_corners, axis=2).reshape(-1, 4, 2))
    # Each cell has four lists, stored one after another.
    return np.concatenate(polygons), np.diff(grid.list_start.astype(np.float64))


def draw_light_grid() -> None:
    """Draw `light-grid.png`: a light's grid of directions, its cells coloured by object count."""
    scene, prepared_scene, _ = _load_prepared_scene("many-objects", 320)
    grid = prepared_scene.prepare_lights(slice(1, 2)).grid
    assert grid is not None
    polygons, object_count = _compute_cell_polygons(grid)
    _, (image_axes, grid_axes) = plt.subplots(1, 2, figsize=(_WIDTH, 2.6), width_ratios=(1, 1.1))
    _show_picture(image_axes, to_codes(render(scene)) / 255, f"{len(scene.surfaces)} objects")
    cells = PolyCollection([*polygons], array=object_count, cmap="cividis", ec="w", lw=0.2)
    grid_axes.add_collection(cells)
    grid_axes.set(xticks=[], yticks=[], title=f"{object_count.size:,} cells around a light")
    grid_axes.axis("image")
    plt.colorbar(cells, ax=grid_axes, label="objects listed")
    _save_figure("light-grid")


def _clip_lines(classification: Classification) -> Iterable[Floats]:
    """Clip the line along each straight edge to the cell that the edge crosses.

    Parameters
    ----------
    classification : Classification
        The cells (pixels or square parts of them), and the lines along the straight edges in them.

    Yields
    ------
    segment : (2, 2) float array
        The two end points (x, y) of a clipped line, in pixels.
    """
    cells, side_offsets = classification.cells, np.array([-0.5, 0.5])
    for cell_index, a, b, c in zip(*classification.lines, strict=True):
        # The line a x + b y + c = 0 meets each of the cell's four sides at most once.
        crossings = [*zip(side_offsets, -(c + a * side_offsets) / b, strict=True)]
        crossings += [*zip(-(c + b * side_offsets) / a, side_offsets, strict=True)]
        ends = [point for point in crossings if np.abs(point).max() <= 0.5 + 1e-9]
        if len(ends) >= 2:
            yield np.add(ends[:2], (cells.center_x[cell_index], cells.center_y[cell_index]))


def draw_pixel_classes() -> None:
    """Draw `classes.png`: which pixels are smooth, crossed by straight edges, or unresolved."""
    scene, prepared_scene, _ = _load_prepared_scene("four-spheres", 64)
    rows, columns = slice(28, 48), slice(20, 48)
    samples, sample_index = PIXEL_CENTERS.place_in_pixels(rows, columns), np.arange(20 * 28)
    row, column, object_index = find_silhouette_pixels(prepared_scene, rows, columns)
    pixel_index = (row - rows.start) * 28 + column - columns.start
    # The cells are pixels (of width 1), with 4 x 4 samples, and with a tolerance of 1e-3.
    cells = Cells(1.0, 4, 1e-3, *samples.get_positions(sample_index), pixel_index, object_index)
    classification = classify_cells(prepared_scene, cells, samples, sample_index)
    class_index = np.zeros(sample_index.size, dtype=np.intp)
    class_index[classification.lines.cell_index] = 1  # crossed by straight edges
    class_index[classification.is_unresolved] = 2
    _, (image_axes, class_axes) = plt.subplots(1, 2, figsize=(_WIDTH, 4.1))
    _show_picture(image_axes, to_codes(render(scene)[rows, columns]) / 255, "One sample per pixel")
    colors = _CLASS_COLORS[class_index].reshape(20, 28, 3)
    _show_picture(class_axes, colors, "Classes, edges and samples")
    crop_corner = np.array([columns.start, rows.start])
    segments = [segment - crop_corner for segment in _clip_lines(classification)]
    class_axes.add_collection(LineCollection(segments, colors="k", lw=1))
    cell_index = np.flatnonzero(class_index == 1)
    for point in Lattice(1, 25).list_points():
        x, y = cells.to_picture(cell_index, np.full(cell_index.size, point))
        class_axes.plot(x - crop_corner[0], y - crop_corner[1], ",", color="#0072b2")
    for color, name in zip(_CLASS_COLORS, ("smooth", "straight edges", "other edges"), strict=True):
        class_axes.plot([], [], "s", color=color, markeredgecolor="k", label=name)
    class_axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0), ncols=3)
    _save_figure("classes")


def draw_certificate() -> None:
    """Draw `certificate.png`: the cells into which the certificate divides a picture."""
    scene, _, _ = _load_prepared_scene("four-spheres", 48)
    with patch.object(_Picture, "add_cells", autospec=True, side_effect=_Picture.add_cells) as spy:
        certificate = certify(scene, 1 / 256)
    corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    outlines: list[Floats] = []
    for _, cells, cell_index, _ in (call.args for call in spy.call_args_list):
        centers = np.stack([cells.x[cell_index], cells.y[cell_index]], axis=-1)
        outlines += [*(centers[:, None] + cells.width * corners)]
    _, (image_axes, cell_axes) = plt.subplots(1, 2, figsize=(_WIDTH, 4.7))
    _show_picture(image_axes, to_codes(certificate.image) / 255, "Certified within 1/256")
    _show_picture(cell_axes, np.ones((scene.height, scene.width, 3)), f"{len(outlines):,} cells")
    cell_axes.add_collection(PolyCollection(outlines, fc="#dbeefb", ec="#0072b2", lw=0.3))
    _save_figure("certificate")


def _save_figure(name: str) -> None:
    """Save the current figure as a PNG file in the folder of illustrations, and close it."""
    plt.tight_layout()
    plt.savefig(_STUDY_FOLDER / f"{name}.png", dpi=_DOTS_PER_INCH, bbox_inches="tight")
    plt.close()


@np.errstate(all="ignore")  # as the tracer does when it renders
def main() -> None:
    """Draw all illustrations again."""
    make_parser("reference.illustrations").parse_args()
    for draw in (draw_spans, draw_packets, draw_light_grid, draw_pixel_classes, draw_certificate):
        draw()
