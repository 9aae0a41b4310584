"""The state that ParaView opens an exported run with: a program of its own language, which newer versions read too."""

STATE = '''"""What ParaView 5.10 or newer shows of this folder: the map, the path, and the keyframes one after another.

    paraview --state=state.py           or File > Load State... in ParaView
    pvbatch state.py picture.png        a picture of it, without a window

The world is the first frame's camera: x right, y down, z forward, in metres. Time is in seconds since the first frame.
"""

import os
import sys

from paraview.simple import *

HERE = os.path.dirname(os.path.abspath(globals().get("__file__", "state.py")))
EYE, LOOK_AT = {eye}, {look_at}
BARE = [0.59, 0.62, 0.66]


def shown(name, source, view, is_visible=True):
    RenameSource(name, source)
    display = Show(source, view)
    display.SetRepresentationType("Surface")
    if not is_visible:
        Hide(source, view)
    return display


def where(source, name, value):
    """The cells of a grid whose number of that name is the value."""
    found = Threshold(Input=source, Scalars=["CELLS", name])
    found.LowerThreshold = found.UpperThreshold = value
    return found


def grey(display, kind):
    """Colour by luminance, from 0 to 1."""
    ColorBy(display, (kind, "luminance"))
    scale = GetColorTransferFunction("luminance")
    scale.ApplyPreset("Grayscale", True)
    scale.RescaleTransferFunction(0.0, 1.0)


def plain(display, colour):
    display.ColorArrayName = ["POINTS", ""]
    display.DiffuseColor = display.AmbientColor = colour


view = GetActiveViewOrCreate("RenderView")
view.UseColorPaletteForBackground = 0
view.Background = [0.80, 0.86, 0.93]  # neither black nor white, which are luminances
view.OrientationAxesVisibility = 1

grid = XMLUnstructuredGridReader(registrationName="map.vtu", FileName=[os.path.join(HERE, "map.vtu")])
Hide(grid, view)
faces = where(grid, "dim", 2)
RenameSource("map: faces", faces)
Hide(faces, view)
seen = shown("map: faces with a signal", where(faces, "ok", 1), view)
grey(seen, "CELLS")
seen.SetScalarBarVisibility(view, True)
bar = GetScalarBar(GetColorTransferFunction("luminance"), view)
bar.Title, bar.ComponentTitle, bar.TitleColor, bar.LabelColor = "luminance", "", [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
seen.Ambient, seen.Diffuse, seen.Specular = 1.0, 0.0, 0.0  # luminance is what was seen: it is not lit again
plain(shown("map: faces without", where(faces, "ok", 0), view), BARE)
edges = shown("map: edges", where(grid, "dim", 1), view, is_visible=False)
grey(edges, "CELLS")

path = XMLUnstructuredGridReader(registrationName="path.vtu", FileName=[os.path.join(HERE, "path.vtu")])
line = shown("path", path, view)
plain(line, [0.90, 0.45, 0.0])
line.LineWidth = 4.0

series = PVDReader(registrationName="series.pvd", FileName=os.path.join(HERE, "series.pvd"))
Hide(series, view)
frame = shown("keyframe at this time", where(series, "dim", 2), view)
plain(frame, [0.0, 0.35, 0.70])
frame.SetRepresentationType("Wireframe")
frame.Opacity = 0.6

GetAnimationScene().UpdateAnimationUsingDataTimeSteps()
SetActiveSource(grid)
Render(view)  # the first time, it moves the camera
view.CameraPosition, view.CameraFocalPoint, view.CameraViewUp = EYE, LOOK_AT, [0.0, -1.0, 0.0]
view.CameraViewAngle = 60.0
Render(view)
if sys.argv[-1].endswith(".png"):
    view.ViewSize = [1280, 800]
    SaveScreenshot(sys.argv[-1], view, ImageResolution=[1280, 800])
'''


def state_of(eye: list[float], look_at: list[float]) -> str:
    """Return the program: it looks from `eye` at `look_at`, m, y down."""
    return STATE.replace("{eye}", repr(eye)).replace("{look_at}", repr(look_at))
