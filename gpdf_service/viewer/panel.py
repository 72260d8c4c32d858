"""The widgets beside the picture; what they do is with the parts of the page that own them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import viser

from gpdf_service.types import FloatArray
from gpdf_service.viewer import colours
from gpdf_service.viewer.body import Body
from gpdf_service.viewer.profile import ProfileCharts
from gpdf_service.viewer.widgets import put

if TYPE_CHECKING:
    from viser._gui_handles import GuiProgressBarHandle

TYPED = "x, y or x, y, z of the ground [m], or the name of a place"
METHODS = tuple(colours.METHODS)
CLICKS = ("start", "goal", OBSTACLE := "obstacle")
ALL_STOREYS = "all of them"
NO_SCENE = "(none)"
SHARE = "Copy the link"
SLICES = {"none": "", "distance to the ground (d_g)": "ground", "distance to obstacles (d_o)": "obstacle"}
LAYERS = {"cloud": "Cloud", "ground": "Ground", "obstacles": "What stops the body", "leaves": "Where it fits (leaves)"}
CLOUDS = ".ply,.pcd,.xyz,.txt,.csv,.asc,.pts,.npy,.npz,.las,.laz,.e57,.obj,.stl,.off,.dae,.glb,.gltf"
"""What can be sent."""
CLOUD_COLOURS = ("height", "level", "ground")
AS_SCANNED = "as scanned"
"""Of a scene whose scan had colours."""
MOST_APART = 10.0
"""[m] Between two storeys, more than they are high."""
SHOWN_BELOW = 1.5
"""[m] Over the ground, at first."""


@dataclass(frozen=True, slots=True)
class DropTools:
    """Put obstacles on the ground, and take them away."""

    radius: viser.GuiSliderHandle[float]
    folder: viser.GuiFolderHandle
    chosen: viser.GuiDropdownHandle[str]
    remove: viser.GuiButtonHandle
    remove_all: viser.GuiButtonHandle


@dataclass(frozen=True, slots=True)
class PlanTab:
    """Ask for a path, and read the answer."""

    body: Body
    method: viser.GuiDropdownHandle[str]
    sets: viser.GuiButtonGroupHandle
    drops: DropTools
    next: viser.GuiMarkdownHandle
    answer: viser.GuiMarkdownHandle
    refusal: viser.GuiHtmlHandle
    nearest: viser.GuiButtonHandle
    typed: dict[str, viser.GuiTextHandle]
    take: viser.GuiButtonHandle
    plan: viser.GuiButtonHandle
    compare_methods: viser.GuiButtonHandle
    compare_bodies: viser.GuiButtonHandle
    clear: viser.GuiButtonHandle
    share: viser.GuiButtonHandle
    table: viser.GuiHtmlHandle
    legend: viser.GuiHtmlHandle
    time: viser.GuiSliderHandle[float]
    play: viser.GuiCheckboxHandle
    charts: ProfileCharts
    details: viser.GuiMarkdownHandle


@dataclass(frozen=True, slots=True)
class MapTab:
    """Choose what is shown of the scene."""

    layers: dict[str, viser.GuiCheckboxHandle]
    legend: viser.GuiHtmlHandle
    colour: viser.GuiDropdownHandle[str]
    below: viser.GuiSliderHandle[float]
    size: viser.GuiSliderHandle[float]
    slice: viser.GuiDropdownHandle[str]
    height: viser.GuiSliderHandle[float]
    slice_legend: viser.GuiHtmlHandle
    facts: viser.GuiMarkdownHandle


@dataclass(frozen=True, slots=True)
class LoadTab:
    """Bring a scene into the service."""

    name: viser.GuiTextHandle
    file: viser.GuiTextHandle
    load: viser.GuiButtonHandle
    upload: viser.GuiUploadButtonHandle
    look: viser.GuiButtonHandle


@dataclass(frozen=True, slots=True)
class LogTab:
    """Step through a recorded log."""

    open: viser.GuiUploadButtonHandle
    text: viser.GuiMarkdownHandle
    step: viser.GuiSliderHandle[int]
    sides: viser.GuiButtonGroupHandle
    again: viser.GuiButtonHandle


@dataclass(frozen=True, slots=True)
class Panel:
    """All of it."""

    link: viser.GuiMarkdownHandle
    scene: viser.GuiDropdownHandle[str]
    storey: viser.GuiDropdownHandle[str]
    apart: viser.GuiSliderHandle[float]
    bar: GuiProgressBarHandle
    work: viser.GuiMarkdownHandle
    key: viser.GuiHtmlHandle
    plan: PlanTab
    map: MapTab
    load: LoadTab
    log: LogTab

    def say_work(self, text: str, share: float | None = None) -> None:
        """What is being fetched, loaded or built, and how much of it is done."""
        self.work.content, self.work.visible = text, bool(text)
        self.bar.visible = share is not None
        if share is not None:
            put(self.bar, 100.0 * share)

    def say_answer(self, text: str) -> None:
        """What became of the plan."""
        self.plan.answer.content = text


def build_panel(gui: viser.GuiApi) -> Panel:
    """Make the widgets."""
    gui.configure_theme(control_width="large", show_logo=False, show_share_button=False, brand_color=(0, 114, 178))
    link = gui.add_markdown("Looking for the service …")
    scene = gui.add_dropdown("Scene", (NO_SCENE,))
    storey = gui.add_dropdown("Storey", (ALL_STOREYS,), visible=False)
    apart = gui.add_slider("Pull apart [m]", 0.0, MOST_APART, 0.5, 0.0, visible=False)
    bar = gui.add_progress_bar(0.0, visible=False)
    work = gui.add_markdown("", visible=False)
    key = gui.add_html(key_of(CLOUD_COLOURS[0], SHOWN_BELOW))
    tabs = gui.add_tab_group()
    with tabs.add_tab("Plan"):
        plan = _plan_tab(gui)
    with tabs.add_tab("Map"):
        shown = _map_tab(gui)
    with tabs.add_tab("Load"):
        load = _load_tab(gui)
    with tabs.add_tab("Log"):
        log = _log_tab(gui)
    return Panel(link, scene, storey, apart, bar, work, key, plan, shown, load, log)


def _plan_tab(gui: viser.GuiApi) -> PlanTab:
    return PlanTab(
        body=Body(gui),
        method=gui.add_dropdown("Method", METHODS),
        sets=gui.add_button_group("Next click", CLICKS),
        drops=_drop_tools(gui),
        next=gui.add_markdown(""),
        answer=gui.add_markdown(""),
        refusal=gui.add_html("", visible=False),
        nearest=gui.add_button("", visible=False),
        typed={name: gui.add_text(name.capitalize(), "", hint=TYPED) for name in ("start", "goal")},
        take=gui.add_button("Take what is typed", color="gray"),
        plan=gui.add_button("Plan", disabled=True),
        compare_methods=gui.add_button("Compare the methods", disabled=True, color="gray"),
        compare_bodies=gui.add_button("Compare the bodies", disabled=True, color="gray"),
        clear=gui.add_button("Clear", color="gray"),
        share=gui.add_button(SHARE, color="gray", hint="The address of this page holds scene, view and plan."),
        table=gui.add_html("", visible=False),
        legend=gui.add_html(gradient(colours.ROOM, "0 m", f"{colours.ENOUGH_ROOM} m of clearance"), visible=False),
        time=gui.add_slider("Time [s]", 0.0, 1.0, 0.01, 0.0, visible=False),
        play=gui.add_checkbox("Play", False, visible=False),
        charts=ProfileCharts(gui),
        details=gui.add_markdown(""),
    )


def _drop_tools(gui: viser.GuiApi) -> DropTools:
    radius = gui.add_slider("Radius [m]", 0.05, 1.0, 0.05, 0.3, visible=False)
    folder = gui.add_folder("Dropped obstacles", visible=False)
    with folder:
        chosen = gui.add_dropdown("Obstacle", ("",))
        remove = gui.add_button("Remove it", color="gray")
        remove_all = gui.add_button("Remove all", color="gray")
    return DropTools(radius, folder, chosen, remove, remove_all)


def _map_tab(gui: viser.GuiApi) -> MapTab:
    layers = {name: gui.add_checkbox(text, name in ("cloud", "ground")) for name, text in LAYERS.items()}
    return MapTab(
        layers=layers,
        legend=gui.add_html(legend(0)),
        colour=gui.add_dropdown("Cloud by", CLOUD_COLOURS),
        below=gui.add_slider(
            "Up to [m]", 0.1, 6.0, 0.1, SHOWN_BELOW, hint="Points higher over their ground are not shown."
        ),
        size=gui.add_slider("Points [m]", 0.005, 0.1, 0.005, 0.02),
        slice=gui.add_dropdown("Slice", tuple(SLICES)),
        height=gui.add_slider("At height [m]", 0.0, 3.0, 0.05, 0.5, hint="Over the lowest point of the scene."),
        slice_legend=gui.add_html("", visible=False),
        facts=gui.add_markdown(""),
    )


def _load_tab(gui: viser.GuiApi) -> LoadTab:
    return LoadTab(
        name=gui.add_text("Name", "office"),
        file=gui.add_text("File", "office.ply", hint="In the service's scenes folder."),
        load=gui.add_button("Load the file"),
        upload=gui.add_upload_button("Send a cloud from here …", mime_type=CLOUDS),
        look=gui.add_button("Look for scenes again", color="gray"),
    )


def _log_tab(gui: viser.GuiApi) -> LogTab:
    return LogTab(
        open=gui.add_upload_button("Open a log (.mcap) …", mime_type=".mcap"),
        text=gui.add_markdown("A service writes one each time that it runs, into its `--log-dir`."),
        step=gui.add_slider("Request", 1, 2, 1, 1, visible=False),
        sides=gui.add_button_group("Step", ("back", "on"), visible=False),
        again=gui.add_button("Ask the service again", visible=False, color="gray"),
    )


def gradient(shades: FloatArray, low: str, high: str) -> str:
    """A colour bar with its ends named."""
    stops = ", ".join(colours.css(colour) for colour in shades)
    bar = f"height:10px;border-radius:3px;background:linear-gradient(to right,{stops})"
    ends = f"<div style='display:flex;justify-content:space-between'><span>{low}</span><span>{high}</span></div>"
    return f"<div style='padding:0 1em 0.5em;font-size:0.8em'><div style='{bar}'></div>{ends}</div>"


def key_of(colour: str, below: float) -> str:
    """What the colours of ground and cloud mean, of a cloud that is drawn by `colour` up to a height [m]."""
    named = [("ground", colours.SEEN), ("inferred: nobody saw it", colours.INFERRED)]
    if colour == AS_SCANNED:
        named = [named[1], ("came without a colour", colours.NOWHERE)]
    if colour == "ground":
        named.append(("other points", colours.KINDS[0]))
    bar = gradient(colours.PALE, "things at 0 m", f"{below:g} m over the ground") if colour == "height" else ""
    return swatches(named) + bar


def legend(levels: int, step: float = 1.0) -> str:
    """What the colours of the layers mean, and how far two lines under the ground are apart [m]."""
    named = list(zip(colours.KIND_NAMES, colours.KINDS, strict=True))
    named += [(f"level {i}", colours.LEVELS[i % len(colours.LEVELS)]) for i in range(levels if levels > 1 else 0)]
    return swatches(named, f"<br>Lines under the ground: {step:g} m.")


def swatches(named: Iterable[tuple[str, colours.Colours | tuple[int, int, int]]], more: str = "") -> str:
    """Colours and what they mean, and more text below."""
    swatch = "display:inline-block;width:0.8em;height:0.8em;border-radius:2px;margin-right:0.35em;background:"
    items = [
        f"<span style='margin-right:1em;white-space:nowrap'><i style='{swatch}{colours.css(colour)}'></i>{name}</span>"
        for name, colour in named
    ]
    return f"<div style='padding:0 1em 0.5em;font-size:0.8em;line-height:1.7'>{''.join(items)}{more}</div>"
