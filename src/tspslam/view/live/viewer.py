"""The viewer of a run: shows what it is told of it, and answers who looks. One thread draws: that of `work`."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Set
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ..._brief import brief
from ...errors import InputError
from ...frame import Frame
from ...types import FloatArray, Rig
from ._drawn import Drawn, draw_frame, draw_map
from ._element import Element, element_at, element_of
from ._gate import Gate, address_of, is_loopback, remarks_of
from ._images import OVERLAYS, THUMBNAIL, Pixels, overlaid, patch, pixels_of, sheet, shrunk
from ._panel import ABOVE, BEGINNING, FRAME, MAP, Panel, put
from ._server import free_port, start_server
from ._stage import SWITCHES, Stage
from .world import State, Station, World

PORT = 8080
PICTURES = 40  # keyframes with their image in the scene at most, evenly chosen
PATCHES = 6  # of what was clicked
_PLAY = 0.1  # s a frame
_IDLE = 0.3  # s: how long a viewer without work sleeps


class Shot(NamedTuple):
    """A frame of a run that goes on: number, pose, what became of it, its image as JPEG, the cameras."""

    number: int
    T_world_camera: FloatArray
    state: State
    jpeg: bytes
    rig: Rig

    def __repr__(self) -> str:
        return brief(self)


class Viewer:
    """A page that shows a run, on this machine alone unless `host` says otherwise.

    Parameters
    ----------
    frames : callable, int -> Frame
        Reads a stored frame by its number; `InputError` if it cannot be read.
    host : str
        Address to listen at.
    port : int
        The first port to try; 0 is any.
    frame : int, optional
        Number of the frame whose own mesh is shown first; by default the map.
    complain : callable, str -> None
        Takes a line about what cannot be shown, once for each.

    Attributes
    ----------
    port : int
        Where it listens.
    address : str
        What to open; with a token, where another machine could.
    remarks : list of str
        What to say before: that the port is another, that other machines can reach it.

    Raises
    ------
    InputError
        If viser is not installed, or `host` is no address of this machine.
    OutputError
        If there is no free port.
    """

    def __init__(
        self, frames: Callable[[int], Frame], *, host: str = "127.0.0.1", port: int = PORT, frame: int | None = None,
        complain: Callable[[str], None] = lambda line: None,
    ) -> None:  # fmt: skip
        outer = free_port(host, port)
        self._server = start_server("127.0.0.1", 0)
        self._gate = Gate(host, outer, self._server.get_port(), is_open=not is_loopback(host))
        self.port: int = self._gate.port
        self.address, self.remarks = address_of(self._gate, host), remarks_of(self._gate, host, port)
        self._frames, self._complain, self._wanted = frames, complain, frame
        self._changed, self._todo = threading.Condition(), dict[str, Callable[[], None]]()
        self._world = World("", "nothing yet", is_live=True)
        self._drawn: Drawn | None = None
        self._rig: Rig | None = None
        self._stale: set[str] = set()
        self._clouds, self._faults = set[int](), dict[int, str]()
        self._pictures: dict[int, Any] = {}
        self._shown_of: int | None = None
        self._due = 0.0
        self._stage, self._panel = Stage(self._server), Panel(self._server.gui)
        self._panel.on_change(self.ask, {
            "source": self._draw, "layer": self._recolour, "switches": self._switch, "ceiling": self._recolour,
            "time": self._seek, "play": lambda: None, "follow": self._show_now, "overlay": self._show_now,
        })  # fmt: skip
        self._panel.views.on_click(lambda event: self.ask("look", partial(self._look, event.target.value)))
        self._server.scene.on_click()(self._clicked)
        self._switch()

    def ask(self, name: str, job: Callable[[], None]) -> None:
        """Have something done by the thread that draws; of several of one name, the last.

        Parameters
        ----------
        name : str
            What it is.
        job : callable
            Called without arguments.
        """
        with self._changed:
            self._todo[name] = job
            self._changed.notify()

    def work(self, seconds: float = _IDLE) -> None:
        """Do what was asked for, or wait for it a while.

        Parameters
        ----------
        seconds : float
            How long to wait at most, s.
        """
        with self._changed:
            if not self._todo:
                self._changed.wait(min(seconds, _PLAY) if self._panel.play.value or self._due_pictures() else seconds)
            jobs, self._todo = list(self._todo.values()), {}
        for job in jobs:
            job()
        if self._panel.play.value and time.monotonic() >= self._due:
            self._step()
        if not jobs and self.is_watched:
            self._add_picture()

    def show(self, world: World) -> None:
        """Show a run as it is now.

        Parameters
        ----------
        world : World
            What is known of it.
        """
        at, before, self._world = self._station(), self._world, world
        is_new = len(world.stations) != len(before.stations) or (world.map_ is None) != (before.map_ is None)
        if before.map_ is not None and world.map_ is None:
            self._drawn = None  # the run was begun anew
            self._clouds.clear()
            self._faults.clear()
        for number in world.stored:
            if world.map_ is None and number not in self._clouds:
                self._add_cloud(number)
        self._panel.show_status(world, list(self._faults.values()))
        if is_new or world.is_live != before.is_live:
            if at is not None:
                self._seek_number(at.number)  # a finished run has more frames than the one that went on
            self._draw_path()
            self._go_to_newest()
        if self._drawn is None or is_new:
            self._draw()
        if world.map_ is not None and before.map_ is None:
            self._stage.remove_clouds()
            self._show_clouds(False)
            self._drop_pictures(set(self._pictures))  # poses are others now
        self._panel.show_status(world, list(self._faults.values()))

    def show_shot(self, shot: Shot) -> None:
        """Show the newest frame of a run that goes on, which may be no keyframe.

        Parameters
        ----------
        shot : Shot
            The frame.
        """
        self._rig = shot.rig
        if self._panel.follow.value and self._world.is_live and self.is_watched:
            pixels = pixels_of(shot.jpeg)
            self._stage.draw_now(shot.T_world_camera, shot.rig, None)
            self._stage.look_along(shot.T_world_camera)
            self._panel.show_now(shot.number, shot.state, shot.number, pixels)

    @property
    def is_watched(self) -> bool:
        """Whether a page is open."""
        return bool(self._server.get_clients())

    def close(self) -> None:
        """Stop serving."""
        self._gate.close()
        self._server.stop()

    def _frame(self, number: int) -> Frame | None:
        """Read a frame; one that cannot be read is named, once."""
        if number in self._faults:
            return None
        try:
            frame = self._frames(number)
        except InputError as error:
            self._faults[number] = str(error)
            self._complain(str(error))
            return None
        self._rig = frame.rig
        return frame

    def _pose(self, number: int) -> FloatArray | None:
        return next((each.T_world_camera for each in self._world.stations if each.number == number), None)

    def _add_cloud(self, number: int) -> None:
        self._clouds.add(number)
        frame, pose = self._frame(number), self._pose(number)
        if frame is not None and pose is not None and len(frame.cloud):
            if len(self._clouds) == 1:
                self._stage.look_from_behind(self._world.stations, _placed(frame, pose))
                self._show_clouds(True)
            self._stage.add_cloud(frame, pose)

    def _show_clouds(self, is_on: bool) -> None:
        """Points are what there is to see of a run until its map is there."""
        put(self._panel.switches["points"], "value", is_on)
        self._switch()

    def _draw_path(self) -> None:
        world, rig = self._world, self._rig
        if not world.stations:
            return
        if world.map_ is not None:
            rig = self._rig = world.map_.rig
            self._stage.look_from_behind(world.stations, world.map_.xyz)
        self._stage.draw_path(world.stations)
        self._stage.draw_loops(world.loops, world.stations)
        if rig is None and world.stored:
            self._frame(world.stored[0])
            rig = self._rig
        if rig is not None:
            self._stage.draw_cameras(world.stations, rig)

    def _draw(self) -> None:
        """Draw the surface of what is chosen: the map, or the frame of the slider."""
        drawn = self._choose()
        if drawn is None or drawn is self._drawn:
            return
        self._drawn = drawn
        self._panel.offer(drawn.layers, has_ceiling=bool(drawn.is_ceiling.any()))
        if not len(drawn.faces):
            put(self._panel.switches["points"], "value", True)
        self._show_element(None)
        self._recolour()

    def _choose(self) -> Drawn | None:
        map_ = self._world.map_
        if map_ is not None and self._panel.source.value == MAP and self._wanted is None:
            return self._drawn if self._drawn is not None and self._drawn.source is map_ else draw_map(map_)
        station = self._station()
        number = self._wanted if self._wanted is not None else self._stored_at(station)
        if self._wanted is not None:
            put(self._panel.source, "value", FRAME)
            self._seek_number(self._wanted)
        self._wanted = None
        if number is None or (self._drawn is not None and getattr(self._drawn.source, "index", None) == number):
            return self._drawn
        frame, pose = self._frame(number), self._pose(number)
        if frame is None:
            return self._drawn
        pose = frame.T_world_camera if pose is None else pose
        drawn = draw_frame(frame, pose)
        if self._drawn is None and len(drawn.xyz) and self._world.stations:
            self._stage.look_from_behind(self._world.stations, drawn.xyz)
        return drawn

    def _recolour(self) -> None:
        self._stale = {"surface", "edges", "points"}
        layer = self._layer()
        self._panel.show_legend(layer)
        if layer is not None and layer.level == "edge":
            put(self._panel.switches["edges"], "value", True)
        self._switch()

    def _switch(self) -> None:
        """Show what is switched on; what is stale is drawn anew when it is seen."""
        on = {name for name in SWITCHES if self._panel.switches[name].value}
        if self._drawn is not None:
            for name in sorted(on & self._stale):
                self._draw_part(name, self._drawn)
                self._stale.discard(name)
        for name in SWITCHES:
            self._stage.switch(name, name in on)

    def _draw_part(self, name: str, drawn: Drawn) -> None:
        layer, has_ceiling = self._layer(), self._has_ceiling()
        if name == "surface":
            self._stage.draw_surface(drawn, layer, has_ceiling=has_ceiling)
        elif name == "edges":
            self._stage.draw_edges(drawn, layer, has_ceiling=has_ceiling)
        else:
            self._stage.draw_points(drawn, layer, has_ceiling=has_ceiling)

    def _layer(self) -> Any:
        chosen, layers = self._panel.layer.value, self._drawn.layers if self._drawn is not None else []
        return next((each for each in layers if each.label == chosen), None)

    def _has_ceiling(self) -> bool:
        return bool(self._panel.ceiling.value)

    def _chosen_keyframes(self) -> list[Station]:
        stored = set(self._world.stored)
        keyframes = [each for each in self._world.stations if each.state == "keyframe" and each.number in stored]
        step = 1
        while len(keyframes) > PICTURES * step:
            step *= 2  # so that those chosen before stay, while a run goes on
        return keyframes[::step]

    def _due_pictures(self) -> bool:
        return self.is_watched and any(each.number not in self._pictures for each in self._chosen_keyframes())

    def _drop_pictures(self, numbers: Set[int]) -> None:
        for number in numbers:
            node = self._pictures.pop(number)
            if node is not None:
                node.remove()

    def _add_picture(self) -> None:
        """One more keyframe's image in its place; those that are chosen no more go."""
        chosen = self._chosen_keyframes()
        self._drop_pictures(self._pictures.keys() - {each.number for each in chosen})
        for each in chosen:
            if each.number not in self._pictures:
                frame = self._frame(each.number)
                self._pictures[each.number] = None if frame is None or frame.image is None else self._stage.add_picture(
                    each.number, each.T_world_camera, frame.rig, shrunk(frame.image, THUMBNAIL)
                )  # fmt: skip
                return

    def _station(self) -> Station | None:
        stations = self._world.stations
        return stations[min(int(self._panel.time.value), len(stations) - 1)] if stations else None

    def _stored_at(self, station: Station | None) -> int | None:
        """The last stored frame up to a station, or the first one of all."""
        stored = self._world.stored
        if not stored or station is None:
            return stored[0] if stored else None
        return max((number for number in stored if number <= station.number), default=stored[0])

    def _go_to_newest(self) -> None:
        if self._world.is_live and self._panel.follow.value and self._world.stations:
            put(self._panel.time, "value", len(self._world.stations) - 1)
        self._show_now()

    def _seek(self) -> None:
        """A person moved the slider: the newest frame is followed no more."""
        put(self._panel.follow, "value", False)
        self._show_now()
        if self._panel.source.value == FRAME or self._world.map_ is None:
            self._draw()

    def _seek_number(self, number: int) -> None:
        numbers = [each.number for each in self._world.stations]
        if number in numbers:
            put(self._panel.time, "value", numbers.index(number))

    def _step(self) -> None:
        """Play: on to the next frame; the last one ends it."""
        self._due = time.monotonic() + _PLAY
        at, last = int(self._panel.time.value), len(self._world.stations) - 1
        put(self._panel.play, "value", at + 1 < last)
        if at < last:
            put(self._panel.time, "value", at + 1)
            self._seek()

    def _show_now(self) -> None:
        station = self._station()
        if station is None:
            return
        number = self._stored_at(station)
        frame = None if number is None else self._frame(number)
        pixels = None if frame is None else overlaid(frame, OVERLAYS[self._panel.overlay.value])
        self._panel.show_now(station.number, station.state, number, pixels)
        if self._rig is not None:
            self._stage.draw_now(station.T_world_camera, self._rig, None)

    def _look(self, view: str) -> None:
        station = self._station()
        if view == BEGINNING:
            self._stage.look_as_first()
        elif view == ABOVE:
            self._stage.look_from_above(self._world.stations)
        elif station is not None:
            self._stage.look_along(station.T_world_camera)

    def _clicked(self, event: Any) -> None:
        origin, along = np.array(event.ray_origin, float), np.array(event.ray_direction, float)
        self.ask("click", lambda: self._show_element(self.pick(origin, along)))

    def pick(self, origin: FloatArray, along: FloatArray) -> Element | None:
        """Find what a ray meets first: an element of the level that is coloured.

        Parameters
        ----------
        origin, along : (3,) float64
            Where the ray begins, m, and its unit direction, in the world.

        Returns
        -------
        Element or None
            None if it meets nothing.
        """
        drawn, layer = self._drawn, self._layer()
        if drawn is None:
            return None
        if self._panel.switches["surface"].value or self._panel.switches["edges"].value:
            found = drawn.hit(origin, along, has_ceiling=self._has_ceiling())
            if found is not None:
                return element_at(drawn, *found, "face" if layer is None else layer.level)
        if self._panel.switches["points"].value:
            vertex = drawn.nearest_vertex(origin, along)
            return None if vertex is None else element_of(drawn, "vertex", vertex)
        return None

    def _show_element(self, element: Element | None) -> None:
        if self._drawn is not None:
            self._stage.mark(self._drawn, element)
        self._panel.show_element(element, None if element is None else self._patches(element))

    def _patches(self, element: Element) -> Pixels | None:
        """What the frames that see it best show around it."""
        found = []
        for each in element.sightings:
            frame = self._frame(each.number) if each.number in self._world.stored else None
            if frame is not None and frame.image is not None and np.isfinite(each.uv).all():
                found.append(patch(frame.image, each.uv, f"frame {each.number}"))
            if len(found) == PATCHES:
                break
        return sheet(found) if found else None


def _placed(frame: Frame, T: FloatArray) -> FloatArray:
    xyz = frame.cloud.xyz[np.isfinite(frame.cloud.xyz).all(axis=1)]
    return np.asarray(xyz @ T[:3, :3].T + T[:3, 3])
