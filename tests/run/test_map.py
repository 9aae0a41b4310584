"""One map of a session or of a run: the same whichever of the two it is made of."""

from dataclasses import fields, replace

import numpy as np
import pytest

from benchmarks.mapping_measures import manifold_faults
from tspslam import GeometryError, InputError, Session, Settings, Tracked, Trajectory, build_map, load_map
from tspslam.io import read_frame
from tspslam.mapping.settings import MappingSettings, SurfaceSettings
from tspslam.run.config import resolve
from tspslam.run.live import LiveMap
from tspslam.run.map import join_keyframes, kept_keyframes, stored_keyframes
from tspslam.run.pipeline import OnePair, run
from tspslam.topological_map import TopologicalMap

from ..sequences import DETECTOR, SETTINGS, SMALL_RIG, corridor

STAGES = Settings(detector=DETECTOR)


def arrays(one, prefix=""):
    """All arrays of a map, by dotted name."""
    found = {}
    for each in fields(one) if hasattr(one, "__dataclass_fields__") else ():
        value = getattr(one, each.name)
        found |= (
            {prefix + each.name: value} if isinstance(value, np.ndarray) else arrays(value, f"{prefix}{each.name}.")
        )
    if isinstance(one, tuple):
        found |= {f"{prefix}{k}": value for k, value in enumerate(one)}
    return found


def assert_same(one, other):
    first, second = arrays(one), arrays(other)
    assert first.keys() == second.keys()
    assert len(first) > 20
    for name, values in first.items():
        assert np.array_equal(values, second[name], equal_nan=values.dtype.kind == "f"), name


@pytest.fixture(scope="module")
def walk():
    return corridor(8.0, SMALL_RIG, exposure=0.1)


@pytest.fixture(scope="module")
def session(walk):
    with Session(walk.rig, STAGES) as session:
        for pair in walk:
            session.process(pair)
        session.finish()
    return session


