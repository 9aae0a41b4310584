"""A loop is closed: a graph of the keyframes' poses takes its error out of the map, and landmarks go with them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...._brief import Brief
from ....errors import GeometryError
from ....types import BoolArray, FloatArray, Rig
from ...se3 import inverse, normalised
from ..keyframes.keyframe import Keyframe
from ..keyframes.map import Map
from ..keyframes.parts import join_parts
from ..keyframes.sightings import match_sights
from ..least_squares.bundle import lens_of
from ..least_squares.pose_graph import PoseEdges, optimise_poses
from ..pose import PoseEstimate

_LEAST_SHARED = 15  # landmarks that make two keyframes neighbours (Mur-Artal et al. 2015)
# Information of each edge besides that of the landmarks: neighbours are some metres and less than a right angle apart.
_LOOSE = np.diag([1.0] * 3 + [1e-2] * 3)  # 1 rad, 10 m
_GUESSED = np.diag([1e-2] * 3 + [1e-6] * 3)  # of a step that was guessed: 10 rad, 1 km
_MAX_STEPS = 20  # five times what a loop of 6 km with 60 m of error took
_FELT = 0.1  # standard deviations; the end of the town along KITTI 06, 0.26 m off, leaves 0.002 in the median
_HUBER = 2.5  # standard deviations, as in `adjust`


@dataclass(frozen=True, repr=False)
class LoopCorrection(Brief):
    """A map of which a loop is closed.

    Attributes
    ----------
    motions : (K, 4, 4) float64
        How each keyframe moves in the world, so that neighbours keep their relative poses and the loop is closed.
    frames : list of Keyframe
        K keyframes, moved.
    xyz : (M, 3) float64
        Landmarks, each moved with the keyframe that first saw it, m.
    unsettled : set of int
        Numbers of the frames whose sights have moved against those of a neighbour, by over a tenth of their standard
        deviations in the root mean square: they are to be adjusted.
    """

    motions: FloatArray
    frames: list[Keyframe]
    xyz: FloatArray
    unsettled: set[int]


@dataclass(frozen=True, repr=False)
class LoopProblem(Brief):
    """The keyframes of a map, of which the last is seen from an older place.

    Attributes
    ----------
    frames : tuple of Keyframe
        K keyframes.
    loop : Keyframe
        The last one as older landmarks have it: its pose and what it sees of them.
    xyz : (M, 3) float64
        Landmarks, m.
    rig : Rig
        The cameras.
    sigma_uv : float
        Standard deviation of a tracked point, px.
    """

    frames: tuple[Keyframe, ...]
    loop: Keyframe
    xyz: FloatArray
    rig: Rig
    sigma_uv: float

    @classmethod
    def of(cls, map_: Map, sigma_uv: float) -> LoopProblem:
        """Collect the keyframes of a map of which a loop is being closed.

        Parameters
        ----------
        map_ : Map
            Keyframes and landmarks.
        sigma_uv : float
            Standard deviation of a tracked point, px.

        Returns
        -------
        LoopProblem
        """
        return cls(tuple(map_.keyframes), _seen_again(map_), map_.xyz, map_.rig, sigma_uv)

    def solve(self) -> LoopCorrection:
        """Find how each keyframe moves, and move it, and each landmark with the one that first saw it.

        An edge joins keyframes that follow each other or see landmarks in common; its information is what these
        landmarks tell of the pose. The loop's edge joins the last keyframe to the one that sees most of the loop's.

        Returns
        -------
        LoopCorrection

        Raises
        ------
        GeometryError
            If the edges do not fix the keyframes.
        """
        T = np.stack([frame.T_world_camera for frame in self.frames])
        i, j, own, information = self.neighbours(T)
        older, T_loop, told = self._loop_edge(T)
        T_ij = normalised(inverse(T[i]) @ T[j])
        edges = PoseEdges(
            np.append(i, older), np.append(j, len(T) - 1),
            np.concatenate([T_ij, [T_loop]]), np.concatenate([information, [told]]),
        )  # fmt: skip
        found = optimise_poses(T, edges, max_steps=_MAX_STEPS).T_world
        moved = self._are_moved(inverse(T_ij) @ inverse(found[i]) @ found[j], j, own)
        motions = normalised(found @ inverse(T))
        frames = [
            replace(frame, T_world_camera=pose)
            for frame, pose in zip(self.frames, normalised(motions @ T), strict=True)
        ]
        frames[0] = self.frames[0]
        numbers = {frame.index for frame, is_moved in zip(frames[1:], moved[1:], strict=True) if is_moved}
        return LoopCorrection(motions, join_parts(frames, older, len(T) - 1), self.move_landmarks(motions), numbers)

    def _are_moved(self, bent: FloatArray, j: NDArray[np.int64], own: FloatArray) -> BoolArray:
        """Which keyframes see their landmarks elsewhere, where edges that end at j were bent so."""
        from scipy.spatial.transform import Rotation

        x = np.concatenate([Rotation.from_matrix(bent[:, :3, :3]).as_rotvec(), bent[:, :3, 3]], axis=1)
        count = np.array([max(len(frame.landmark), 1) for frame in self.frames])
        square = np.einsum("ei,eij,ej->e", x, own[j], x) / count[j]
        moved = np.zeros(len(self.frames), np.bool_)
        moved[j[square > _FELT**2]] = True
        return moved

    def move_landmarks(self, motions: FloatArray) -> FloatArray:
        """Move each landmark with the keyframe that first saw it.

        Parameters
        ----------
        motions : (K, 4, 4) float64
            How each keyframe moves in the world.

        Returns
        -------
        (M, 3) float64
            m.
        """
        frames = self.frames[::-1]
        first_seen = np.zeros(len(self.xyz), np.int64)
        places = np.repeat(np.arange(len(frames))[::-1], [len(frame.landmark) for frame in frames])
        first_seen[np.concatenate([frame.landmark for frame in frames])] = places
        move = motions[first_seen]
        xyz: FloatArray = np.einsum("mij,mj->mi", move[:, :3, :3], self.xyz) + move[:, :3, 3]
        return xyz

    def correct(self) -> LoopCorrection | None:
        """Close the loop; may be called in another thread while the map stays as it is.

        Returns
        -------
        LoopCorrection or None
            None if the graph of the poses has no solution.
        """
        try:
            return self.solve()
        except GeometryError:
            return None

    def neighbours(self, T: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray, FloatArray]:
        """Find pairs of keyframes, and what landmarks in common tell of one against the other.

        Parameters
        ----------
        T : (K, 4, 4) float64
            Poses of the keyframes.

        Returns
        -------
        i, j : (E,) int64
            Which follow each other, or see enough landmarks in common.
        own : (K, 6, 6) float64
            What the sights of each keyframe tell of its pose.
        information : (E, 6, 6) float64
            The share of that which each pair has.
        """
        i, j, shared = _sharing(self.frames, len(self.xyz))
        share = shared / np.array([max(len(frame.landmark), 1) for frame in self.frames])[j]
        own = self._informations(self.frames, T)
        information = share[:, None, None] * own[j] + _LOOSE
        is_guess = np.array([frame.is_start for frame in self.frames])[j] & (j == i + 1)
        information[is_guess] = _GUESSED
        return i, j, own, information

    def _informations(self, frames: Sequence[Keyframe], T: FloatArray) -> FloatArray:
        """What the sights of keyframes at T tell of their poses, (K, 6, 6), each in its own frame."""
        from ..least_squares._kernels import pose_equations

        lens, T_camera_world, S = lens_of(self.rig), inverse(T), np.empty((len(frames), 6, 6))
        R, t = np.ascontiguousarray(T_camera_world[:, :3, :3]), T_camera_world[:, :3, 3].copy()
        landmark, uv, disparity, sigma = (
            np.concatenate([getattr(f, name) for f in frames]) for name in ("landmark", "uv", "disparity", "sigma")
        )
        xyz, seen, weights = self.xyz[landmark], np.column_stack([uv, disparity]), np.empty((len(uv), 2))
        weights[:, 0], weights[:, 1] = self.sigma_uv**-2.0, sigma**-2.0
        ends = np.cumsum([0, *(len(frame.landmark) for frame in frames)]).tolist()
        for k, rows in enumerate(map(slice, ends, ends[1:])):
            pose_equations(lens, R[k], t[k], xyz[rows], seen[rows], weights[rows], _HUBER, S[k], np.empty(6))
        return S

    def _loop_edge(self, T: FloatArray) -> tuple[int, FloatArray, FloatArray]:
        """The older keyframe, where the last one is seen from there, and the information."""
        older = _older_place(self.frames, self.loop, len(self.xyz))
        return older, *self.edge_from(older, self.loop, T)

    def edge_from(self, place: int, loop: Keyframe, T: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Find what sights of older landmarks tell of a keyframe against one that it sees again.

        Parameters
        ----------
        place : int
            Which keyframe is seen again.
        loop : Keyframe
            Pose and sights of the other, as the older landmarks have them.
        T : (K, 4, 4) float64
            Poses of the keyframes.

        Returns
        -------
        (4, 4) float64, (6, 6) float64
            ``T_place_loop`` and its information.
        """
        information = self._informations([loop], loop.T_world_camera[None])[0] + _LOOSE
        return normalised(inverse(T[place]) @ loop.T_world_camera), information


