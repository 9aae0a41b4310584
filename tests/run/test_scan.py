"""``filter --cloud`` and ``scans``: signals of a photo, or of keyframes, where they see a scan, and marks elsewhere."""

import json

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import maximum_filter
from typer.testing import CliRunner

from tspslam import InputError, cli, datasets, load_run
from tspslam.datasets import synthetic
from tspslam.datasets.synthetic.scanner import AXES
from tspslam.io import read_frame, read_map
from tspslam.run.config import resolve
from tspslam.run.pipeline import run as run_pipeline
from tspslam.run.scan import filter_scan
from tspslam.run.scans import map_scans
from tspslam.topology.harmonic import Tmahf
from tspslam.vision.calibration.formats.own import save_cameras

from ..sequences import SETTINGS, SMALL_RIG, corridor, write_sequence

SCANNER = synthetic.Scanner(beams=32, columns=720, lowest=-35, highest=25)
T_CAMERA_SCAN = AXES.copy()
T_CAMERA_SCAN[:3, 3] = 0.1, -0.4, -0.2


def paint(xyz):
    """Luminance of every place of the world: smooth, so that pixels between tell it."""
    x, y, z = np.moveaxis(np.asarray(xyz), -1, 0)
    return 0.5 + 0.15 * np.sin(1.5 * x + 0.4) + 0.15 * np.sin(1.2 * y) + 0.15 * np.sin(0.9 * z)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Files of a scan and a photo of one place in a corridor; the truth of the photo."""
    folder = tmp_path_factory.mktemp("scan")
    empty = synthetic.corridor(4.0)
    plate = synthetic.plane(1.0, 1.0).at(0.1, 0.3, 3.5)  # two metres before the camera
    world = synthetic.Scene((*empty.shapes, plate), empty.path)
    sequence = synthetic.SyntheticSequence(world, SMALL_RIG)
    depth = sequence.geometry(3).depth
    v, u = np.mgrid[: SMALL_RIG.height, : SMALL_RIG.width]
    rays = np.stack([(u - SMALL_RIG.cx) / SMALL_RIG.fx, (v - SMALL_RIG.cy) / SMALL_RIG.fy, np.ones(u.shape)], axis=-1)
    photo = np.nan_to_num(paint(depth[..., None] * rays))
    Image.fromarray(np.round(65535 * photo).astype(np.uint16)).save(folder / "photo.png")
    save_cameras(SMALL_RIG, folder / "calib.yaml")
    echoes = synthetic.scan(world, world.path[3] @ T_CAMERA_SCAN, SCANNER)
    write_scan(folder / "scan.bin", echoes.xyz)
    (folder / "extrinsics.yaml").write_text(f"T_camera_scan: {T_CAMERA_SCAN.tolist()}\n")
    return folder, depth


def write_scan(path, xyz):
    np.column_stack([xyz, np.ones(len(xyz))]).astype("<f4").tofile(path)


def filtered(folder, out, scan="scan.bin", **given):
    given = {"extrinsics": folder / "extrinsics.yaml"} | given
    return filter_scan(folder / scan, folder / "photo.png", folder / "calib.yaml", out, Tmahf(), **given)


@pytest.fixture(scope="module")
def frame(made, tmp_path_factory):
    out = tmp_path_factory.mktemp("out") / "run"
    result = filtered(made[0], out)
    assert result.run["status"] == "complete"
    assert result.run["warnings"] == []
    assert result.run["scan"]["rings"] == 32
    assert (out / "map.vtu").exists()
    return read_frame(out / "frames/000000.npz")


def test_signals_are_what_is_painted_where_the_camera_sees(made, frame):
    xyz, ok = frame.cloud.xyz, frame.signals.vertex_ok
    assert ok.sum() > 1000
    off = np.abs(frame.signals.vertex[ok] - paint(xyz[ok]))
    assert np.median(off) < 0.002
    assert np.quantile(off, 0.95) < 0.02  # the rest are at outlines, where a pixel beside shows what is behind
    complex_, signals = frame.complex_, frame.signals
    inside = signals.face_ok & (signals.face_pixels > 0)
    middles = xyz[complex_.faces].mean(axis=1)
    assert np.median(np.abs(signals.face[inside] - paint(middles[inside]))) < 0.01
    assert frame.response.defined.sum() > 500


def test_points_that_the_camera_does_not_see_are_marked(made, frame):
    """The scanner stands above the camera and looks over a plate: the depth behind each pixel tells who is hidden."""
    depth, (x, y, z) = made[1], frame.cloud.xyz.T
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = SMALL_RIG.fx * x / z + SMALL_RIG.cx, SMALL_RIG.fy * y / z + SMALL_RIG.cy
    inside = (z > 0) & (u >= 0) & (u <= SMALL_RIG.width - 1) & (v >= 0) & (v <= SMALL_RIG.height - 1)
    assert not frame.signals.vertex_ok[~inside].any()
    rows = np.flatnonzero(inside)
    column, row = np.round(u[rows]).astype(int), np.round(v[rows]).astype(int)
    step = np.radians(60 / 31) * SMALL_RIG.fx  # px between rings: the plate's faces end with its last points
    hidden = z[rows] > 1.3 * maximum_filter(depth, 2 * int(1.2 * step) + 1)[row, column]
    at = depth[row, column]
    assert hidden.sum() > 20
    assert frame.signals.vertex_ok[rows[hidden]].mean() < 0.1
    seen = np.abs(z[rows] / at - 1) < 0.01
    assert frame.signals.vertex_ok[rows[seen]].mean() > 0.97


def test_equal_input_gives_equal_bytes_with_any_number_of_threads(made, frame, tmp_path):
    from tspslam import set_threads

    files = []
    for count in (1, 2):
        set_threads(count)
        filtered(made[0], tmp_path / f"{count}")
        files.append((tmp_path / f"{count}/map.vtu").read_bytes())
    set_threads(None)
    assert files[0] == files[1]


def test_a_scan_in_another_frame_is_told(made, tmp_path):
    folder, _ = made
    with pytest.raises(InputError) as caught:
        filtered(folder, tmp_path / "run", extrinsics=None)
    assert "points are in the image: is the scan in another frame?; expected T_camera_scan" in str(caught.value)


def test_few_points_in_the_image_are_doubted_and_dropped_rows_told(made, tmp_path):
    folder, _ = made
    rows = np.fromfile(folder / "scan.bin", "<f4").reshape(-1, 4)
    behind = rows[rows[:, 0] < 0]
    ahead = rows[(rows[:, 0] > 2) & (np.abs(rows[:, 1]) < 1.0) & (np.abs(rows[:, 2] + 0.4) < 0.3)][:50]
    many = np.concatenate([behind, ahead, np.zeros((3 * len(rows), 4), np.float32)])
    many.astype("<f4").tofile(folder / "few.bin")
    run = filtered(folder, tmp_path / "run", "few.bin").run
    said = {each["code"]: each["message"] for each in run["warnings"]}
    assert "fewer than 1%" in said["scan_outside"]
    assert f"{3 * len(rows)} of {len(many)} rows" in said["scan_dropped"]


@pytest.mark.parametrize(("share", "is_said"), [(0.03, True), (0.001, False)])
def test_points_farther_than_a_scanner_measures_are_told(made, tmp_path, share, is_said):
    folder, _ = made
    rows = np.fromfile(folder / "scan.bin", "<f4").reshape(-1, 4)
    far = rows[np.random.default_rng(0).random(len(rows)) < share] * np.float32([1000, 1000, 1000, 1])
    np.concatenate([rows, far]).tofile(folder / "far.bin")
    run = filtered(folder, tmp_path / "run", "far.bin").run
    said = {each["code"]: each["message"] for each in run["warnings"]}
    assert ("scan_far" in said) == is_said
    if is_said:
        assert f"{(np.linalg.norm(far[:, :3], axis=1) > 2000).sum()} of {len(rows) + len(far)}" in said["scan_far"]
        assert "is it in another unit?" in said["scan_far"]


def test_crust_is_another_surface_and_settings_are_checked(made, tmp_path):
    folder, _ = made
    ball = synthetic.sphere(1.0, rows=16).vertices
    write_scan(folder / "ball.bin", np.unique(ball.round(6), axis=0) @ AXES[:3, :3] + (4, 0, 0))
    run = filtered(folder, tmp_path / "ball", "ball.bin", surface="crust").run
    assert run["complex"]["euler"] == 2
    with pytest.raises(InputError, match="surface is 'poisson', expected range or crust"):
        filtered(folder, tmp_path / "other", surface="poisson")


def test_the_command_does_so_too(made, tmp_path):
    folder, _ = made
    words = ["filter", "--image", str(folder / "photo.png"), "--calib", str(folder / "calib.yaml"), "--out"]
    scan = ["--cloud", str(folder / "scan.bin"), "--extrinsics", str(folder / "extrinsics.yaml")]
    found = CliRunner().invoke(cli.app, [*words, str(tmp_path / "run"), *scan, "--json"])
    assert found.exit_code == 0
    assert json.loads(found.stdout)["scan"]["rings"] == 32
    for given, said in (
        ([], "expected a MESH or --cloud"),
        (["mesh.ply", *scan], "expected a MESH or --cloud"),
        ([*scan, "--merge-corners"], "goes with a mesh"),
        (["mesh.ply", *scan[2:]], "goes with --cloud"),
        ([*scan, "--surface", "poisson"], "expected range or crust"),
    ):
        refused = CliRunner().invoke(cli.app, [*words, str(tmp_path / "none"), *given])
        assert refused.exit_code == 2
        assert said in refused.output


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A run, and scans along it."""
    folder = tmp_path_factory.mktemp("drive")
    sequence = corridor(4.0, SMALL_RIG)
    write_sequence(folder / "sequence", sequence)
    run_pipeline(datasets.open_sequence(folder / "sequence"), folder / "run", resolve(assignments=SETTINGS))
    for k in (1, 4, 7):
        echoes = synthetic.scan(sequence.scene, sequence.truth[k] @ T_CAMERA_SCAN, SCANNER)
        write_scan(folder / f"{k:06d}.bin", echoes.xyz)
    (folder / "extrinsics.txt").write_text("\n".join(" ".join(map(repr, row)) for row in T_CAMERA_SCAN.tolist()))
    return folder, sequence


