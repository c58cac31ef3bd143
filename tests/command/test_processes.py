"""Pictures rendered by several processes: tiles, and the pool of the command."""

import ctypes
import multiprocessing
import os
import pickle
import random
import resource
import signal
import sys
import threading
import time
from collections import deque
from contextlib import closing, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from probe import scene_of, sphere_scene
from running import (
    ROOT,
    needs_processes,
    needs_two,
    run,
    start_process,
    wait_until,
    workers_of,
    write_ball,
)

from tracer import Camera, Sphere, load_scene, render, save_scene
from tracer.command import cli
from tracer.picture import parallel, tiles
from tracer.picture.distribution import Distribution
from tracer.picture.parallel import Threads, WorkerPool
from tracer.picture.png import compress_tile
from tracer.picture.render_job import RenderJob

SCENES = ROOT / "scenes"


@pytest.mark.parametrize("processors", [2, 16])
@pytest.mark.parametrize(
    ("name", "size", "samples"),
    [
        ("one-sphere", (4000, 3000), 1),
        ("room", (1920, 1080), 16),
        ("room", (320, 180), 40_000),
        ("many-objects", (320, 180), 20_000),
        ("room", (40, 30), 999_999_999),
    ],
)
def test_all_processors_have_tiles(processors, name, size, samples, monkeypatch):
    monkeypatch.setattr(tiles, "count_processors", lambda: processors)
    width, height = size
    scene = replace(load_scene(SCENES / f"{name}.xml"), width=width, height=height)
    for sharing in (None, WorkerPool.sharing, Threads.sharing):
        job = RenderJob(scene, samples)
        rectangles = job.work.divide(sharing)
        max_seconds = 0.25 / (1 + samples / 10_000)
        assert len(rectangles) >= min(job.work.seconds / max_seconds, width * height)
        assert len(rectangles) >= min(4 * processors, job.work.seconds / 0.05) or not sharing
        counts = np.zeros((height, width), dtype=int)
        for rectangle in rectangles:
            counts[rectangle] += 1
        assert (counts == 1).all()


def test_the_estimated_time_grows_with_samples_and_lights():
    scene = sphere_scene()
    more_light = replace(scene, lights=[*scene.lights] * 3)
    seconds = RenderJob(scene, 4).work.seconds
    assert RenderJob(scene, 400).work.seconds > 2 * seconds
    assert RenderJob(more_light, 4).work.seconds > 2 * seconds


def test_a_worker_caches_the_jobs_of_several_pictures():
    """Four pictures that are rendered alternately are prepared only once each."""
    jobs = [RenderJob(sphere_scene(), samples) for samples in (1, 4, 9, 16)]
    first, second = ([pickle.loads(pickle.dumps(job)) for job in jobs] for _ in range(2))
    assert [*map(id, first)] == [*map(id, second)]
    assert not {*map(id, first)} & {*map(id, jobs)}


@pytest.mark.parametrize("samples", [1, 4, 30])
def test_the_picture_is_the_same_however_it_is_divided(samples, monkeypatch):
    scene = replace(load_scene(SCENES / "room.xml"), width=16, height=9)
    images = []
    # Each tile is a single pixel, then one or two rows, then the whole picture.
    for seconds in (1e-9, 1e-4, 1):
        monkeypatch.setattr(tiles, "_MAX_TILE_SECONDS", seconds)
        images.append(render(scene, samples))
    assert len(RenderJob(scene, samples).work.divide(None)) == 1
    assert np.array_equal(images[0], images[2])
    assert np.array_equal(images[1], images[2])


def test_a_program_with_threads_is_not_forked():
    """If another thread holds a lock, the lock stays locked in a forked process."""
    wait = threading.Event()
    thread = threading.Thread(target=wait.wait)
    thread.start()
    try:
        executor: Any = WorkerPool(1)._create_executor()
        assert executor._mp_context.get_start_method() == "spawn"
    finally:
        wait.set()
        thread.join()


@pytest.mark.parametrize("y", [-1.5, 1.5])
def test_a_picture_with_some_black_tiles_is_not_black(y, small_tiles, tmp_path, capsys):
    """Either the first tile or the last tile is black."""
    camera = Camera(view_point=(0, 0, 10), view_width=0.6, view_height=0.6)
    scene = scene_of(Sphere(center=(0, y, 0)), camera=camera, size=(90, 90), lights=(3, 4, 9))
    black = [
        not exposure.lit_count for _, exposure in RenderJob(scene).render_tiles(compress_tile, 1)
    ]
    assert black[0] != black[-1]
    save_scene(scene, tmp_path / "scene.xml")
    assert cli.main([str(tmp_path / "scene.xml")]) == 0
    assert capsys.readouterr().err == ""
    render(scene)


def test_leaving_early_drops_the_remaining_items_and_ends_the_pool(small_tiles):
    job = RenderJob(sphere_scene())
    with closing(WorkerPool(1)) as pool:
        work = Distribution(job.render_tile, job.render_tile, 1, pool)
        with closing(work.process(job.work.divide(WorkerPool.sharing))) as results:
            next(results)
            assert multiprocessing.active_children()
        assert (work._waiting, work._futures) == (deque(), {})
    wait_until(lambda: not multiprocessing.active_children())