def _sharing(frames: Sequence[Keyframe], count: int) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Pairs i < j of keyframes that follow each other or see landmarks in common, of `count`; how many these are."""
    from scipy.sparse import csr_matrix, eye_array, triu

    start = np.cumsum([0, *(len(frame.landmark) for frame in frames)])
    landmark = np.concatenate([frame.landmark for frame in frames])
    sees = csr_matrix((np.ones(len(landmark), np.int64), landmark, start), (len(frames), count))
    pairs = triu(sees @ sees.T, 1) + triu(eye_array(len(frames), k=1, dtype=np.int64))  # one more where they follow
    pairs = pairs.tocoo()
    order = np.lexsort((pairs.col, pairs.row))
    i, j = pairs.row[order].astype(np.int64), pairs.col[order].astype(np.int64)
    shared = pairs.data[order] - (j == i + 1)
    kept = (shared >= _LEAST_SHARED) | (j == i + 1)
    return i[kept], j[kept], shared[kept]


def _older_place(frames: Sequence[Keyframe], loop: Keyframe, count: int) -> int:
    """Which keyframe before the last sees most of the older landmarks of a loop, of `count` in the map."""
    is_seen = np.zeros(count, np.bool_)
    is_seen[loop.landmark] = True
    return int(np.argmax([is_seen[frame.landmark].sum() for frame in frames[:-1]]))


def prepare() -> None:
    """Have what closes loops compiled, or read from disk, before the camera waits for it."""
    T, one = np.tile(np.eye(4), (3, 1, 1)), np.tile(np.eye(6), (2, 1, 1))
    optimise_poses(T, PoseEdges(np.array([0, 1]), np.array([1, 2]), T[:2], one), max_steps=1)


def note_loop(
    map_: Map, again: PoseEstimate, ids: NDArray[np.int64], spread: Callable[[FloatArray], FloatArray]
) -> None:
    """Note what the last keyframe sees of an older place, until the loop is closed.

    Parameters
    ----------
    map_ : Map
        Changed: its `loop`.
    again : PoseEstimate
        Older landmarks with disparities, and the pose that they give.
    ids : (K,) int64
        Numbers of these landmarks: rows may have moved since.
    spread : callable
        Standard deviations of the disparities at places (K, 2) of the image, (K,) px.
    """
    index, T = map_.keyframes[-1].index, again.T_world_camera
    map_.loop = Keyframe(index, T, None, ids, again.uv, again.disparity, spread(again.uv))


def _seen_again(map_: Map) -> Keyframe:
    """The loop that is being closed, with the rows of those of its landmarks that the map still has."""
    loop = map_.loop
    assert loop is not None
    at = np.minimum(np.searchsorted(map_.landmark_id, loop.landmark), len(map_.landmark_id) - 1)
    kept = (map_.landmark_id[at] == loop.landmark) & (map_.view_counts(at) > 0)
    columns = {name: getattr(loop, name)[kept] for name in ("uv", "disparity", "sigma")}
    return replace(loop, landmark=at[kept], **columns)


def close_loop(map_: Map, correction: LoopCorrection, same_landmark: float) -> None:
    """Put what a loop has moved in its place, and join what the last keyframe sees of both ends.

    Parameters
    ----------
    map_ : Map
        That of the `LoopProblem`, as it was then; changed: its `loop` is closed, and keyframes are not settled.
    correction : LoopCorrection
        What that gave.
    same_landmark : float
        Distance of two observations, in u, v and disparity, of one landmark, px.
    """
    loop = _seen_again(map_)
    map_.keyframes, map_.xyz, map_.unsettled, map_.loop = correction.frames, correction.xyz, correction.unsettled, None
    _join_sights(map_, loop, same_landmark)


def _join_sights(map_: Map, again: Keyframe, same_landmark: float) -> None:
    """Have the last keyframe see what it sees again; landmarks that it sees in the same place become one."""
    own = map_.keyframes[-1]
    seen, known = (np.column_stack([frame.uv, frame.disparity]) for frame in (again, own))
    older, rows = match_sights(seen, known, same_landmark)
    map_.merge_landmarks(again.landmark[older], own.landmark[rows])
    map_.observe(len(map_.keyframes) - 1, again)