def scans_of(folder):
    return sorted(folder.glob("00*.bin"))


def test_scans_along_a_run_are_one_complex_with_signals(drive):
    folder, sequence = drive
    found = map_scans(folder / "run", scans_of(folder), folder / "extrinsics.txt")
    made = found.map_
    assert found.unplaced == []
    assert found.points > len(made)
    seen = made.signals.vertex_ok
    assert seen.sum() > 1000
    assert not seen.all()  # behind the first frame nobody has looked
    assert made.defined.sum() > 500
    assert (made.view_count.face > 1).any()
    floor = made.xyz[np.abs(made.xyz[:, 1] - 1.4) < 0.05]
    assert len(floor) > 500  # at its height above the world's first camera
    # luminance is that of the images: of the keyframe of the best view, at the place it sees
    k = int(np.bincount(made.best_view.vertex[seen]).argmax())
    rows = np.flatnonzero(made.best_view.vertex == k)
    pose = made.T_world_camera[k]
    x, y, z = ((made.xyz[rows] - pose[:3, 3]) @ pose[:3, :3]).T
    u, v = SMALL_RIG.fx * x / z + SMALL_RIG.cx, SMALL_RIG.fy * y / z + SMALL_RIG.cy
    image = sequence[int(made.keyframes[k])].left / 255.0
    values = image[np.round(v).astype(int), np.round(u).astype(int)]
    assert np.corrcoef(values, made.signals.vertex[rows])[0, 1] > 0.85