@pytest.fixture(scope="module")
def folder(walk, tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "run"
    run(walk, out, resolve(assignments=SETTINGS))
    return out


def test_a_session_and_a_run_of_it_have_the_same_map(session, folder):
    assert_same(build_map(session), build_map(folder))
    assert_same(build_map(str(folder)), load_map(folder))


def test_a_map_has_the_keyframes_that_the_path_rests_on(session):
    made = build_map(session)
    assert made.keyframes.tolist() == [frame.index for frame in session.odometry.map.keyframes]
    assert set(made.landmark_id) <= set(session.odometry.map.landmark_id)
    assert (np.diff(made.landmark_id) > 0).all()
    assert (np.diff(made.observations.start) >= 2).all()


def test_a_map_can_be_made_while_the_session_goes_on(walk):
    with Session(walk.rig, STAGES) as session:
        for pair in [walk[k] for k in range(9)]:
            session.process(pair)
        early = build_map(session)
        for k in range(9, len(walk)):
            session.process(walk[k])
        session.finish()
        assert len(build_map(session)) > len(early) > 100


def test_settings_of_the_map_come_from_the_run_or_are_given(folder, walk, tmp_path):
    shorter = MappingSettings(surface=SurfaceSettings(longest=0.2, longest_apart=0.1))
    given = build_map(folder, shorter)
    assert len(given.surface.faces) < len(load_map(folder).surface.faces)
    run(walk, tmp_path / "run", resolve(assignments=[*SETTINGS, "mapping.surface.longest=0.2",
                                                     "mapping.surface.longest_apart=0.1"]))  # fmt: skip
    assert_same(load_map(tmp_path / "run"), given)


def test_a_map_of_one_keyframe_is_that_keyframe(walk, tmp_path):
    run(OnePair(walk[0]), tmp_path / "run", resolve(assignments=SETTINGS))
    made, frame = load_map(tmp_path / "run"), read_frame(tmp_path / "run/frames/000000.npz")
    for each in fields(frame.signals):
        assert np.array_equal(getattr(made.signals, each.name), getattr(frame.signals, each.name))
    assert np.array_equal(made.complex_.faces, frame.complex_.faces)
    assert np.array_equal(made.response.z, frame.response.z)
    assert np.array_equal(made.xyz, frame.cloud.xyz)
    assert_same(made, build_map(tmp_path / "run"))


class Given:
    """Poses from elsewhere; every third frame is a keyframe."""

    def __init__(self, poses):
        self.poses, self.stamps = poses, []

    @property
    def trajectory(self):
        return Trajectory(np.array(self.stamps), self.poses[: len(self.stamps)])

    def process(self, pair):
        self.stamps.append(pair.stamp)
        return Tracked(self.poses[len(self.stamps) - 1], is_keyframe=len(self.stamps) % 3 == 1)

    def finish(self):
        pass

    def close(self):
        pass


def test_poses_from_elsewhere_make_a_map_of_all_points(walk):
    with Session(walk.rig, STAGES, odometry=Given(walk.truth)) as session:
        for pair in walk:
            session.process(pair)
        made = build_map(session)
    assert len(made) > 500
    assert not any(manifold_faults(made.surface.faces, len(made)))
    assert np.median(np.abs(made.xyz[:, 1][made.xyz[:, 1] > 1.2] - 1.4)) < 0.05  # the floor


@pytest.mark.parametrize(
    ("source", "said"),
    [
        (7, "source is int, expected a Session or the path of a run folder"),
        ("no-such-run", "no-such-run: holds no config.yaml of a run"),
    ],
)
def test_what_has_no_keyframes_is_refused(source, said):
    with pytest.raises(InputError, match=said):
        build_map(source)


def test_a_session_that_keeps_nothing_says_so(walk):
    with Session(walk.rig, STAGES, keep=False) as session:
        session.process(walk[0])
        with pytest.raises(InputError, match="has kept no keyframe, expected keep=True"):
            build_map(session)


def test_a_run_without_landmarks_names_the_way_out(folder, tmp_path):
    import shutil

    copy = shutil.copytree(folder, tmp_path / "run")
    (copy / "landmarks.npz").unlink()
    with pytest.raises(InputError, match=r"landmarks.npz: is not there; expected .* tspslam run SOURCE --out NEW"):
        build_map(copy)


def test_keyframes_that_span_no_surface_are_told_and_the_run_is_degraded(walk, tmp_path):
    never = ["mapping.surface.longest=0.01", "mapping.surface.longest_apart=0"]
    result = run(walk, tmp_path / "run", resolve(assignments=[*SETTINGS, *never]))
    assert result.is_degraded
    assert [each["code"] for each in result.run["warnings"]].count("map") == 1
    assert not (tmp_path / "run/map.npz").exists()
    assert (tmp_path / "run/map.vtu").exists()
    with pytest.raises(GeometryError, match="landmarks span no surface"):
        build_map(tmp_path / "run")


def test_keyframes_without_a_file_are_left_out(folder):
    from tspslam.io import RunFolder

    given, settings = stored_keyframes(RunFolder.open(folder)), resolve(file=folder / "config.yaml").settings
    gone = sorted(given.index)[1]
    rest = replace(given, index={number: index for number, index in given.index.items() if number != gone})
    made = join_keyframes(rest, settings)
    assert gone not in made.keyframes
    assert isinstance(made, TopologicalMap)


def test_a_live_map_grows_with_the_session_and_ends_near_the_final_one(walk):
    sizes = []
    with Session(walk.rig, STAGES) as session:
        live = LiveMap(session)
        for pair in walk:
            if session.process(pair).is_keyframe:
                made = live.update()
                sizes.append(0 if made is None else len(made))
        session.finish()
        final = build_map(session)
        last = live.update()
    assert sizes[0] == 0
    assert sizes[-1] > sizes[1] > 0
    assert not any(manifold_faults(last.surface.faces, len(last)))
    assert len(np.intersect1d(last.landmark_id, final.landmark_id)) > 0.8 * len(final)
    assert last.keyframes.tolist() == final.keyframes.tolist()
    assert arrays(last).keys() == arrays(final).keys()
    ok = np.isin(final.landmark_id, last.landmark_id)
    same = np.searchsorted(last.landmark_id, final.landmark_id[ok])
    away = np.linalg.norm(final.xyz[ok] - last.xyz[same], axis=1)
    assert np.median(away) < 0.02


def test_a_live_map_follows_its_landmarks(session):
    """As after a loop closes: what is not made anew stands where the landmarks are now."""
    live = LiveMap(session)
    made = live.update()
    given = kept_keyframes(session)
    moved = replace(given.snapshot, xyz=given.snapshot.xyz + np.array([0, 0, 1.0]))
    from tspslam.run.live import _join

    part = join_keyframes(replace(given, index=dict(list(given.index.items())[-2:])), session.settings)
    joined = _join(made, part, replace(given, snapshot=moved))
    old = ~np.isin(joined.landmark_id, part.landmark_id)
    rows = np.searchsorted(moved.landmark_id, joined.landmark_id[old])
    assert old.sum() > 50
    assert np.array_equal(joined.xyz[old], moved.xyz[rows])


def test_parts_that_share_no_landmark_are_told(session):
    from tspslam.run.summary import doubts_of_map

    made = build_map(session)
    assert list(doubts_of_map(made, len(made))) == []
    seen = made.observations
    half = len(made.keyframes) // 2
    is_first = np.zeros(len(made), bool)
    is_first[seen.vertex[seen.keyframe < half]] = True
    kept = (seen.keyframe < half) | ~is_first[seen.vertex]
    start = np.searchsorted(seen.vertex[kept], np.arange(len(made) + 1))
    columns = {name: getattr(seen, name)[kept] for name in ("keyframe", "uv", "disparity", "weight")}
    apart = replace(made, observations=replace(seen, start=start, **columns))
    (warning,) = doubts_of_map(apart, len(made))
    assert warning["code"] == "map_parts"
    assert f"in 2 parts that share no landmark ({half} from frame 0;" in warning["message"]


def test_few_vertices_for_many_landmarks_are_told(session):
    from tspslam.run.summary import doubts_of_map

    made = build_map(session)
    (warning,) = doubts_of_map(made, 6 * len(made))
    assert warning["code"] == "thin_map"


def test_pairs_without_a_number_of_their_own_go_by_the_order_in_which_they_came(walk, tmp_path):
    from tspslam.io import read_map, write_map

    with Session(walk.rig, STAGES) as session:
        for pair in walk:
            session.process(replace(pair, index=0))
        made = build_map(session)
    assert (np.diff(made.keyframes) > 0).all()
    write_map(tmp_path / "map.npz", made)
    assert_same(read_map(tmp_path / "map.npz"), made)


def test_a_frame_that_was_changed_since_the_run_is_refused(folder, tmp_path):
    import shutil

    copy = shutil.copytree(folder, tmp_path / "run")
    keyframes = load_map(copy).keyframes.tolist()
    shutil.copy(copy / f"frames/{keyframes[0]:06d}.npz", copy / f"frames/{keyframes[1]:06d}.npz")
    with pytest.raises(InputError, match=rf"frames.{keyframes[1]:06d}\.npz: .*changed since the run"):
        build_map(copy)


@pytest.mark.parametrize("wrong", ["x", 7, SurfaceSettings()])
@pytest.mark.parametrize(
    "use", [lambda s, w: build_map(s, w), lambda s, w: LiveMap(s, w), lambda s, w: Settings(mapping=w)]
)
def test_settings_of_another_kind_are_refused(session, use, wrong):
    with pytest.raises(InputError, match=r"mapping is .*, expected a MappingSettings: tspslam.MappingSettings"):
        use(session, wrong)


def test_a_live_map_needs_landmarks_that_stay(walk):
    with (
        Session(walk.rig, STAGES, odometry=Given(walk.truth)) as session,
        pytest.raises(InputError, match="poses come from elsewhere, expected StereoOdometry"),
    ):
        LiveMap(session)


def test_a_path_shorter_than_its_frames_is_refused(walk):
    with Session(walk.rig, STAGES, odometry=Given(walk.truth[:2])) as session:
        session.process(walk[0])
        session.odometry.stamps.clear()
        with pytest.raises(InputError, match="its trajectory has 0 poses, expected 1 or more"):
            build_map(session)


def test_keep_is_true_or_false(walk):
    with pytest.raises(InputError, match="session: keep is the text 'no', expected True or False"):
        Session(walk.rig, keep="no")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda r: None, "filter: result is NoneType, expected a Response"),
        (lambda r: replace(r, z=np.stack([r.z, r.z], axis=1)), r"z and defined have shapes \(\d+, 2\)"),
        (lambda r: replace(r, z=r.z[:-1]), r"z and defined have shapes"),
        (lambda r: replace(r, z=r.z * np.nan), "not finite or too large"),
        (lambda r: replace(r, z=r.z + 1e150), "not finite or too large"),
        (lambda r: replace(r, order=-1), "order is -1, expected 0 or more"),
    ],
)
def test_what_a_filter_gives_is_looked_at(session, change, said):
    given, settings = kept_keyframes(session), replace(STAGES, filter=lambda *a: change(STAGES.filter(*a)))
    with pytest.raises(InputError, match=said):
        join_keyframes(given, settings)


