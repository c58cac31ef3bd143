"""Processes that help from one picture to the next."""

from __future__ import annotations

import os
import pickle
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, suppress
from dataclasses import replace
from functools import partial
from mmap import mmap
from pathlib import Path

import numpy as np
import pytest
from jobs import SHAPE, add, die, fail, here, refuse

import tracer.picture.helpers
from tracer import Box, Camera, Lambertian, PointLight, Scene, Sphere, render
from tracer.picture.helpers import Job, helped, received
from tracer.picture.workers import AHEAD, Numbers, Team
from tracer.scene.model import Surfaces


@pytest.fixture(autouse=True)
def crew(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """No helpers before or after; they find this module."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    tracer.picture.helpers._crew.stop()
    yield
    tracer.picture.helpers._crew.stop()


def together(
    amount: float, others: int = 1, count: int = 40, wait: bool = True, load: float = np.inf
) -> list[int]:
    """Do the job, again until all others take part if we `wait`; which process did what."""
    for _ in range(100):
        with helped(count, others, Job(partial(add, amount), SHAPE), load) as team:
            who = []
            for number, result in enumerate(team.results(here(add(amount)))):
                assert result[0, 0] == number + amount
                who.append(int(result[0, 1]))
        if not wait or len(set(who)) > others:
            return who
    pytest.fail("no helper took part")


@pytest.mark.parametrize("others", [1, 2])
def test_helpers_stay(others: int) -> None:
    first = set(together(0.5, others))
    assert len(first) == others + 1
    assert os.getpid() in first
    for amount in range(5):
        assert set(together(amount, others, wait=False)) == first


def test_nobody_waits_for_a_helper_to_start() -> None:
    assert set(together(0.5, count=2, wait=False)) == {os.getpid()}


def test_a_late_helper_joins() -> None:
    assert len(set(together(0.5, count=400, wait=False))) == 2


def test_a_program_with_many_open_files() -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    files = [os.open(os.devnull, os.O_RDONLY) for _ in range(1024)]
    try:
        assert len(set(together(0.5))) == 2
    finally:
        for file in files:
            os.close(file)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="no system with helpers")
def test_no_help_where_there_is_one_processor() -> None:
    code = """if True:
        import os, sys, tracer, tracer.picture.helpers
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
        scene = tracer.Scene(camera=tracer.Camera(), width=4000, height=2500)
        for _ in range(3):
            tracer.render(scene)
        sys.exit(len(tracer.picture.helpers._crew._helpers))
    """
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_one_picture_at_a_time_has_help() -> None:
    with helped(8, 1, Job(partial(add, 1), SHAPE), np.inf) as team:
        assert len(team.workers) == 1
        with helped(8, 1, Job(partial(add, 2), SHAPE), np.inf) as other:
            assert not other.workers
            assert [a[0, 0] for a in other.results(here(add(2)))] == list(range(2, 10))
        assert [a[0, 0] for a in team.results(here(add(1)))] == list(range(1, 9))


def test_a_failing_helper_is_replaced() -> None:
    before = set(together(0.5))
    job = Job(fail, SHAPE)
    with pytest.raises(MemoryError, match="too little"), helped(200, 1, job, np.inf) as team:
        list(team.results(here(add(0))))
    after = set(together(0.5))
    assert len(after) == 2
    assert before & after == {os.getpid()}


@pytest.mark.parametrize(("others", "first"), [(1, 0), (2, 8)])
def test_a_helper_that_is_killed_is_done_without(others: int, first: int, tmp_path: Path) -> None:
    before = set(together(0.5, others))
    job = Job(partial(die, first, tmp_path / "died"), SHAPE)
    with helped(40, others, job, np.inf) as team:
        results = [a[0, 0] for a in team.results(here(add(0)))]
    assert (tmp_path / "died").exists()
    assert results == list(range(40))
    # Nor does what the others were at come into the next picture.
    after = set(together(0.25, others))
    assert len(after) == others + 1
    assert before & after == {os.getpid()}


def test_a_helper_that_cannot_do_the_job() -> None:
    before = set(together(0.5))
    with helped(8, 1, Job(refuse, SHAPE), np.inf) as team:
        assert [a[0, 0] for a in team.results(here(add(0)))] == list(range(8))
    assert set(together(0.5)) == before


@pytest.mark.parametrize("place", ["__main__", "nowhere"])
def test_a_scene_of_which_a_helper_does_not_know_all(
    place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Red(Lambertian):
        """It can be pickled only if it is found where it says to be."""

    Red.__module__, Red.__qualname__ = place, "Red"
    monkeypatch.setattr(sys.modules["__main__"], "Red", Red, raising=False)
    before = set(together(0.5))
    scene = replace(picture(300, 200), surfaces=(Sphere(shader=Red(diffuse=(1, 0, 0))),))
    alone = render(scene, processes=1)
    for _ in range(3):
        assert np.array_equal(render(scene, processes=2), alone)
    assert set(together(0.5)) == before


def test_a_helper_that_was_killed_meanwhile_is_replaced() -> None:
    before = set(together(0.5))
    (helper,) = before - {os.getpid()}
    os.kill(helper, signal.SIGKILL)
    time.sleep(0.05)
    after = set(together(0.5))
    assert len(after) == 2
    assert helper not in after


def test_leaving_early_ends_helpers() -> None:
    before = set(together(0.5))
    with suppress(KeyboardInterrupt), helped(20, 1, Job(partial(add, 0), SHAPE), np.inf) as team:
        next(team.results(here(add(0))))
        raise KeyboardInterrupt
    assert set(together(0.5)) & before == {os.getpid()}


def test_a_job_that_is_over() -> None:
    job, memory, numbers = Job(partial(add, 0.5), SHAPE), mmap(-1, 1 << 13), Numbers()
    packed = pickle.dumps(job)
    memory[-len(packed) :] = packed
    numbers.begin(1)
    message = numbers.round, len(packed)
    work = received(message, Numbers(numbers.file), memory)
    assert work is not None
    # All of the job has been copied.
    memory[:] = bytes(len(memory))
    assert work(7) == 0
    assert (job.slots(memory)[0] == (7.5, os.getpid(), 0)).all()
    assert not job.slots(memory)[1:].any()
    memory[-len(packed) :] = packed
    numbers.begin(1)
    assert received(message, Numbers(numbers.file), memory) is None
    os.close(numbers.file)


def test_it_must_pay_to_start_one() -> None:
    def workers(load: float) -> int:
        with helped(8, 1, Job(partial(add, 0), SHAPE), load) as team:
            list(team.results(here(add(0))))
        return len(team.workers)

    tracer.picture.helpers._crew._load = 0.0
    enough = tracer.picture.helpers._START
    assert [workers(0.4 * enough) for _ in range(4)] == [0, 0, 1, 1]


def test_without_memory_to_share(monkeypatch: pytest.MonkeyPatch) -> None:
    def none(_: str) -> int:
        raise OSError("too many open files")

    with monkeypatch.context() as patched:
        patched.setattr(os, "memfd_create", none)
        assert set(together(0.5, wait=False)) == {os.getpid()}
    too_much = tracer.picture.helpers._SHARED
    add_0, add_more = partial(add, 0), partial(add, bytes(too_much))
    for job in (Job(add_0, (AHEAD, too_much)), Job(add_more, SHAPE)):
        with helped(8, 1, job, np.inf) as team:
            assert not team.workers
    assert len(set(together(0.5))) == 2


@pytest.mark.parametrize("count", range(12))
def test_nothing_is_left_of_a_helper_that_cannot_be_had(
    count: int, files_left: Callable[[int], AbstractContextManager[None]]
) -> None:
    tracer.picture.helpers._crew.forget()
    with files_left(count):
        assert set(together(0.5, count=2, wait=False)) == {os.getpid()}
        tracer.picture.helpers._crew.stop()
        tracer.picture.helpers._crew.forget()


@pytest.mark.parametrize("name", ["python3", "a-program-of-its-own"])
def test_a_helper_that_cannot_start(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / name
    program.write_text(f"#!/bin/sh\ntouch {tmp_path}/started\nexit 1\n")
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    assert set(together(0.5, count=100, wait=False)) == {os.getpid()}
    assert set(together(0.5, wait=False)) == {os.getpid()}
    assert (tmp_path / "started").exists() == (name == "python3")
    # Nor is another started, or a zombie left, unless it pays again.
    assert set(together(0.5, wait=False, load=tracer.picture.helpers._START / 2)) == {os.getpid()}
    assert not tracer.picture.helpers._crew._helpers
    with pytest.raises(ChildProcessError):
        os.waitpid(-1, os.WNOHANG)


def test_a_helper_has_the_same_tracer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "tracer.py").write_text("raise ImportError('another one')\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert len(set(together(0.5, count=400, wait=False))) == 2


def test_a_fork_has_helpers_of_its_own() -> None:
    before = set(together(0.5))
    reading, writing = os.pipe()
    pid = os.fork()
    if not pid:
        os.write(writing, " ".join(map(str, set(together(0.5)))).encode())
        os._exit(0)
    os.waitpid(pid, 0)
    theirs = {int(part) for part in os.read(reading, 100).split()}
    assert len(theirs) == 2
    assert pid in theirs
    assert not theirs & before
    assert set(together(1.5)) == before


def test_helpers_end_with_their_process() -> None:
    code = (
        f"import sys; sys.path[:0] = {[str(Path(__file__).parent)]!r}\n"
        "import os, signal, test_helpers\n"
        "print(*set(test_helpers.together(0.5)) - {os.getpid()}, flush=True)\n"
        "if len(sys.argv) > 1: os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    for arguments in ([], ["killed"]):
        run = [sys.executable, "-W", "error", "-c", code, *arguments]
        done = subprocess.run(run, capture_output=True, text=True, check=False)
        assert not done.stderr
        helper = int(done.stdout)
        deadline = time.monotonic() + 10
        while Path(f"/proc/{helper}").exists():
            assert time.monotonic() < deadline
            time.sleep(0.02)


def picture(width: int, height: int) -> Scene:
    """A sphere, in all of the picture but its corners."""
    return Scene(
        camera=Camera(view_point=(0, 0, 4), proj_distance=4, view_width=2.2, view_height=2.2),
        width=width,
        height=height,
        lights=(PointLight(position=(1, 2, 3)), PointLight(position=(3, 2, 3))),
        surfaces=(Sphere(),),
    )


def test_surfaces_arrive_as_they_were() -> None:
    sent = Surfaces.of((Box(min_pt=(1, 2, 3), max_pt=(4, 5, 6)), Sphere(center=(1, 0, 2))))
    surfaces: Surfaces = pickle.loads(pickle.dumps(sent))
    assert tuple(surfaces) == tuple(sent)
    # The data types are NumPy's own: with equal ones, `minimum.at` is twenty times as slow.
    for name in ("center", "radius", "min_pt", "max_pt"):
        assert getattr(surfaces, name).dtype is np.dtype(np.float64)
    for name in ("sphere_index", "box_index", "sphere_shader", "box_shader"):
        assert getattr(surfaces, name).dtype is np.dtype(np.intp)


@pytest.mark.parametrize("samples", [1, 4])
def test_pictures_with_help(samples: int, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = picture(300, 200)
    alone = render(scene, samples, processes=1)
    together(0.5)  # from here on there is one
    assert np.array_equal(render(scene, samples, processes=2), alone)
    monkeypatch.setattr(tracer.picture.rendering, "_BAND_SAMPLES", 1000)
    parts = tracer.picture.rendering._Picture.of(scene, samples)
    assert tracer.picture.rendering._Bands.of(parts, 2).total > 10
    assert np.array_equal(render(scene, samples, processes=2), alone)


def test_pictures_in_threads() -> None:
    scenes = [picture(200 + k, 100) for k in range(4)]
    alone = [render(scene, processes=1) for scene in scenes]
    wrong: list[int] = []

    def draw(k: int) -> None:
        pictures = [render(scenes[k], processes=2) for _ in range(10)]
        wrong.extend(k for image in pictures if not np.array_equal(image, alone[k]))

    together(0.5)
    threads = [threading.Thread(target=draw, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


@pytest.mark.parametrize(("threads", "others"), [(2, 1), (3, 2), (6, 2)])
def test_every_processor_that_is_asked_for(
    threads: int, others: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And no more than there are."""
    monkeypatch.setattr(tracer.picture.rendering, "processors", lambda: 3)
    teams: list[Team] = []
    scene = picture(200, 300)
    original = Team.results
    try:
        Team.results = lambda self, work: teams.append(self) or original(self, work)  # type: ignore
        image = render(scene, processes=threads)
    finally:
        Team.results = original  # type: ignore[method-assign]
    assert [len(team.workers) for team in teams] == [others]
    assert np.array_equal(image, render(scene, processes=1))


def test_helpers_have_room_for_the_largest_bands() -> None:
    pixels = tracer.picture.rendering._BAND_SAMPLES * tracer.picture.rendering._SPLIT_BANDS
    assert AHEAD * pixels * 3 * 8 <= tracer.picture.helpers._SHARED // 2
