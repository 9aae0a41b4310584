"""The panel beside the scene: status, colours with their legend, switches, time, the image, what was clicked."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from .._layers import Layer
from ._element import Element
from ._images import OVERLAYS, Pixels, blank
from ._stage import SWITCHES
from ._words import element_page, legend, status_page
from .world import State, World

MAP, FRAME = "Map", "Frame of the slider"
NONE = "No colours"
VIEWS = BEGINNING, ABOVE, ALONG = "First view", "From above", "Along path"
_FIRST_ON = ("surface", "path", "cameras", "pictures", "loops")
_QUALITY = 80  # of JPEG

Ask = Callable[[str, Callable[[], None]], None]


class Panel:
    """Controls of a server; what a person changes is asked for by name, so the last of many changes counts."""

    def __init__(self, gui: Any) -> None:
        gui.configure_theme(
            control_layout="collapsible", control_width="large", show_logo=False, show_share_button=False
        )
        gui.set_panel_label("tspslam")
        self.status = gui.add_html("")
        with gui.add_folder("Colours"):
            self.source = gui.add_dropdown("Surface of", (MAP, FRAME))
            self.layer = gui.add_dropdown("Colour", (NONE,))
            self.legend = gui.add_html(legend(None))
        self.views = gui.add_button_group("Look", VIEWS)
        with gui.add_folder("Time"):
            self.time = gui.add_slider("Frame", min=0, max=1, step=1, initial_value=0)
            self.play = gui.add_checkbox("Play", False)
            self.follow = gui.add_checkbox("Follow the newest", True, visible=False)
            self.now = gui.add_html("")
            self.overlay = gui.add_dropdown("Over the image", tuple(OVERLAYS))
            self.image = gui.add_image(blank(), format="jpeg", jpeg_quality=_QUALITY, visible=False)
        with gui.add_folder("What was clicked"):
            self.element = gui.add_html(element_page(None))
            self.patches = gui.add_image(blank(), format="jpeg", jpeg_quality=90, visible=False)
        with gui.add_folder("Layers"):
            self.switches = {name: gui.add_checkbox(name.capitalize(), name in _FIRST_ON) for name in SWITCHES}
            self.ceiling = gui.add_checkbox("Ceiling", False, hint="What looks down.", visible=False)

    def on_change(self, ask: Ask, jobs: dict[str, Callable[[], None]]) -> None:
        """Have a job of its name done when a person, and not the program, changes a control."""
        for name, job in jobs.items():
            for control in self.switches.values() if name == "switches" else (getattr(self, name),):
                control.on_update(_listener(ask, name, job))

    def show_status(self, world: World, faults: Sequence[str]) -> None:
        """Say how far the run is, and what is missing."""
        put(self.status, "content", status_page(world, faults))
        put(self.follow, "visible", world.is_live)
        put(self.source, "visible", world.map_ is not None)
        put(self.time, "max", max(len(world.stations) - 1, 1))

    def offer(self, layers: Sequence[Layer], *, has_ceiling: bool) -> None:
        """Name the layers that there are; the chosen one stays, if it is among them."""
        labels = *(each.label for each in layers), NONE
        was_none = self.layer.options == (NONE,)
        put(self.layer, "options", labels)
        if was_none:
            put(self.layer, "value", labels[0])
        put(self.ceiling, "visible", has_ceiling)

    def show_legend(self, layer: Layer | None) -> None:
        """Show the scale of the chosen layer."""
        put(self.legend, "content", legend(layer))

    def show_now(self, number: int, state: State, image_of: int | None, pixels: Pixels | None) -> None:
        """Name the frame that the slider is on, with its image or that of the last frame before that has one."""
        words = f"<div style='padding:0 1em;font-size:.85em'>frame {number}, {state}"
        if pixels is not None and image_of != number:
            words += f"; image of frame {image_of}"
        put(self.now, "content", words + "</div>")
        if pixels is not None:
            self.image.image = pixels
        put(self.image, "visible", pixels is not None)

    def show_element(self, element: Element | None, pixels: Pixels | None) -> None:
        """Show what was clicked, with patches of the images around it."""
        put(self.element, "content", element_page(element))
        if pixels is not None:
            self.patches.image = pixels
        put(self.patches, "visible", pixels is not None)


def put(control: Any, name: str, value: Any) -> None:
    """Set a property; nothing is sent where it is that already."""
    if getattr(control, name) != value:
        setattr(control, name, value)


def _listener(ask: Ask, name: str, job: Callable[[], None]) -> Callable[[Any], None]:
    def changed(event: Any) -> None:
        if event.client is not None:
            ask(name, job)

    return changed
