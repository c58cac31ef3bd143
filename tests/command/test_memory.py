"""Memory: it is used again for the next picture, its peak is bounded, and a lack is reported."""

import gc
import pickle
import platform
import re
import resource
import sys
from pathlib import Path

import numpy as np
import pytest
from probe import scene_of
from running import (
    SCENE,
    file_names,
    needs_processes,
    needs_two,
    peak_memory,
    run,
    write_ball,
)

from tracer import Box, Camera, Phong, PointLight, Sphere, render
from tracer.world.prepared_scene import PreparedScene


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries do as they do")
@pytest.mark.parametrize("samples", [1, 4])
def test_a_second_picture_needs_no_fresh_pages(samples):
    # All pixels are smooth and bright, and the picture is as large as several tiles.
    ball = Sphere(center=(0, -6, -2), radius=6.5, shader=Phong(specular=(0.5, 0.5, 0.5)))
    floor = Box(min_pt=(-50, -1, -50), max_pt=(50, 0, 50))
    camera = Camera(view_point=(0, 2, 6), view_dir=(0, -0.6, -1), view_width=0.4, view_height=0.2)
    scene = scene_of(ball, floor, camera=camera, size=(1024, 768), lights=(3, 5, 4))
    for _ in range(2):
        render(scene, samples=samples)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    image = render(scene, samples=samples)
    fault_count = resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
    # Only memory for the picture itself may be fresh, in large pages or in small ones.
    assert fault_count * resource.getpagesize() < 2 * image.nbytes


@pytest.mark.parametrize("samples", [1, 4])
def test_a_rendered_scene_is_freed_without_garbage_collection(samples):
    """A cycle of references would keep its memory until Python looks for cycles."""
    scene = scene_of(Sphere(center=(0, 0, -3)), size=(40, 30), lights=(3, 4, 5))

    def count_prepared_scenes() -> int:
        return sum(isinstance(instance, PreparedScene) for instance in gc.get_objects())

    gc.collect()
    before = count_prepared_scenes()
    gc.disable()
    try:
        render(scene, samples)
        assert count_prepared_scenes() == before
    finally:
        gc.enable()


RENDER = "import pickle, sys, tracer; tracer.render(*pickle.load(sys.stdin.buffer))"


@pytest.mark.parametrize(("light_count", "samples"), [(3000, 1), (500, 4)])
def test_memory_does_not_increase_with_pairs_of_a_light_and_a_sample(light_count, samples):
    positions = np.random.default_rng(0).normal(0, 9, (light_count, 3))
    lights = [PointLight(position=position, intensity=(1e-3,) * 3) for position in positions]
    scene = scene_of(Sphere(center=(0, 0, -3)), size=(200, 200), lights=lights)
    given = pickle.dumps((scene, samples))
    assert peak_memory(sys.executable, "-c", RENDER, input=given) < 250


TOO_LARGE = "not enough memory; make the image smaller or take fewer samples\n"


@pytest.mark.parametrize(
    ("size", "megabytes", "error"), [((3000, 2000), 4, TOO_LARGE), ((40, 30), 16, "")]
)
def test_a_lack_of_memory_is_reported(tmp_path, size, megabytes, error):
    """The process may use only a few megabytes more than all its modules do."""
    scene = write_ball(tmp_path / "ball.xml", *size)
    script = f"""if True:
        import resource, sys
        from tracer.command.cli import main
        used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + ({megabytes} << 20),) * 2)
        sys.exit(main([sys.argv[1], "--processes", "1"]))
    """
    status, _, err = run(scene, python=("-c", script))
    assert (status, err.partition(": cannot be written: ")[2]) == (1 if error else 0, error)
    assert file_names(tmp_path) == ([] if error else ["ball.xml.png"])


@pytest.mark.parametrize("megabytes", [20, 40])
def test_a_lack_of_memory_for_numpy_is_reported(tmp_path, megabytes):
    """Larger limits are not tested: versions of OpenBLAS never end, or Python fails anywhere."""
    scene = write_ball(tmp_path / "ball.xml", 40, 30)
    limit = megabytes << 20
    status, out, err = run(
        scene, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    )
    assert (status, out, err.count("\n")) == (1, "", 1)
    assert re.match(r"the command cannot start: [^;]*[.]so[^;]*; give it more memory, or", err)
    assert file_names(tmp_path) == []


@needs_two
@needs_processes
@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries do as they do")
def test_a_command_with_workers_takes_little_more_address_space(tmp_path):
    """Otherwise a limit on it would end the command where one process suffices."""
    scene = write_ball(tmp_path / "ball.xml", 800, 600)
    script = """if True:
        import re, sys
        from pathlib import Path
        from tracer.command import cli
        from tracer.picture.parallel import WorkerPool
        WorkerPool.sharing = WorkerPool.sharing._replace(min_seconds=0)
        cli.main(sys.argv[1:])
        has_workers = "concurrent.futures.process" in sys.modules
        status = Path("/proc/self/status").read_text()
        print(re.search("VmPeak:[ \\t]*([0-9]*) kB", status)[1], has_workers)
    """

    def run_with(process_count: int) -> list[str]:
        return run(scene, "--quiet", "--processes", process_count, python=("-c", script))[1].split()

    (peak_alone, has_workers_alone), (peak, has_workers) = run_with(1), run_with(2)
    assert (has_workers_alone, has_workers) == ("False", "True")
    # It takes 2.5 MB more; with stacks of the usual size, 9.6 MB, and with a heap for each thread,
    # 140 MB or more.
    assert int(peak) - int(peak_alone) < 6_000


def test_an_exr_file_needs_twelve_bytes_of_memory_a_pixel(tmp_path):
    scene, (width, height) = tmp_path / "ball.xml", (5000, 4000)
    scene.write_text(SCENE.format(width, height).replace("0 0 5", "0 0 -5"))  # a black picture
    command = [sys.executable, "-m", "tracer", str(scene), "--quiet", "--format"]
    with_exr, with_png = (peak_memory(*command, format_name) for format_name in ("exr", "png"))
    # Modules of OpenEXR take 30 MB.
    assert with_exr - with_png < 12 * width * height / 1e6 + 60


@pytest.mark.slow
@pytest.mark.parametrize("size", [(1 << 28, 1), (1, 1 << 28)], ids=["wide", "high"])
def test_a_picture_as_wide_or_as_high_as_can_be_needs_little_memory(tmp_path, size):
    scene = write_ball(tmp_path / "ball.xml", *size)
    assert peak_memory(sys.executable, "-m", "tracer", str(scene), "--quiet") < 100
    assert Path(f"{scene}.png").stat().st_size > 100_000
