"""The uses on a run folder, a map, a frame, a mesh and a mesh with a photo: what is read, made and written."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tspslam import InputError, cli, load_map, load_run
from tspslam.io import read_frame, read_ply, read_vtu, write_frame, write_ply, write_png
from tspslam.io.topological import read_map
from tspslam.run.config import resolve
from tspslam.run.denoise import denoise, describe_change
from tspslam.run.given import open_given
from tspslam.run.pipeline import OnePair, run
from tspslam.run.quality import compare_given
from tspslam.run.segment import find_regions

from ..sequences import SETTINGS, SMALL_RIG, corridor


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "run"
    run(corridor(8.0, SMALL_RIG, exposure=0.1), out, resolve(assignments=SETTINGS))
    return out


@pytest.fixture(scope="module")
def pair_folder(tmp_path_factory, small_pair):
    from tspslam import StereoPair

    out = tmp_path_factory.mktemp("pair") / "pair"
    run(OnePair(StereoPair(*small_pair)), out, resolve())
    return out


def typed(capsys, *words):
    """Exit code, stdout and stderr of a command."""
    code = cli.exit_code([str(word) for word in words])
    said = capsys.readouterr()
    return code, said.out, said.err


def test_a_denoised_map_is_a_map(folder, tmp_path, capsys):
    target = tmp_path / "clean.npz"
    code, out, _ = typed(capsys, "denoise", folder, "--output", target, "--json")
    found, before, after = json.loads(out), load_map(folder), read_map(target)
    assert code == cli.COMPLETE
    assert found["written"] == [str(target)]
    assert found["vertices"] == len(before) == len(after)
    assert np.array_equal(before.surface.faces, after.surface.faces)
    assert not np.array_equal(before.xyz, after.xyz)
    assert not np.array_equal(before.signals.face, after.signals.face)
    assert np.array_equal(before.signals.face_ok, after.signals.face_ok)
    moved = np.linalg.norm(after.xyz - before.xyz, axis=1)
    assert found["moved_m"]["median"] == pytest.approx(np.median(moved))


def test_only_places_or_only_signals_change(folder):
    given = open_given(folder)
    places, signals = denoise(given, signals=False), denoise(given, places=False)
    assert np.array_equal(places.signals.vertex, given.signals.vertex)
    assert np.array_equal(signals.xyz, given.xyz)
    assert np.array_equal(places.xyz, denoise(given).xyz)
    assert np.array_equal(signals.signals.face, denoise(given).signals.face)
    assert describe_change(given, signals)["moved_m"]["largest"] == 0


def test_a_stereo_frame_is_denoised_along_its_rays(pair_folder):
    given = open_given(pair_folder)
    after = denoise(given)
    assert np.array_equal(after.shown.cloud.uv, given.shown.cloud.uv)
    rays = given.xyz / given.xyz[:, 2:]
    assert np.allclose(after.xyz, rays * after.xyz[:, 2:], rtol=1e-9)
    assert (after.xyz[:, 2] != given.xyz[:, 2]).any()


def test_regions_stand_in_the_file_and_on_the_pictures(folder, tmp_path, capsys):
    vtu, png, html = tmp_path / "a.vtu", tmp_path / "a.png", tmp_path / "a.html"
    code, out, _ = typed(capsys, "segment", folder, "--output", vtu, "--plot", png, "--report", html, "--json")
    made, mesh = load_map(folder), read_vtu(vtu)
    region = mesh.cell_data["region"][len(mesh.edges) :]
    assert code == cli.COMPLETE
    assert len(region) == len(made.surface.faces)
    assert json.loads(out)["regions"] == len(np.unique(region))
    assert png.read_bytes()[:4] == b"\x89PNG"
    page = html.read_text("utf-8")
    assert "<span>Regions</span>" in page
    assert "://" not in page.partition("<script")[0]


def test_regions_in_ply_have_colours(folder, tmp_path):
    assert cli.exit_code(["segment", str(folder), "--scale", "2", "--output", str(tmp_path / "a.ply")]) == 0
    face = read_ply(tmp_path / "a.ply").face
    colours = {tuple(each) for each in np.column_stack([face[name] for name in ("region", "red", "green", "blue")])}
    assert len(colours) == len(np.unique(face["region"]))


def test_a_run_is_the_same_as_its_stored_map(folder):
    assert np.array_equal(find_regions(open_given(folder)), find_regions(open_given(folder / "map.npz")))
    assert compare_given(open_given(folder), open_given(folder / "map.vtu")).score < 1e-6


def test_a_noisy_map_scores_worse_than_itself(folder):
    given = open_given(folder)
    noise = np.random.default_rng(0).normal(0, 0.01, given.xyz.shape)
    worse = replace(given, shown=replace(given.shown, xyz=given.xyz + noise))
    far = replace(given, shown=replace(given.shown, xyz=given.xyz + 5 * noise))
    scores = [compare_given(given, each).score for each in (given, worse, far)]
    assert scores[0] == 0
    assert scores == sorted(scores)
    assert scores[1] > 0


def test_one_keyframe_of_a_run_is_taken(folder, tmp_path, capsys):
    index = load_run(folder).keyframes[1]
    target = tmp_path / "frame.npz"
    assert typed(capsys, "denoise", folder, "--frame", index, "--output", target)[0] == 0
    assert read_frame(target).index == index


def test_a_mesh_is_denoised_and_written_as_a_mesh(tmp_path, capsys):
    rng = np.random.default_rng(1)
    u, v = np.meshgrid(np.arange(12.0), np.arange(12.0))
    xyz = np.column_stack([u.ravel(), v.ravel(), rng.normal(5, 0.2, u.size)])
    cell = np.array([12 * j + i for j in range(11) for i in range(11)])
    faces = np.vstack([cell[:, None] + (0, 1, 12), cell[:, None] + (1, 13, 12)])
    lines = [f"v {x} {y} {z}" for x, y, z in xyz] + [f"f {a} {b} {c}" for a, b, c in faces + 1]
    (tmp_path / "part.obj").write_text("\n".join(lines))
    target = tmp_path / "smooth.ply"
    code, out, _ = typed(capsys, "denoise", tmp_path / "part.obj", "--output", target)
    after = read_ply(target)
    assert code == 0
    assert out.startswith(f"wrote {target}\n")
    assert np.array_equal(after.faces, faces)
    assert after.xyz[:, 2].std() < 0.7 * xyz[:, 2].std()
    assert "luminance" not in after.vertex


def test_the_result_is_named_after_its_source(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.exit_code(["denoise", str(folder)]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["run-denoised.vtu"]


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["denoise", "{run}", "--only", "both"], 2, "'both', expected places or signals"),
        (["denoise", "{run}", "--output", "a.stl"], 2, "expected .vtu or .ply or .npz"),
        (["denoise", "{run}", "--output", "{run}/map.vtu"], 3, "lies in the run folder"),
        (["denoise", "{run}", "--bits", "12"], 2, "goes with --image"),
        (["denoise", "{run}", "--image", "a.png"], 2, "goes with --calib"),
        (["denoise", "nowhere"], 3, "nowhere: is not there; expected a run folder"),
        (["denoise", "nowhere.obj"], 3, "nowhere.obj: cannot be opened"),
        (["denoise", "{obj}", "--output", "a.npz"], 3, "a map or a frame alone"),
        (["denoise", "{obj}", "--frame", "3"], 3, "is a file; expected a run folder"),
        (["denoise", "{obj}", "--plot", "a.png"], 2, "goes with a run"),
        (["segment", "{run}", "--scale", "0"], 3, "scale"),
        (["segment", "{run}", "--scale", "nan"], 3, "scale"),
        (["segment", "{run}", "--output", "a.npz"], 2, "expected .vtu or .ply"),
        (["segment", "{run}", "--plot", "a.txt"], 2, "expected .png"),
        (["segment", "{run}", "--frame", "99999"], 3, "99999"),
        (["quality", "{run}", "{obj}"], 3, "part.obj"),
        (["quality", "{obj}", "{obj}"], 3, "part.obj"),
        (["recognise", "{obj}"], 3, "part.obj"),
        (["recognise", "{run}", "--apart", "0"], 2, "--apart"),
    ],
)
def test_what_cannot_be_is_one_line_and_leaves_nothing(words, code, said, folder, tmp_path, monkeypatch, capsys):
    obj = tmp_path / "part.obj"
    obj.write_text("v 0 0 1\nv 1 0 1\nv 0 1 1\nf 1 2 3\n")
    monkeypatch.chdir(tmp_path)
    got, out, err = typed(capsys, *(word.format(run=folder, obj=obj) for word in words))
    assert got == code
    assert out == ""
    assert said in " ".join(err.split())
    assert len(err.strip().splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["part.obj"]


def test_a_photo_without_its_camera_is_refused(tmp_path):
    with pytest.raises(InputError, match="a photo and the calibration of its camera go together"):
        open_given(tmp_path / "a.ply", image="a.png")


def test_a_frame_without_an_image_is_denoised_as_a_mesh(pair_folder, tmp_path):
    seen = replace(open_given(pair_folder).shown, image=None)
    write_frame(tmp_path / "a.npz", seen)
    given = open_given(tmp_path / "a.npz")
    assert given.shown.image is None
    assert denoise(given).xyz.shape == given.xyz.shape


def test_no_landmark_moves_beyond_two_deviations(folder):
    given = open_given(folder)
    sure = replace(given.shown, covariance=np.zeros_like(given.shown.covariance))
    assert np.allclose(denoise(replace(given, shown=sure), signals=False).xyz, given.xyz, rtol=0, atol=1e-9)
    moves = denoise(given, signals=False).xyz - given.xyz
    share = np.einsum("ni,nij,nj->n", moves, np.linalg.inv(given.shown.covariance), moves)
    assert share.max() <= 4 * (1 + 1e-6)
    assert np.median(share) > 1e-3


def test_signals_at_vertices_alone_are_left_as_they_are(folder, tmp_path, capsys):
    assert cli.exit_code(["export", str(folder), "--to", "ply", "--output", str(tmp_path / "a.ply")]) == 0
    mesh = read_ply(tmp_path / "a.ply")
    write_ply(tmp_path / "b.ply", mesh.xyz, mesh.faces, vertex={"luminance": mesh.vertex["luminance"]})
    code, _, err = typed(capsys, "denoise", tmp_path / "b.ply", "--output", tmp_path / "c.ply")
    after = read_ply(tmp_path / "c.ply")
    assert code == 0
    assert "vertices alone" in err
    assert np.array_equal(after.vertex["luminance"], mesh.vertex["luminance"])
    assert not np.array_equal(after.xyz, mesh.xyz)


def test_a_mesh_with_a_photo_is_denoised_and_drawn(tmp_path, capsys):
    rng = np.random.default_rng(2)
    u, v = (each.ravel() for each in np.meshgrid(np.arange(16.0), np.arange(12.0)))
    xyz = np.column_stack([u - 8, v - 6, rng.normal(20, 0.3, u.size)])
    cell = np.array([16 * j + i for j in range(11) for i in range(15)])
    faces = np.vstack([cell[:, None] + (0, 1, 16), cell[:, None] + (1, 17, 16)])
    write_ply(tmp_path / "wall.ply", xyz, faces)
    write_png(tmp_path / "photo.png", rng.integers(0, 255, (120, 160), np.uint8))
    calib = "fx: 150\nfy: 150\ncx: 80\ncy: 60\nbaseline: 0.1\nwidth: 160\nheight: 120\n"
    (tmp_path / "calib.yaml").write_text(calib)
    photo = ("--image", tmp_path / "photo.png", "--calib", tmp_path / "calib.yaml")
    drawn = ("--plot", tmp_path / "a.png", "--report", tmp_path / "a.html")
    code, _, _ = typed(capsys, "denoise", tmp_path / "wall.ply", *photo, *drawn, "--output", tmp_path / "a.vtu")
    assert code == 0
    assert read_vtu(tmp_path / "a.vtu").xyz[:, 2].std() < 0.7 * xyz[:, 2].std()
    assert (tmp_path / "a.png").exists()
    assert (tmp_path / "a.html").exists()
    photo_bytes = (tmp_path / "photo.png").read_bytes()
    onto = ("--plot", tmp_path / "photo.png", "--output", tmp_path / "b.vtu")
    code, _, err = typed(capsys, "segment", tmp_path / "wall.ply", *photo, *onto)
    assert code == cli.BAD_INPUT
    assert "is the input" in err
    assert (tmp_path / "photo.png").read_bytes() == photo_bytes
    assert not (tmp_path / "b.vtu").exists()


def test_noise_that_is_told_is_taken(pair_folder):
    given = open_given(pair_folder)
    strong = denoise(given, places=False, noise=0.2).signals.vertex - given.signals.vertex
    none = denoise(given, places=False).signals.vertex - given.signals.vertex
    assert np.std(strong) > 5 * np.std(none)
    with pytest.raises(InputError, match="noise is -1"):
        denoise(given, noise=-1.0)
