"""The picture of the first page and of the README, ``images/street.png``: ``python docs/street.py``, in a minute.

A synthetic street mapped, seen from the camera's path: luminance on the left, magnitude of the response on the right.
"""

from pathlib import Path

import numpy as np
from matplotlib.colors import Normalize
from PIL import Image, ImageDraw

import tspslam
from tspslam.datasets import synthetic
from tspslam.view import _map_faces as lit
from tspslam.view import _style as style
from tspslam.view._frame import limits
from tspslam.view._map import luminance, magnitude
from tspslam.view._viewpoints import FINER, Outlook, _outlook, from_path, normals

SIZE = 560, 1600  # px
WIDTH = 1.9  # of the picture at depth 1
NIGHT, BARE = np.array([24, 29, 38]) / 255, np.array([72, 80, 94]) / 255  # the sky; a face without a value
LINE, ORANGE = 0.7, (255, 138, 51)  # brightness of the edges of the mesh; the path
CAMERAS = tspslam.Rig(fx=707.09, fy=707.09, cx=601.9, cy=183.1, baseline=0.537, width=1226, height=370)  # as KITTI's


def make_map() -> tspslam.TopologicalMap:
    """Map 60 m of a street, noise and changing exposures included; the road too, which is seen at a grazing angle."""
    faults = synthetic.Faults(noise=0.012, blur=0.6, exposure=0.15)
    drive = synthetic.SyntheticSequence(synthetic.street(60.0, step=0.75), CAMERAS, faults=faults)
    mapping = tspslam.MappingSettings(views=tspslam.ViewSettings(max_angle=86))
    settings = tspslam.Settings(detector=tspslam.OrbDetector(count=4000), mapping=mapping)
    with tspslam.Session(drive.rig, settings) as session:
        for pair in drive:
            session.process(pair)
        session.finish()
        return tspslam.build_map(session)


def look(world: tspslam.TopologicalMap) -> Outlook:
    """Stand where the package's own picture from the path stands, with a wider view."""
    seen = from_path(world)
    facing = np.einsum("fi,fi->f", normals(world), seen.eye - world.xyz[world.surface.faces[:, 0]]) > 0
    scale = SIZE[1] / WIDTH
    corner = -np.array([WIDTH / 2, 0.5 * SIZE[0] / scale])
    return _outlook(
        world, np.flatnonzero(facing), seen.axes, seen.eye, False, corner, scale, SIZE, seen.near, seen.keyframe
    )


def paint(world: tspslam.TopologicalMap, outlook: Outlook, shown, scale: str) -> np.ndarray:
    """Faces in the colours of a scale, lightly shaded."""
    norm = Normalize(*limits(shown.values[shown.ok]))
    rgb = np.where(shown.ok[:, None], style.colours(shown.values, norm, scale), BARE) * lit.light(world)[:, None]
    return outlook.paint(rgb, NIGHT).astype(float)


def edges(outlook: Outlook) -> np.ndarray:
    """Brightness, (H, W): less where two faces meet."""
    owner = outlook.owner
    meets = (owner != np.roll(owner, 1, axis=0)) | (owner != np.roll(owner, 1, axis=1))
    share = sum(meets[i::FINER, j::FINER].astype(float) for i in range(FINER) for j in range(FINER)) / FINER**2
    return 1 - (1 - LINE) * share


def draw(world: tspslam.TopologicalMap) -> Image.Image:
    outlook = look(world)
    grey, hot = paint(world, outlook, luminance(world), "gray"), paint(world, outlook, magnitude(world), "inferno")
    across = np.linspace(0, 1, SIZE[1])[None, :, None]
    share = np.clip((across - 0.47) / 0.06, 0, 1)
    pixels = ((1 - share) * grey + share * hot) * edges(outlook)[..., None]
    picture = Image.fromarray(np.rint(pixels).astype(np.uint8))
    places = outlook.place(world.T_world_camera[outlook.keyframe :, :3, 3] + [0, 1.5, 0])  # on the road
    pen = ImageDraw.Draw(picture)
    pen.line([tuple(p) for p in places], fill=ORANGE, width=4)
    for u, v in places:
        pen.ellipse((u - 5, v - 5, u + 5, v + 5), fill=(255, 255, 255), outline=ORANGE, width=3)
    return picture.quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=3, dither=Image.Dither.NONE)  # 24 bits: 520 kB


if __name__ == "__main__":
    draw(make_map()).save(Path(__file__).parent / "images" / "street.png", optimize=True)