def test_stamps_place_scans_between_frames(drive, tmp_path):
    folder, _ = drive
    stored = load_run(folder / "run")
    times = stored.trajectory.stamp
    (tmp_path / "stamps.txt").write_text(
        "".join(f"{times[k]!r}\n".replace("np.float64(", "").replace(")", "") for k in (1, 4, 7))
    )
    by_name = map_scans(folder / "run", scans_of(folder), folder / "extrinsics.txt").map_
    by_time = map_scans(
        folder / "run", scans_of(folder), folder / "extrinsics.txt", stamps=tmp_path / "stamps.txt"
    ).map_
    np.testing.assert_allclose(by_time.xyz, by_name.xyz, atol=1e-9)


@pytest.mark.parametrize(
    ("stamps", "said"),
    [
        ("1\n", "has 1 times for 3 scans"),
        ("1\n2\nnan\n", "not finite"),
        ("1 2\n", "line 1 has 2 values"),
        ("900\n901\n902\n", "has no pose for any of 3 scans"),
    ],
)
def test_bad_stamps_are_refused(drive, tmp_path, stamps, said):
    folder, _ = drive
    (tmp_path / "stamps.txt").write_text(stamps)
    with pytest.raises(InputError, match=said):
        map_scans(folder / "run", scans_of(folder), folder / "extrinsics.txt", stamps=tmp_path / "stamps.txt")


