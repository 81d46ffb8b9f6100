"""What people press beside the scene, by viser; each press is one call of the session."""

import html
import threading
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..asking import Named
from ..errors import DrSplatError
from ..palette import class_colors
from . import painting, saving
from .cameras import before
from .naming import This, photo_of
from .page import said_of
from .session import Mode
from .uploads import picture_in
from .window import Window

MOST_LISTED = 12  # things
STEP = 0.001  # of the slider
MOST_SENT = 64 << 20  # bytes of a file that a browser is offered as well
PICTURE_SIZE = (1280, 960)
PLACEHOLDER = "Ask for something, such as *mug*, *mug; lamp* or *mug, not red*."


class Panel:
    """The controls of a window. Files are written to `folder`."""

    def __init__(self, window: Window, folder: Path) -> None:
        self.window, self.session, self.folder = window, window.session, folder
        self.gui = window.server.gui
        self._lock = threading.RLock()
        self._wanted: float | None = None  # the slider's latest place
        self._listed: list[Any] = []
        self._build()
        window.server.scene.on_click()(self._clicked)

    # --- making the controls ---

    def _build(self) -> None:
        self._title()
        with self.gui.add_form(None) as form:
            self.text = self.gui.add_text(
                "Look for", "", hint='Press enter. Several: "mug; lamp". Without: "mug, not red".'
            )
        form.on_submit(lambda _: self._ask())
        self._button("Ask", lambda _: self._ask())
        self.upload = self.gui.add_upload_button("Look for a picture", mime_type="image/*")
        self.upload.on_upload(lambda _: self._ask_picture())
        self.told = self.gui.add_markdown(PLACEHOLDER)
        self._build_answer()
        self._build_show()
        self._build_this()
        self._build_edit()
        self._build_save()

    def _title(self) -> None:
        shown, scene = self.session.shown, self.session.scene
        note = f" {shown.said}" if shown.said else ""
        self.gui.add_markdown(
            f"**{_plain(scene.name)}** {len(scene.gaussians):,} Gaussians, {len(scene.field):,} with a feature.{note}"
        )

    def _build_answer(self) -> None:
        self.answer = self.gui.add_folder("Found")
        with self.answer:
            self.which = self.gui.add_dropdown("Threshold of", ("-",), visible=False)
            self.which.on_update(lambda _: self._new_slider())
            self.slider: Any = None
        self._new_slider()

    def _build_show(self) -> None:
        with self.gui.add_folder("Show"):
            names = tuple(mode.value for mode in Mode)
            self.mode = self.gui.add_dropdown("Colours", names, initial_value=Mode.SCENE.value)
            self.mode.on_update(lambda event: self._set_mode(event))
            boxes = self.gui.add_checkbox("Boxes and names", True)
            boxes.on_update(lambda _: self._set_boxes(boxes.value))
            if self.session.scene.views:
                cameras = self.gui.add_checkbox("Cameras of the photos", False)
                cameras.on_update(lambda _: self.window.show_cameras(cameras.value))
            with self.gui.add_form(None) as form:
                self.classes = self.gui.add_text("Classes", "", hint="mug, bowl, table")
            form.on_submit(lambda _: self._classify())
            self.legend = self.gui.add_html("")

    def _build_this(self) -> None:
        with self.gui.add_folder("What is this?"):
            self.this = self.gui.add_markdown("Click something in the scene.")
            blank = np.zeros((2, 2, 3), np.uint8)
            self.photo = self.gui.add_image(blank, visible=False)
            self.more = self._button("More like this", lambda _: self._more())
            self.more.visible = False

    def _build_edit(self) -> None:
        session = self.session
        with self.gui.add_folder("Edit what was found", expand_by_default=False):
            self._button("Keep only this", self._changing(session.keep))
            self._button("Hide", self._changing(session.hide))
            color = self.gui.add_rgb("Colour", painting.accent(1))
            self._button("Recolour", self._changing(lambda: session.repaint(color.value)))
            self._button("Show all again", self._changing(session.restore))

    def _build_save(self) -> None:
        with self.gui.add_folder("Save", expand_by_default=False):
            self._button("Scene as PLY", lambda event: self._save_ply(event, False))
            self._button("Selection as PLY", lambda event: self._save_ply(event, True))
            self._button("Picture as PNG", self._save_png)
            self._button("Flight as GIF", self._save_gif)
            self.saved = self.gui.add_markdown("")

    def _button(self, label: str, act: Callable[[Any], None]) -> Any:
        button = self.gui.add_button(label)
        button.on_click(act)
        return button

    # --- asking ---

    def ask(self, text: str) -> None:
        """As if it had been typed."""
        self.text.value = text
        self._ask()

    def _ask(self) -> None:
        with self._doing():
            self.session.ask(self.text.value)
            self._answered()

    def _ask_picture(self) -> None:
        with self._doing():
            file = self.upload.value
            self.session.ask_picture(picture_in(file.content), file.name)
            self._answered()

    def _more(self) -> None:
        with self._doing():
            self.session.more_like_this()
            self._answered()

    def _answered(self) -> None:
        """Show a new answer: in the scene first, then beside it."""
        self.window.repaint()
        labels = tuple(result.label for result in self.session.results)
        self.which.options = labels or ("-",)
        self.which.value = self.which.options[0]
        self.which.visible = len(labels) > 1
        self._new_slider()
        self._follow()

    def _follow(self) -> None:
        """The words and the list, after the answer or its threshold has changed."""
        self.mode.value = self.session.mode.value
        self.told.content = "\n\n".join(_plain(result.said) for result in self.session.results)
        for button in self._listed:
            button.remove()
        things = [
            (number, one.thing)
            for number, result in enumerate(self.session.results)
            for one in result.found
        ]
        with self.answer:
            self._listed = [
                self._fly_button(number, thing) for number, thing in things[:MOST_LISTED]
            ]
            if len(things) > MOST_LISTED:
                more = f"and {len(things) - MOST_LISTED} more"
                self._listed.append(self.gui.add_markdown(more))

    def _fly_button(self, number: int, thing: Any) -> Any:
        label = self.session.results[number].label
        place = " ".join(f"{x:.1f}" for x in thing.center)
        short = f"{label} {thing.score:.2f} · {thing.extent.max():.2f} long · {place}"
        button = self.gui.add_button(
            short, color=painting.accent(number), hint=f"Fly to {label}: {said_of(thing)}"
        )
        button.on_click(lambda event: self._fly(event, thing))
        return button

    def _fly(self, event: Any, thing: Any) -> None:
        scene = self.session.scene
        eye = before(thing, scene.gaussians, scene.views, self.window.up)
        self.window.fly(event.client, eye, thing.center)

    # --- the threshold ---

    def _new_slider(self) -> None:
        """Of the query chosen, with its own threshold marked."""
        if self.slider is not None:
            self.slider.remove()
        with self.answer:
            if not self.session.results:
                self.slider = self.gui.add_slider("Threshold", 0, 1, 0.01, 0.5, visible=False)
                return
            result = self.session.results[self._chosen]
            low, high = result.limits
            low, high = np.floor(low / STEP) * STEP, np.ceil(high / STEP) * STEP
            value = round(float(np.clip(result.threshold, low, high)), 3)
            self.slider = self.gui.add_slider(
                "Threshold", round(low, 3), round(high, 3), STEP, value,
                order=self.which.order + 1e-3, marks=((round(result.asked.threshold, 3), "auto"),),
                hint=f"{result.asked.measure} above which a Gaussian is found; the mark is the rule's choice ({result.asked.rule})",
            )  # fmt: skip
            self.slider.on_update(lambda event: self._cut(event))

    @property
    def _chosen(self) -> int:
        labels = [result.label for result in self.session.results]
        return labels.index(self.which.value) if self.which.value in labels else 0

    def _cut(self, event: Any) -> None:
        """Of many places on the way of a hand, only the latest is shown."""
        if event.client is None:
            return
        self._wanted = wanted = self.slider.value
        with self._doing():
            if self._wanted != wanted:
                return
            self.session.set_threshold(self._chosen, float(wanted))
            self.window.repaint()
            self._follow()

    # --- showing ---

    def _set_mode(self, event: Any) -> None:
        if event.client is None:  # set by us
            return
        with self._doing():
            self.session.mode = Mode(self.mode.value)
            self.window.repaint()

    def _set_boxes(self, wanted: bool) -> None:
        with self._doing():
            self.window.boxes = wanted
            self.window.repaint()

    def _classify(self) -> None:
        with self._doing():
            classes = self.session.classify(self.classes.value.split(","))
            counts = np.bincount(classes.labels[classes.labels >= 0], minlength=len(classes.names))
            self.legend.content = legend_html(classes.names, counts)
            self.mode.value = self.session.mode.value
            self.window.repaint()

    def _clicked(self, event: Any) -> None:
        with self._doing():
            this = self.session.click(np.array(event.ray_origin), np.array(event.ray_direction))
            self.more.visible = this is not None
            self.this.content = (
                "Nothing with a feature is there." if this is None else said_of_this(this)
            )
            photo = None if this is None else photo_of(self.session.scene, this)
            self.photo.visible = photo is not None
            if photo is not None:
                self.photo.image = photo

    def _changing(self, change: Callable[[], None]) -> Callable[[Any], None]:
        def act(_: Any) -> None:
            with self._doing():
                change()
                self.window.repaint()
                self.mode.value = self.session.mode.value

        return act

    # --- saving ---

    def _save_ply(self, event: Any, selected_only: bool) -> None:
        with self._doing():
            path = saving.new_name(self.folder, "selection" if selected_only else "found", ".ply")
            path.parent.mkdir(parents=True, exist_ok=True)
            count = saving.save_scene(path, self.session, selected_only=selected_only)
            self._tell_saved(event, path, f"{count:,} Gaussians")

    def _save_png(self, event: Any) -> None:
        with self._doing():
            view = self.window.seen_by(event.client, PICTURE_SIZE)
            self._save_bytes(event, saving.png_of(saving.picture_of(self.session, view)), ".png")

    def _save_gif(self, event: Any) -> None:
        with self._doing():
            frame, camera = self.session.shown.frame, event.client.camera
            eye, target = (frame.world(np.array(x)) for x in (camera.position, camera.look_at))
            found = [one.thing for result in self.session.results for one in result.found]
            if found:
                scene, target = self.session.scene, found[0].center
                eye = before(found[0], scene.gaussians, scene.views, self.window.up)
            data = saving.flight_gif(self.session, eye, target, self.window.up)
            self._save_bytes(event, data, ".gif")

    def _save_bytes(self, event: Any, data: bytes, suffix: str) -> None:
        path = saving.new_name(self.folder, "found", suffix)
        path.parent.mkdir(parents=True, exist_ok=True)
        saving.write_bytes(path, data)
        self._tell_saved(event, path, "")

    def _tell_saved(self, event: Any, path: Path, note: str) -> None:
        self.saved.content = f"Saved `{path}` {note}"
        if path.stat().st_size <= MOST_SENT:
            event.client.send_file_download(path.name, path.read_bytes())

    @contextmanager
    def _doing(self) -> Any:
        """One thing at a time; what goes wrong is said, and leaves what is shown as it was."""
        with self._lock:
            try:
                yield
            except (DrSplatError, OSError) as error:
                self.told.content = f"**{_plain(str(error))}**"


