"""Small worlds whose truth is known: a wall, a closed room, their images, and the snapshot that a perfect path has."""

from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np

from tspslam import Rig
from tspslam.datasets import synthetic
from tspslam.datasets.synthetic.shapes import pose_at
from tspslam.mapping.build import make_map
from tspslam.mapping.settings import MappingSettings
from tspslam.mapping.views import Sightings, View, to_camera
from tspslam.topology.harmonic import Tmahf
from tspslam.vision.rig import project
from tspslam.vision.slam.keyframes.keyframe import MapSnapshot

RIG = Rig(fx=130, fy=126, cx=79.3, cy=59.6, baseline=0.2, width=160, height=120, skew=1.0, doffs=0.5)
WIDE = replace(RIG, fx=75, fy=75)
ROOM = np.array([4.0, 3.0, 5.0])  # m, its sides


class World(NamedTuple):
    """What `make_map` takes of a world."""

    views: list[View]
    snapshot: MapSnapshot
    rig: Rig

    def map(self, settings=None):
        return make_map(self.views, self.snapshot, self.rig, Tmahf(), settings or MappingSettings())

    def known(self):
        snapshot = self.snapshot
        rows = np.searchsorted(snapshot.landmark_id, snapshot.observed_id)
        keyframe = np.repeat(np.arange(len(self.views)), np.diff(snapshot.start))
        return Sightings(rows, keyframe, snapshot.uv, snapshot.disparity)

    def take(self, keyframes):
        """The world of some of the keyframes, in the order that is asked for."""
        s = self.snapshot
        rows = np.concatenate([np.arange(s.start[k], s.start[k + 1]) for k in keyframes])
        snapshot = replace(
            s,
            keyframe=s.keyframe[keyframes],
            T_world_camera=s.T_world_camera[keyframes],
            start=np.cumsum([0, *np.diff(s.start)[keyframes]]),
            observed_id=s.observed_id[rows],
            uv=s.uv[rows],
            disparity=s.disparity[rows],
        )
        return World([self.views[k] for k in keyframes], snapshot, self.rig)

    def renumber(self):
        """The world whose frames came in the order in which they stand."""
        number = np.sort(self.snapshot.keyframe)
        views = [replace(view, number=k) for view, k in zip(self.views, number.tolist(), strict=True)]
        return World(views, replace(self.snapshot, keyframe=number), self.rig)

    def move(self, T):
        """The world after a rigid motion of all of it."""
        poses = T @ self.snapshot.T_world_camera
        xyz = self.snapshot.xyz @ T[:3, :3].T + T[:3, 3]
        views = [replace(view, T_world_camera=pose) for view, pose in zip(self.views, poses, strict=True)]
        return World(views, replace(self.snapshot, xyz=xyz, T_world_camera=poses), self.rig)

    def show(self, images):
        return self._replace(views=[replace(view, given=image) for view, image in zip(self.views, images, strict=True)])


def sightings(rig, poses, xyz, noise=0.0, seed=0):
    """What each keyframe sees of points that nothing hides, by keyframe."""
    rng = np.random.default_rng(seed)
    parts = []
    for k, T in enumerate(poses):
        local = to_camera(xyz, T)
        uv = project(rig, local)
        with np.errstate(invalid="ignore"):
            rows = np.flatnonzero(((uv >= 0) & (uv <= (rig.width - 1, rig.height - 1))).all(axis=1))
        disparity = rig.fx * rig.baseline / local[rows, 2] - rig.doffs
        parts.append((rows, np.full(len(rows), k), uv[rows], disparity))
    found = Sightings(*map(np.concatenate, zip(*parts, strict=True)))
    off = noise * rng.normal(size=(len(found.landmark), 3))
    return found._replace(uv=found.uv + off[:, :2], disparity=found.disparity + off[:, 2])


