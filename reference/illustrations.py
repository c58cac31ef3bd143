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
from typing import ClassVar
from unittest.mock import patch

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection

from reference.command import HERE, SCENES, make_parser
from reference.judges import certificate
from reference.judges.cells import Cells as CertifiedCells
from reference.judges.forms import Form
from reference.measured.charts import plt
from tracer import Scene, load_scene, render, to_codes
from tracer.antialias.classify import Cells, Classification, classify
from tracer.antialias.edges import silhouette_pixels
from tracer.antialias.lattice import CENTERS, Lattice
from tracer.arrays import Floats, Ints, join_ranges
from tracer.trace.occlusion import build_packet_levels
from tracer.trace.samples import Rows
from tracer.trace.visibility import nearest_hits
from tracer.world.light_grid import LightGrid
from tracer.world.prepared_scene import PreparedScene

_FOLDER = HERE / "study"

# Resolution of the pictures, and width of a picture in inches.
_DOTS_PER_INCH, _WIDTH = 100, 9.0

# Colours of pixels by class: smooth, crossed by straight edges, unresolved.  They stay apart for
# colour-blind eyes.
_CLASS_COLORS = np.array([[0.86, 0.93, 0.98], [0.99, 0.86, 0.6], [0.94, 0.62, 0.5]])