def said_of_this(this: This) -> str:
    """Its best words, and the photos and masks behind it, as Markdown."""
    place = ", ".join(f"{x:.2f}" for x in this.point)
    lines = [_bold(this.words[0]) if this.words else "No encoder here has words for it."]
    if len(this.words) > 1:
        others = (f"{_plain(one.text)} {one.score:.2f}" for one in this.words[1:])
        lines.append("or " + ", ".join(others))
    lines.append(f"at {place}")
    masks = [
        f"{_plain(one.view_name)}, mask {one.segment_id} ({one.share:.0%})" for one in this.evidence
    ]
    if masks:
        lines.append("Seen in " + "; ".join(masks))
    return "\n\n".join(lines)


def _bold(word: Named) -> str:
    return f"**{_plain(word.text)}** {word.score:.2f}"


def legend_html(names: tuple[str, ...], counts: np.ndarray) -> str:
    """A swatch, a name and a number of Gaussians on each line."""
    spot = "display:inline-block;width:.8em;height:.8em;border-radius:3px;margin-right:.6em"
    lines = [
        f'<div><span style="{spot};background:rgb({",".join(map(str, color))})"></span>{html.escape(name)} '
        f'<span style="opacity:.6">{count:,}</span></div>'
        for name, color, count in zip(names, class_colors(len(names)), counts, strict=True)
    ]
    return f'<div style="padding:.3em 1em;font-size:.85em">{"".join(lines)}</div>'


def _plain(text: str) -> str:
    """Text that Markdown leaves alone."""
    return "".join(f"\\{letter}" if letter in r"\`*_{}[]<>#|~$" else letter for letter in text)