def limit_processes(limit: int) -> None:
    """Limit the number of processes and threads of this process's user.

    Call this in a child process, as its `preexec_fn`.  The limit does not apply to root, so root
    becomes a new user, who may still read all files.
    """
    resource.setrlimit(resource.RLIMIT_NPROC, (limit, limit))
    if os.getuid() == 0:
        drop_capability = 24  # PR_CAPBSET_DROP in prctl(2)
        for capability in (21, 24):  # CAP_SYS_ADMIN, CAP_SYS_RESOURCE
            ctypes.CDLL(None).prctl(drop_capability, capability, 0, 0, 0)
        os.setresuid(random.randrange(100_000, 200_000), 0, 0)


@pytest.mark.parametrize(
    ("options", "count"), [([], 3), (["--processes", "2"], 2), (["--processes", "9"], 3)]
)
def test_the_number_of_processes_is_at_most_that_of_processors(
    options, count, monkeypatch, tmp_path
):
    counts, start_batch = [], cli.Batch

    def record_batch(settings, process_count):
        counts.append(process_count)
        return start_batch(settings, 1)

    monkeypatch.setattr(cli, "count_processors", lambda: 3)
    monkeypatch.setattr(cli, "Batch", record_batch)
    assert cli.main([str(write_ball(tmp_path / "ball.xml", 4, 3)), "--quiet", *options]) == 0
    assert counts == [count]


@needs_two
@pytest.mark.skipif(sys.platform != "linux", reason="other systems have other limits")
@pytest.mark.parametrize("limit", range(1, 7))
def test_few_processes(limit, tmp_path):
    """The system allows fewer processes and threads than the pool needs."""
    path = write_ball(tmp_path / "ball.xml", 2800, 2400)
    limited = partial(limit_processes, limit)
    assert run(path, "--quiet", "--processes", 2, preexec_fn=limited) == (0, "", "")


def is_running(process_id: int) -> bool:
    """Test whether a process with this id exists."""
    return Path(f"/proc/{process_id}").exists()


@needs_two
@needs_processes
@pytest.mark.parametrize(
    "seeds",
    [
        range(5),
        *(pytest.param(range(k, k + 25), marks=pytest.mark.slow) for k in (5, 30)),
    ],
    ids=lambda seeds: f"from-{seeds[0]}",
)
@pytest.mark.parametrize(
    "sizes", [[(2800, 2400)], [(440 - 10 * k, 400) for k in range(40)]], ids=["large", "many"]
)
def test_a_lost_worker_costs_time_not_the_picture(sizes, seeds, tmp_path):
    """Kill or stop all workers at random moments, while they render one picture or many."""
    paths = [write_ball(tmp_path / f"{width}.xml", width, height) for width, height in sizes]

    def read_and_remove_pictures() -> list[bytes]:
        """Read the 8-bit codes of all pictures, and remove the files."""
        codes = []
        for path in paths:
            with Image.open(picture_path := Path(f"{path}.png")) as picture:
                codes.append(picture.tobytes())
            picture_path.unlink()
        return codes

    start = time.monotonic()
    assert run(*paths, "--quiet", "--processes", 1)[0] == 0
    seconds, lost_count, expected = time.monotonic() - start, 0, read_and_remove_pictures()
    for seed in seeds:
        rng = random.Random(seed)
        with start_process(*paths, "--processes", 2) as process:
            wait_until(lambda p=process: p.poll() is not None or bool(workers_of(p)))
            time.sleep(rng.random() * seconds / 2)
            workers = workers_of(process)
            for worker in workers:
                with suppress(ProcessLookupError):
                    os.kill(worker, rng.choice([signal.SIGKILL, signal.SIGSTOP]))
            out, err = process.communicate(timeout=120)
        assert (process.returncode, err, out.count("\n")) == (0, "", len(paths))
        assert read_and_remove_pictures() == expected
        wait_until(lambda ids=workers: not any(map(is_running, ids)))
        lost_count += len(workers)
    assert lost_count >= len(seeds) / 5


@needs_two
@needs_processes
def test_workers_end_with_a_command_that_is_killed(tmp_path):
    path = write_ball(tmp_path / "large.xml", 6000, 5000)
    with start_process(path, "--quiet", "--processes", 2) as process:
        wait_until(lambda: bool(workers_of(process)))
        workers = workers_of(process)
        process.kill()
        assert process.communicate(timeout=60) == ("", "")
    wait_until(lambda: not any(map(is_running, workers)))
    assert [path.name for path in tmp_path.iterdir()] == ["large.xml"]


def test_processors_are_those_that_may_be_used():
    usable = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(usable)})
    try:
        assert parallel.count_processors() == 1
    finally:
        os.sched_setaffinity(0, usable)
    assert parallel.count_processors() == len(usable)