def test_a_session_can_be_asked_for_its_map_while_another_thread_processes(walk):
    from concurrent.futures import ThreadPoolExecutor

    with Session(walk.rig, STAGES) as session, ThreadPoolExecutor(1) as pool:
        for k in range(6):
            session.process(walk[k])
        busy = pool.submit(lambda: [session.process(walk[k]) for k in range(6, len(walk))])
        made = [kept_keyframes(session) for _ in range(20)]
        busy.result()
    for given in made:
        assert set(given.snapshot.keyframe.tolist()) == set(given.index)
        assert given.snapshot.start[-1] == len(given.snapshot.observed_id)


@pytest.mark.parametrize("kind", [np.float64, np.float32, np.uint16])
def test_images_of_every_kind_give_a_session_and_a_run_one_map(walk, tmp_path, kind):
    class Other:
        name, rig = "other", walk.rig

        def __len__(self):
            return 6

        def __getitem__(self, k):
            pair, scale = walk[2 * k], 257 if kind is np.uint16 else 1 / 255
            left, right = ((side * kind(scale)).astype(kind) for side in (pair.left, pair.right))
            return replace(pair, left=left, right=right, index=k)

    with Session(walk.rig, STAGES) as session:
        for k in range(6):
            session.process(Other()[k])
        session.finish()
        made = build_map(session)
    run(Other(), tmp_path / "run", resolve(assignments=SETTINGS))
    assert_same(load_map(tmp_path / "run"), made)


def test_a_surface_without_faces_is_a_map_without_faces(walk):
    from tspslam.types import Surface

    stages = replace(STAGES, surface=lambda cloud: Surface(np.empty((0, 3), np.int32)))
    with Session(walk.rig, stages) as session:
        session.process(walk[0])
        made = build_map(session)
    assert len(made.surface.faces) == 0
    assert not made.direction.any()