def world_of(rig, poses, xyz, images, noise=0.0, known=None):
    """A world of points that nothing hides; numbers of keyframes and of landmarks are not their rows."""
    seen = sightings(rig, poses, xyz, noise) if known is None else known
    start = np.searchsorted(seen.keyframe, np.arange(len(poses) + 1))
    number = 3 + 5 * np.arange(len(xyz))
    keyframe = 2 + 4 * np.arange(len(poses))
    nothing = np.empty((0, 2), np.int64)
    snapshot = MapSnapshot(number, xyz, keyframe, poses, start, number[seen.landmark], seen.uv, seen.disparity, nothing)
    return World([View(*one) for one in zip(keyframe.tolist(), poses, images, strict=True)], snapshot, rig)


def rendered(shapes, rig, poses, **faults):
    scene = synthetic.Scene(tuple(shapes), np.array(poses), background=0.3)
    return [pair.left for pair in synthetic.SyntheticSequence(scene, rig, synthetic.Faults(**faults))]


def looking(places, at=(0.0, 0.0, 4.0)):
    """Poses of cameras that look at a point."""
    poses = []
    for place in np.asarray(places, float):
        ahead = np.asarray(at) - place
        ahead /= np.linalg.norm(ahead)
        right = np.cross((0, 1, 0), ahead)
        right /= np.linalg.norm(right)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = np.column_stack([right, np.cross(ahead, right), ahead]), place
        poses.append(T)
    return np.array(poses)


@cache
def wall(count=150, noise=0.0, rough=0.0):
    """A wall 4 m away that seven cameras look at; `rough` moves its points off it, m."""
    rng = np.random.default_rng(5)
    xyz = np.column_stack([rng.uniform(-1.5, 1.5, count), rng.uniform(-1.1, 1.1, count), np.full(count, 4.0)])
    xyz[:, 2] += rough * rng.normal(size=count)
    poses = looking([(0, 0, 0), (1, 0.2, 0.3), (-1.1, 0.1, 0), (0.3, 0.9, 0.2), (-0.2, -0.8, 0.5), (0.6, -0.5, 1),
                     (-0.7, 0.6, 0.8)])  # fmt: skip
    texture = synthetic.Texture(seed=4, texel=0.012)
    images = rendered([synthetic.plane(9, 7, texture=texture).at(0, 0, 4)], RIG, poses)
    return world_of(RIG, poses, xyz, images, noise)


@cache
def room(count=500, noise=0.0):
    """A closed room that 32 cameras inside look at all around; its middle is the origin."""
    rng = np.random.default_rng(3)
    xyz = rng.uniform(-0.5, 0.5, (count, 3))
    area = 1 / ROOM
    side = rng.choice(3, count, p=area / area.sum())
    xyz[np.arange(count), side] = np.where(rng.random(count) < 0.5, -0.5, 0.5)
    xyz *= ROOM
    turns = [(0, k * np.pi / 6 + 0.1, 0) for k in range(12)]
    turns += [(s * np.pi / 2, 0, 0) for s in (-1, 1)] + [(s * 0.6, 0, 0) for s in (-1, 1)]
    places = rng.uniform(-0.15, 0.15, (2 * len(turns), 3)) * ROOM
    poses = np.array([pose_at(place, turn) for place, turn in zip(places, turns + turns, strict=True)])
    box = synthetic.box(*ROOM, texture=synthetic.Texture(seed=4, texel=0.02))
    return world_of(WIDE, poses, xyz, rendered([box], WIDE, poses), noise)


def border_loops(faces):
    """How many loops the border of a manifold has."""
    sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    border, count = np.unique(sides, axis=0, return_counts=True)
    root = {vertex: vertex for vertex in border[count == 1].ravel().tolist()}

    def find(vertex):
        while root[vertex] != vertex:
            vertex = root[vertex]
        return vertex

    for a, b in border[count == 1].tolist():
        root[find(a)] = find(b)
    return len({find(vertex) for vertex in root})


def names(found):
    """Faces of a map by their landmarks' numbers."""
    return {tuple(sorted(face)) for face in found.landmark_id[found.surface.faces].tolist()}