def _load_and_prepare(name: str, width: int) -> tuple[Scene, PreparedScene, Rows]:
    """Load a scene of this project, change the size of its picture, and prepare it for rendering.

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


def _show_picture(axes: Axes, codes: Floats, title: str) -> None:
    """Show a picture in a panel, with one square for each pixel.

    Parameters
    ----------
    axes : Axes
        The panel.
    codes : (height, width, 3) float array
        Colours from 0 to 1.
    title : str
        Title of the panel.
    """
    height, width, _ = codes.shape
    axes.imshow(codes, extent=(0, width, height, 0), interpolation="nearest")
    axes.set(xticks=[], yticks=[], title=title)
    axes.grid(visible=False)


def draw_spans() -> None:
    """Draw the spans of all objects in one row of pixels.  Only rays in spans are tested."""
    scene, prepared, samples = _load_and_prepare("four-spheres", 96)
    row = scene.height // 2
    _, (left, right) = plt.subplots(1, 2, figsize=(_WIDTH, 3.6), width_ratios=(1, 1.6))
    _show_picture(left, to_codes(render(scene, samples=16)) / 255, f"Row {row} of the picture")
    left.axhspan(row, row + 1, fc="none", ec="#d55e00", lw=2)
    ray_count = 0
    for shape in prepared.shapes:
        index, span_row, start, length = samples.sample_spans(shape, prepared)
        kept = np.flatnonzero(span_row == row)
        first_column = start[kept] - row * scene.width
        color = prepared.diffuse[:, index[kept]].T ** (1 / 2.2)
        right.barh(index[kept], length[kept], 0.7, first_column, color=color, ec="k", zorder=2)
        ray_count += int(length[kept].sum())
    count = len(scene.surfaces)
    right.set(yticks=range(count), ylim=(count - 0.5, -0.5), xlim=(0, scene.width))
    right.set(xlabel="column of the pixel", ylabel="object")
    right.set_title(f"Its spans: {ray_count} rays to test, of {count} × {scene.width}")
    _save_figure("spans")


def draw_packets() -> None:
    """Draw the packets (groups of neighbouring hits) in a picture, each in a random colour."""
    scene, prepared, samples = _load_and_prepare("room", 96)
    hits = nearest_hits(prepared, samples)
    frontlit = np.ones((1, hits.sample.size), dtype=np.bool_)
    squares, rows = build_packet_levels(hits, frontlit, None)
    square = np.arange(squares.child_count.size).repeat(squares.child_count)
    _, panels = plt.subplots(1, 3, figsize=(_WIDTH, 2.2))
    _show_picture(panels[0], to_codes(render(scene)) / 255, f"{hits.sample.size:,} hits")
    for panel, packet in zip(panels[1:], (np.arange(square.size), square), strict=True):
        count = packet[-1] + 1
        image = np.ones((samples.size, 3))
        color = np.random.default_rng(3).uniform(0.3, 1, (count, 3))
        # The row packets are sorted by their square packet.
        hit = join_ranges(rows.child_start, rows.child_count)
        image[hits.sample[hit]] = color[packet.repeat(rows.child_count)]
        name = "square" if packet is square else "row"
        _show_picture(panel, image.reshape(scene.height, scene.width, 3), f"{count} {name} packets")
    _save_figure("packets")


def _cell_polygons(grid: LightGrid) -> tuple[Floats, Floats]:
    """Compute the outlines of the cells of a light's grid in the octahedral map of directions.

    The map unfolds all directions to the square from -1 to 1: octants towards positive z fill the
    inner diamond, and the others are folded outwards.

    Parameters
    ----------
    grid : LightGrid
        The grid of a single light.

    Returns
    -------
    polygons : (n, 4, 2) float array
        The four corners (x, y) of each cell.
    lengths : (n,) float array
        Number of objects that are listed in each cell.
    """
    polygons, cells_per_side = [], grid.side
    for octant, patch_index in enumerate(grid.patch.tolist()):
        if patch_index >= 0:
            fraction = np.linspace(0, 1, cells_per_side + 1)
            origin, size = grid.origin[:, patch_index, None], grid.size[:, patch_index, None]
            u, v = np.meshgrid(*(origin + size * fraction))
            # Bit k of `octant` is set where component k of the direction is negative.
            x, y = (1 - v, 1 - u) if octant & 4 else (u, v)
            corner = np.stack([-x if octant & 1 else x, -y if octant & 2 else y], axis=-1)
            cell = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
            polygons.append(np.stack(cell, axis=2).reshape(-1, 4, 2))
    # Each cell has four lists, which follow each other.
    lengths = np.diff(grid.list_start[::4].astype(np.float64))
    return np.concatenate(polygons), lengths


def draw_light_grid() -> None:
    """Draw the grid of directions around a light, coloured by the objects in each cell."""
    scene, prepared, _ = _load_and_prepare("many-objects", 320)
    grid = prepared.prepare_lights(slice(1, 2)).grid
    assert grid is not None
    polygons, lengths = _cell_polygons(grid)
    _, (left, right) = plt.subplots(1, 2, figsize=(_WIDTH, 2.6), width_ratios=(1, 1.1))
    _show_picture(left, to_codes(render(scene)) / 255, f"{len(scene.surfaces)} objects")
    cells = PolyCollection([*polygons], array=lengths, cmap="cividis", ec="w", lw=0.2)
    right.add_collection(cells)
    right.set(xticks=[], yticks=[], title=f"{lengths.size:,} cells around a light")
    right.axis("image")
    plt.colorbar(cells, ax=right, label="objects listed")
    _save_figure("light-grid")


def _clipped_lines(classified: Classification) -> Iterable[Floats]:
    """Clip the lines that divide cells (pixels or parts of pixels) to their cells.

    Parameters
    ----------
    classified : Classification
        The cells, and the straight edges that cross them.

    Yields
    ------
    segment : (2, 2) float array
        Both ends (x, y) of a line in its cell, in pixels.
    """
    cells, lines = classified.cells, classified.lines
    for cell, a, b, c in zip(*lines, strict=True):
        # The line a x + b y + c = 0 meets each of the four sides of the square at most once.
        side = np.array([-0.5, 0.5])
        with np.errstate(all="ignore"):
            ends = [*zip(side, -(c + a * side) / b, strict=True)]
            ends += [*zip(-(c + b * side) / a, side, strict=True)]
        ends_inside = [end for end in ends if np.abs(end).max() <= 0.5 + 1e-9]
        if len(ends_inside) >= 2:
            yield np.array(ends_inside[:2]) + np.array([cells.center_x[cell], cells.center_y[cell]])


def draw_classes() -> None:
    """Draw pixels by class, the edges that cross them, and the positions of their samples."""
    scene, prepared, _ = _load_and_prepare("four-spheres", 64)
    rows, columns = slice(28, 48), slice(20, 48)
    samples, every_pixel = CENTERS.samples(rows, columns), np.arange(20 * 28)
    row, column, object_index = silhouette_pixels(prepared, rows, columns)
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
    segments = [segment - corner for segment in _clipped_lines(classified)]
    right.add_collection(LineCollection(segments, colors="k", lw=1))
    sampled = np.flatnonzero(class_index == 1)
    for point in Lattice(1, 25).points():
        x, y = cells.positions(sampled, np.full(sampled.size, point))
        right.plot(x - corner[0], y - corner[1], ",", color="#0072b2")
    for color, name in zip(_CLASS_COLORS, ("smooth", "straight edges", "other edges"), strict=True):
        right.plot([], [], "s", color=color, markeredgecolor="k", label=name)
    right.legend(loc="upper center", bbox_to_anchor=(0.5, 0), ncols=3)
    _save_figure("classes")


class _RecordingPicture(certificate._Picture):
    """A picture of the certificate that records the cells that are added to it.

    Attributes
    ----------
    squares : list of (3, n) float arrays
        For each call of `add`, rows with the x, the y and the width of the n added cells, in
        pixels.  The list belongs to the class.
    """

    squares: ClassVar[list[Floats]] = []
    """For each call of `add`, the rows x, y and width (3, n) of the cells."""

    def add(self, cells: CertifiedCells, index: Ints, radiance: Form) -> None:
        """Add finished cells to the pixels that they cover, and record their centres and widths.

        Parameters
        ----------
        cells : Cells
            Cells of the picture.
        index : (n,) int array
            Indices of the finished cells in `cells`.
        radiance : Form
            Enclosures (8, 3, n) of the radiance in the finished cells.
        """
        width = np.full(index.size, cells.width)
        self.squares.append(np.array([cells.x[index], cells.y[index], width]))
        super().add(cells, index, radiance)


def draw_certificate() -> None:
    """Draw the cells into which the certificate divides a picture."""
    scene, _, _ = _load_and_prepare("four-spheres", 48)
    with patch.object(certificate, "_Picture", _RecordingPicture):
        proof = certificate.certify(scene, 1 / 256)
    x, y, width = np.concatenate(_RecordingPicture.squares, axis=1)
    corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    squares = np.stack([x, y], axis=-1)[:, None] + width[:, None, None] * corners
    _, (left, right) = plt.subplots(1, 2, figsize=(_WIDTH, 4.7))
    _show_picture(left, to_codes(proof.image) / 255, "Certified within 1/256")
    _show_picture(right, np.ones((scene.height, scene.width, 3)), f"{x.size:,} cells")
    right.add_collection(PolyCollection([*squares], fc="#dbeefb", ec="#0072b2", lw=0.3))
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
    draw_spans()
    draw_packets()
    draw_light_grid()
    draw_classes()
    draw_certificate()
