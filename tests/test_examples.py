"""The example files run from any folder, without a warning, and print what they promise."""

import importlib
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from .patience import PATIENCE

EXAMPLES = Path(__file__).parents[1] / "examples"
BENCHMARKS = EXAMPLES.with_name("benchmarks")


def run_example(name, folder, *arguments):
    """What the example prints when it runs in `folder`; warnings are errors."""
    done = subprocess.run(
        [sys.executable, "-W", "error", str(EXAMPLES / name), *map(str, arguments)],
        cwd=folder, env=os.environ | {"PYTHONIOENCODING": "utf-8"}, capture_output=True, encoding="utf-8", timeout=PATIENCE,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def numbers(text, start):
    """The numbers of the one line that starts with `start`, after it."""
    (line,) = [line for line in text.splitlines() if line.startswith(start)]
    return [float(number) for number in re.findall(r"-?\d+\.?\d*(?:e[-+]\d+)?", line.removeprefix(start))]


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.name)
def test_examples_are_short(path):
    lines = path.read_text(encoding="utf-8").splitlines()
    assert len([line for line in lines if line]) < {"04": 105, "ro": 90}.get(path.name[:2], 60)


def test_one_call_writes_pictures_and_agrees_with_the_measured_disparities(tmp_path):
    printed = run_example("01_one_call.py", tmp_path, tmp_path / "pictures")
    (points,) = numbers(printed, "points:")
    error_px, below_one_px, limit_px = numbers(printed, "disparity error:")
    edges, faces = numbers(printed, "complex:")
    defined, magnitude = numbers(printed, "response:")
    assert points > 500
    assert error_px < 0.3
    assert below_one_px > 85
    assert limit_px == 1
    assert points < faces < edges < 3 * points
    assert 0.9 * points < defined <= points
    assert magnitude > 0
    pictures = list((tmp_path / "pictures").glob("*.png"))
    assert numbers(printed, "pictures:")[0] == len(pictures) > 0


def test_parts_can_be_exchanged_and_only_the_published_sum_answers_to_a_constant_image(tmp_path):
    printed = run_example("02_parts.py", tmp_path)
    points, faces, responses = numbers(printed, "walk:")
    fewer_points, fewer_faces, order = numbers(printed, "exchanged:")
    assert 0 < responses <= points < faces
    assert fewer_points < points
    assert fewer_faces < faces
    assert order == 2
    assert 0 < numbers(printed, "two rings:")[0] < 90
    ratios = {
        name: numbers(printed, f"constant image, centering={name}:")[0]
        for name in ("none", "mean", "harmonic", "plane")
    }
    assert ratios["none"] > 0.3
    assert ratios["mean"] == ratios["harmonic"] == ratios["plane"] == 0


def test_kernels_give_the_torus_and_the_ramps_their_closed_forms(tmp_path):
    printed = run_example("03_kernels.py", tmp_path)
    (sizes,) = [line for line in printed.splitlines() if line.startswith("torus:")]
    assert sizes == "torus: N=20000 E=60000 F=40000, Euler 0"
    assert numbers(printed, "B1 B2: largest entry")[0] == 0
    assert numbers(printed, "neighbours of vertex 0:") == [6, 12, 6]
    assert all(numbers(printed, f"order {order}: median |r|")[0] > 0 for order in range(4))
    assert numbers(printed, "phase: red") == [0, 90]
    slope, *_, blue = numbers(printed, "slope: red")
    assert slope == pytest.approx(1 / 512, abs=1e-6)
    assert blue < 1e-12
    assert 0 < numbers(printed, "time:")[0] < 1000


def test_a_torus_has_the_two_harmonic_flows_that_two_fields_give(tmp_path):
    printed = run_example("05_flows_on_a_torus.py", tmp_path)
    assert "cycles=2" in printed.splitlines()[0]
    shares = {name: numbers(printed, f"{name}:") for name in ("along", "around", "down")}
    assert all(abs(sum(parts) - 100) < 0.2 for parts in shares.values())
    assert shares["along"][2] > 90
    assert shares["around"][2] > 99
    assert shares["down"][0] > 99  # the gradient of -z
    rest, count = numbers(printed, "rest of the basis:")
    assert rest < 1e-9
    assert count == 2


def test_a_network_is_trained_on_all_levels_and_on_vertices_alone(tmp_path):
    pytest.importorskip("torch", reason="PyTorch is not installed: the worked example needs it")
    printed = run_example("04_train_a_network.py", tmp_path)
    (vertices, *_), (levels, *_) = (numbers(printed, f"{name}:") for name in ("vertices only", "all levels"))
    assert 40 < vertices <= 100
    assert 40 < levels <= 100
    assert printed.splitlines()[-1].startswith("all levels ")


@pytest.mark.parametrize("name", sorted(path.stem for path in BENCHMARKS.glob("*.py") if path.stem != "__main__"))
def test_a_benchmark_finds_what_it_measures(name):
    """Names that it takes from the package and from the tests; the figures themselves are for `make bench`."""
    if name == "bundle_gtsam":
        pytest.importorskip("gtsam", reason="GTSAM is not installed: the comparison with it needs it")
    importlib.import_module(f"benchmarks.{name}")


def test_one_map_of_a_room_takes_all_tools(tmp_path):
    printed = run_example("06_one_map.py", tmp_path, tmp_path / "pictures")
    vertices, faces, keyframes = numbers(printed, "map:")
    views, unseen = numbers(printed, "views of a face:")
    defined, spread = numbers(printed, "directions:")
    (noise,) = numbers(printed, "luminance of a face differs by")
    parts, loops = numbers(printed, "holes:")
    polygons, of_faces, luminance = numbers(printed, "cells:")
    assert vertices < faces < 2 * vertices
    assert keyframes >= 5
    assert views >= 2
    assert unseen < 15
    assert defined > 85
    assert spread < 15
    assert 0 < noise < 0.02
    assert parts >= 1
    assert loops >= 0
    assert of_faces == faces > 4 * polygons
    assert 0.2 < luminance < 0.8
    assert numbers(printed, "pictures:")[0] == len(list((tmp_path / "pictures").glob("*.png"))) == 4


def test_a_run_is_watched_and_what_it_left_is_read_back(tmp_path):
    for _ in range(2):  # the second time all is there
        printed = run_example("08_look.py", tmp_path, tmp_path / "kept")
        stages = re.findall(r"^stage (\w+):", printed, re.MULTILINE)
        assert stages[:2] == ["tracking", "adjustment"]
        assert printed.count("status: complete, 13 of 13 frames tracked\n") == 1
        faces, keyframes = numbers(printed, "map:")
        assert faces > 1000
        assert keyframes >= 5
        assert numbers(printed, "path: off by")[0] < 0.05
        assert numbers(printed, "pictures:")[0] == 13
    assert stages == ["tracking", "adjustment"]
    assert (tmp_path / "kept" / "run" / "report.html").stat().st_size > 100_000
