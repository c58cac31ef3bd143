"""Estimate what a million frames would cost on a cluster of computers, and what would break first.

``python -m reference.cluster`` writes `cluster.md` into this folder.  On one computer, it measures
the CPU time of frames, their size in bytes, and the time of Dask's scheduler for each task.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)  # before the other imports: see tracer/command/process.py

import os
from logging import CRITICAL
from time import perf_counter
from typing import NamedTuple

from distributed import Client, LocalCluster

from reference.benchmark import format_section, prepare_animation_commands, run_commands
from reference.command import REFERENCE_FOLDER, build_path, make_parser
from reference.measured.measurements import describe_origin

# Number of frames to render.
_FRAME_COUNT = 1_000_000

# Price of a core for an hour in dollars: an assumption.
_DOLLARS_PER_CORE_HOUR = 0.05

# Memory, in bytes, of the computer that gathers the results: an assumption.
_CLIENT_MEMORY = 16e9

# Number of frames in a larger task, which is proposed as a remedy.
_FRAMES_PER_TASK = 100

# Renderers whose whole CPU time can be measured: keys that `prepare_animation_commands` returns.
_RENDERERS = ("tracer, 1 process", "Mitsuba exact", "Mitsuba stock", "POV-Ray")


class _Measurements(NamedTuple):
    """What was measured on one computer."""

    frame_count: int  # number of frames that were rendered
    size: tuple[int, int]  # width and height of a frame in pixels
    cpu_seconds: dict[str, float]  # mean CPU time of a frame, by the name of the renderer
    png_size: float  # mean size of the tracer's PNG files in bytes
    seconds_per_task: float  # elapsed time of Dask's scheduler for a task


def _measure(frame_count: int, size: tuple[int, int]) -> _Measurements:
    """Render an animation with each renderer that is installed, and run tasks with Dask."""
    commands = prepare_animation_commands(frame_count, size)
    renderers = [name for name in _RENDERERS if name in commands]
    cpu_seconds = {name: _measure_cpu_seconds(commands[name]) / frame_count for name in renderers}
    png_files = [build_path(f"frame-{frame_index}.xml.png") for frame_index in range(frame_count)]
    return _Measurements(
        frame_count=frame_count,
        size=size,
        cpu_seconds=cpu_seconds,
        png_size=sum(path.stat().st_size for path in png_files) / frame_count,
        seconds_per_task=_measure_seconds_per_task(50 * frame_count),
    )


def _measure_cpu_seconds(commands: list[list[str]]) -> float:
    """Run commands one after another, and measure the CPU time of their processes in seconds."""
    times_before = os.times()
    run_commands(commands)
    times_after = os.times()
    user_seconds = times_after.children_user - times_before.children_user
    return user_seconds + times_after.children_system - times_before.children_system


def _measure_seconds_per_task(task_count: int) -> float:
    """Measure the elapsed time that Dask's scheduler takes for a task that does almost nothing.

    It is the mean over `task_count` tasks.  As a warm-up, as many tasks run untimed before them.
    """
    cluster_options = {"threads_per_worker": 1, "dashboard_address": None, "silence_logs": CRITICAL}
    with LocalCluster(1, **cluster_options) as cluster, Client(cluster) as client:
        client.gather(client.map(abs, range(task_count)))
        start_time = perf_counter()
        client.gather(client.map(abs, range(task_count, 2 * task_count)))
        return (perf_counter() - start_time) / task_count


def _format_costs(measured: _Measurements) -> str:
    """Format the section that says what the frames would cost with each renderer."""
    width, height = measured.size
    return format_section(
        "What they would cost",
        f"Measured with {measured.frame_count} frames of {width}×{height}, one sample per pixel:"
        " CPU time for reading scenes, rendering and writing PNG files. POV-Ray starts anew for"
        " each frame; the other programs start once. The price of a core is an assumption. The"
        f" tracer's PNG files take {measured.png_size * _FRAME_COUNT / 1e9:,.0f} GB.",
        ("renderer", "CPU ms per frame", "core hours", f"at ${_DOLLARS_PER_CORE_HOUR} per hour"),
        [_format_cost_row(name, seconds) for name, seconds in measured.cpu_seconds.items()],
    )


def _format_cost_row(name: str, seconds_per_frame: float) -> tuple[str, ...]:
    """Format a renderer's row of the table of costs, from its CPU time for a frame."""
    core_hours = seconds_per_frame * _FRAME_COUNT / 3600
    cost = core_hours * _DOLLARS_PER_CORE_HOUR
    return name, f"{1e3 * seconds_per_frame:.0f}", f"{core_hours:,.0f}", f"${cost:,.2f}"


def _format_limits(measured: _Measurements) -> str:
    """Format the section that says which limits many cores or frames would reach."""
    tracer_seconds = measured.cpu_seconds["tracer, 1 process"]
    # The scheduler is the limit if it takes as long for a frame as all cores together.
    max_cores = tracer_seconds / measured.seconds_per_task
    return format_section(
        "What would break first",
        f"Measured: Dask's scheduler takes {1e3 * measured.seconds_per_task:.2f} ms per task, and a"
        f" PNG file takes {measured.png_size / 1e3:,.0f} kB. Computed: when each limit is reached"
        " with one frame per task.",
        ("limit", "reached with", "remedy"),
        [
            ("the scheduler is too slow for the workers", f"{max_cores:,.0f} cores",
             f"{_FRAMES_PER_TASK} frames per task, for {max_cores * _FRAMES_PER_TASK:,.0f} cores;"
             f" a lost worker then costs {tracer_seconds * _FRAMES_PER_TASK:,.0f} s of CPU time"),
            (f"gathered PNG files fill a memory of {_CLIENT_MEMORY / 1e9:.0f} GB",
             f"{_CLIENT_MEMORY / measured.png_size:,.0f} frames",
             "tasks that write the files themselves"),
            ("a folder has too many files for its file system", "(not measured)",
             "a folder for each thousand frames"),
        ],
    )  # fmt: skip


def main() -> None:
    """Measure the costs and limits of rendering on a cluster; write and print `cluster.md`."""
    arguments = make_parser("reference.cluster", quick_help="few and small frames").parse_args()
    frame_count, size = (3, (320, 180)) if arguments.quick else (40, (1280, 720))
    measured = _measure(frame_count, size)
    origin = f"Written by `python -m reference.cluster`, measured on {describe_origin()}."
    sections = [_format_costs(measured), _format_limits(measured)]
    page = "\n\n".join(["# A million frames on a cluster", origin, *sections]) + "\n"
    page_path = build_path("cluster.md") if arguments.quick else REFERENCE_FOLDER / "cluster.md"
    page_path.write_text(page, encoding="utf-8")
    print(page, end="")
