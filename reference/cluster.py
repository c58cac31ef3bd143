"""Estimate what a million frames would cost on a cluster of computers, and what would break first.

``python -m reference.cluster`` writes `cluster.md` into this folder.  On one computer, it measures
the CPU time of frames, their size in bytes, and the time of Dask's scheduler for each task.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)

import os
from logging import CRITICAL
from time import perf_counter

from distributed import Client, LocalCluster

from reference.benchmark import format_section, run_commands, write_frames_and_commands
from reference.command import HERE, build_path, make_parser
from reference.measured.measurements import describe_origin

_FRAMES = 1_000_000

# Assumptions, which are not measured: the price of a core for an hour in dollars; the memory, in
# bytes, of the computer that gathers the results; and the number of frames in a larger task.
_DOLLARS_PER_CORE_HOUR, _CLIENT_BYTES, _FRAMES_PER_TASK = 0.05, 16e9, 100

# Keys of `write_frames_and_commands` of which all CPU time can be measured.
_RENDERERS = ("tracer, 1 process", "Mitsuba exact", "Mitsuba stock", "POV-Ray")


def _measure_cpu_seconds(commands: list[list[str]]) -> float:
    """Run commands one after the other, and measure their CPU time.

    Parameters
    ----------
    commands : list of lists of str
        For each command, the program and its arguments.

    Returns
    -------
    seconds : float
        CPU time of all processes that the commands started and waited for.
    """
    before = os.times()
    run_commands(commands)
    after = os.times()
    user_seconds = after.children_user - before.children_user
    return user_seconds + after.children_system - before.children_system


def _measure_scheduler_seconds(count: int) -> float:
    """Measure how long Dask's scheduler takes for a task that does nothing.

    Parameters
    ----------
    count : int
        Number of timed tasks.  The same number of tasks runs before, to start the worker.

    Returns
    -------
    seconds : float
        Elapsed time per task.
    """
    options = {"threads_per_worker": 1, "dashboard_address": None, "silence_logs": CRITICAL}
    with LocalCluster(1, **options) as cluster, Client(cluster) as client:
        client.gather(client.map(abs, range(count)))
        start = perf_counter()
        client.gather(client.map(abs, range(count, 2 * count)))
        return (perf_counter() - start) / count


def main() -> None:
    """Measure what limits rendering on a cluster, and write and print the page about its costs."""
    arguments = make_parser("reference.cluster", "few and small frames").parse_args()
    count, size = (3, (320, 180)) if arguments.quick else (40, (1280, 720))
    commands = write_frames_and_commands(count, size)
    names = [name for name in _RENDERERS if name in commands]
    cpu_seconds = {name: _measure_cpu_seconds(commands[name]) / count for name in names}
    hours = {name: seconds * _FRAMES / 3600 for name, seconds in cpu_seconds.items()}
    task_seconds, tracer_seconds = _measure_scheduler_seconds(50 * count), cpu_seconds[names[0]]
    png_bytes = sum(build_path(f"frame-{k}.xml.png").stat().st_size for k in range(count)) / count
    core_count = tracer_seconds / task_seconds
    costs = format_section(
        "What they would cost",
        f"Measured with {count} frames of {size[0]}×{size[1]}, one sample per pixel: CPU time for"
        " reading scenes, rendering and writing PNG files. Programs start once for all frames,"
        " POV-Ray for each. The price of a core is an assumption. The tracer's PNG files have"
        f" {png_bytes * _FRAMES / 1e9:,.0f} GB together.",
        ("renderer", "CPU ms per frame", "core hours", f"at ${_DOLLARS_PER_CORE_HOUR} per hour"),
        [
            (name, f"{1e3 * cpu_seconds[name]:.0f}", f"{hours[name]:,.0f}",
             f"${hours[name] * _DOLLARS_PER_CORE_HOUR:,.2f}")
            for name in cpu_seconds
        ],
    )  # fmt: skip
    batch_size, max_frames = _FRAMES_PER_TASK, _CLIENT_BYTES / png_bytes
    limits = format_section(
        "What would break first",
        f"Measured: Dask's scheduler takes {1e3 * task_seconds:.2f} ms per task, and a PNG file"
        f" has {png_bytes / 1e3:,.0f} kB. Computed: when each limit is reached with one frame per"
        " task.",
        ("limit", "reached with", "remedy"),
        [
            ("the scheduler is too slow for the workers", f"{core_count:,.0f} cores",
             f"{batch_size} frames per task, for {core_count * batch_size:,.0f} cores; a worker"
             f" that dies then costs {tracer_seconds * batch_size:,.0f} s of CPU time"),
            (f"gathered PNG files fill a memory of {_CLIENT_BYTES / 1e9:.0f} GB",
             f"{max_frames:,.0f} frames", "tasks that write their files, and return nothing"),
            ("a folder has too many files for its file system", "(not measured)",
             "a folder for each thousand frames"),
        ],
    )  # fmt: skip
    origin = f"Written by `python -m reference.cluster`, measured on {describe_origin()}."
    text = "\n\n".join(["# A million frames on a cluster", origin, costs, limits]) + "\n"
    path = build_path("cluster.md") if arguments.quick else HERE / "cluster.md"
    path.write_text(text, encoding="utf-8")
    print(text, end="")