def test_scans_in_another_unit_are_told(drive, tmp_path):
    folder, _ = drive
    first, *others = scans_of(folder)
    rows = np.fromfile(first, "<f4").reshape(-1, 4)
    (tmp_path / first.name).write_bytes(np.concatenate([rows, rows * np.float32([1000, 1000, 1000, 1])]).tobytes())
    found = map_scans(folder / "run", [tmp_path / first.name, *others], folder / "extrinsics.txt")
    (said,) = found.doubts
    assert said.startswith(str(tmp_path / first.name))
    assert "over 2000 m from the scanner" in said


def test_scans_without_a_place_are_told(drive, tmp_path):
    folder, _ = drive
    run, extrinsics, scan = folder / "run", folder / "extrinsics.txt", scans_of(folder)[0]
    (tmp_path / "first.bin").write_bytes(scan.read_bytes())
    (tmp_path / "000099.bin").write_bytes(scan.read_bytes())
    with pytest.raises(InputError, match="has a name that is no number of a frame"):
        map_scans(run, [tmp_path / "first.bin"], extrinsics)
    assert map_scans(run, [scan, tmp_path / "000099.bin"], extrinsics).unplaced == [str(tmp_path / "000099.bin")]
    with pytest.raises(InputError, match="has no pose for any of 1 scans"):
        map_scans(run, [tmp_path / "000099.bin"], extrinsics)
    with pytest.raises(InputError, match="none is given"):
        map_scans(run, [], extrinsics)
    with pytest.raises(InputError, match="voxel is nan"):
        map_scans(run, [scan], extrinsics, voxel=float("nan"))
    (tmp_path / "away.txt").write_text("1 0 0 900 0 1 0 900 0 0 1 -900\n")
    with pytest.raises(InputError, match="no keyframe sees any of"):
        map_scans(run, [scan], tmp_path / "away.txt")


def test_the_command_writes_a_map(drive, tmp_path):
    folder, _ = drive
    scans = [str(path) for path in scans_of(folder)]
    words = ["scans", str(folder / "run"), *scans, "--extrinsics", str(folder / "extrinsics.txt")]
    for name in ("s.npz", "s.vtu", "s.ply"):
        found = CliRunner().invoke(cli.app, [*words, "--output", str(tmp_path / name), "--json"])
        assert found.exit_code == 0
        counts = json.loads(found.stdout)
        assert counts["scans"] == 3
    assert len(read_map(tmp_path / "s.npz")) == counts["vertices"]
