"""What people press beside the scene, by viser; each press is one call of the session, one after the other."""

import sys
import traceback
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DrSplatError
from ..filming.looking import before
from ..query import Match
from . import saving, texts
from .actions import Actions
from .bare import NO_FIELD
from .choosing import ChosenControls
from .edit_controls import EditControls
from .film import FilmControls, save_swing
from .finds import FindList, finds_of
from .keyboard import add_keys, flipped, next_of
from .legend import legend_html
from .naming import This, photo_of
from .object_list import ObjectList
from .playing import TimeControls, placed_now
from .prompts import prompt
from .saving import Saves
from .session import Mode
from .suggestions import suggestions
from .texts import escaped, paragraphs
from .uploads import picture_in
from .window import DARK, LIGHT, Window, themed

STEP = 0.001  # of the slider
PICTURE_SIZE = (1280, 960)
CLICK = paragraphs("Click something in the scene.")


class Panel:
    """The controls of a window. folder: where files are saved, None for nowhere but in the browser."""

    def __init__(self, window: Window, folder: Path | None = None) -> None:
        self.window, self.session, self.saves = window, window.session, Saves(folder)
        self.gui = window.server.gui
        self.actions, self.flights = Actions(), Actions()
        self._build()
        window.server.scene.on_click()(self._on_click)

    def close(self) -> None:
        """Act on nothing any more; the window stays."""
        self.window.server.scene.remove_click_callback(self._on_click)
        while self.keys:
            self.keys.pop().remove()
        self.film.is_playing = False
        self.actions.stop()
        self.flights.stop()

    def stop(self) -> None:
        self.close()
        self.window.stop()

    def _on_click(self, event: Any) -> None:
        self._do("click", event, self._clicked)

    # --- doing what was pressed ---

    def _do(self, what: str, event: Any, act: Callable[[Any], None]) -> None:
        """Later, after what was pressed before; pressed again meanwhile, it is done once."""
        client = None if event is None else event.client_id
        self.actions.do((what, client), lambda: self._done(act, event))

    def _done(self, act: Callable[[Any], None], event: Any) -> None:
        """What goes wrong is said until the next press, and leaves what is shown as it was."""
        self.fault.content, self.fault.visible = "", False
        try:
            act(event)
        except (DrSplatError, OSError, MemoryError) as error:
            self._complain(str(error) or type(error).__name__)
        except Exception as error:  # ours: the next press must find this thread alive
            traceback.print_exc(file=sys.stderr)
            self._complain(f"this went wrong here: {type(error).__name__}")

    def _complain(self, text: str) -> None:
        self.fault.content = paragraphs(f"<b style='color:#ff8f7a'>{escaped(text, 600)}</b>")
        self.fault.visible = True

    # --- making the controls ---

    def _build(self) -> None:
        self._title()
        askable = self.session.is_askable
        hint = 'Press enter. Several: "mug; lamp". Exclude: "mug, not red".'
        self.text = self._prompt("Query", hint, self._ask)
        self.asking = self._button("Ask", self._ask)
        self.text.visible = self.asking.visible = askable
        if askable:  # viser shows such a button, visible or not
            self.upload = self._taker("Query by picture", "image/*", self._ask_picture)
        self.fault = self.gui.add_html("", visible=False)
        self.told = self.gui.add_html(paragraphs("Enter a query.") if askable else paragraphs(NO_FIELD))
        self.tried = self.gui.add_button_group("Try", ("-",), visible=False)
        self.tried.on_click(lambda event: self._do("try", event, self._try))
        self._build_answer()
        self._build_show()
        self._build_this()
        self.editing = EditControls(self)
        if self.session.has_objects:
            self.objects = ObjectList(self.session, self.gui, self._button, self._list_pressed)
        self._build_save()
        self.film = FilmControls(self.window, self._button, self._taker, self._save, self.flights)
        self._build_keys()
        if askable:
            self._do("suggest", None, self._suggest)

    def _title(self) -> None:
        shown, scene = self.session.shown, self.session.scene
        note = f" {shown.said}" if shown.said else ""
        counted = f"{len(scene.gaussians):,} Gaussians, {len(scene.field):,} with a feature.{note}"
        self.gui.add_html(paragraphs(f"<b>{escaped(scene.name)}</b> {counted}"))

    def _taker(self, label: str, mime_type: str, act: Callable[[Any], None]) -> Any:
        made = self.gui.add_upload_button(label, mime_type=mime_type)
        made.on_upload(lambda event: self._do(label, event, act))
        return made

    def _prompt(self, label: str, hint: str, act: Callable[[Any], None]) -> Any:
        return prompt(self.gui, label, hint, lambda event: self._do(label, event, act))

    def _by_hand(self, control: Any, what: str, act: Callable[[Any], None]) -> None:
        """When people change a control, not when we do."""

        def changed(event: Any) -> None:
            if event.client is not None:
                self._do(what, event, act)

        control.on_update(changed)

    def _build_answer(self) -> None:
        self.answer = self.gui.add_folder("Matches", visible=self.session.is_askable)
        with self.answer:
            self.which = self.gui.add_dropdown("Threshold of", ("-",), visible=False, order=0.0)
            self._by_hand(self.which, "which", self._new_slider)
            self.slider: Any = None
        self.finds = FindList(self.gui, self.answer, self.fly)
        self._new_slider()

    def _build_show(self) -> None:
        askable = self.session.is_askable
        if self.session.scene.motion is not None:
            with self.gui.add_folder("Time"):
                self.playing = TimeControls(self.session, self.gui, self._do, self.window.repaint)
        with self.gui.add_folder("Show"):
            names = tuple(mode.value for mode in self.session.modes)
            self.mode = self.gui.add_dropdown("Colours", names, initial_value=Mode.SCENE.value)
            self._by_hand(self.mode, "mode", self._set_mode)
            if self.session.has_objects:
                everything = self._button("Everything", self._changing(self.session.everything))
                everything.hint = "Each object in a colour of its own; pressed again, the colours before"
            self.boxes = self.gui.add_checkbox("Boxes and names", True, visible=askable)
            self.boxes.on_update(lambda event: self._do("boxes", event, self._set_boxes))
            if self.session.scene.views:
                cameras = self.gui.add_checkbox("Cameras of the photos", False)
                show = self.window.show_cameras
                cameras.on_update(lambda event: self._do("cameras", event, lambda _: show(cameras.value)))
            self.look = self.gui.add_dropdown("Look", (DARK, LIGHT))
            self._by_hand(self.look, "look", self._set_look)
            self.classes = self._prompt("Classes", "mug, bowl, table", self._classify)
            self.classes.visible = askable
            self.legend = self.gui.add_html("")

    def _build_this(self) -> None:
        with self.gui.add_folder("What is this?", visible=self.session.is_askable):
            self.thing = self._build_thing() if self.session.has_objects else None
            self.this = self.gui.add_html(CLICK)
            blank = np.zeros((2, 2, 3), np.uint8)
            self.photo = self.gui.add_image(blank, visible=False)
            self.more = self._button("More like this", self._more)
            self.more.visible = False

    def _build_thing(self) -> ChosenControls:
        def naming(label: str, act: Callable[[Any], None]) -> Any:
            return self._prompt(label, "my mug", act)

        return ChosenControls(self.session, self.gui, self._button, naming, self._chose)

    def _build_save(self) -> None:
        with self.gui.add_folder("Save", expand_by_default=False):
            self._button("Scene as PLY", lambda event: self._save_ply(event, False))
            if self.session.is_askable:
                self._button("Selection as PLY", lambda event: self._save_ply(event, True))
            self._button("Picture as PNG", self._save_png)
            self._button("Flight as GIF", lambda event: save_swing(self.window, self._save, event))
            self.saved = self.gui.add_html("")

    def _button(self, label: str, act: Callable[[Any], None]) -> Any:
        button = self.gui.add_button(label)
        button.on_click(lambda event: self._do(label, event, act))
        return button

    def _build_keys(self) -> None:
        acts = {
            "Add key frame": ("K", self.film.add),
            "Play the path": ("P", self.film.play),
            "Boxes and names": ("B", flipped(self.boxes, self._set_boxes)),
            "Next colours": ("C", next_of(self.mode, self._set_mode)),
            "Dark or light": ("L", next_of(self.look, self._set_look)),
        }
        self.keys = add_keys(self.gui, self._do, acts)

    # --- asking ---

    def ask(self, text: str) -> None:
        """As if it had been typed."""
        self.text.value = text
        self._do("ask", None, self._ask)

    def choose(self, number: int) -> None:
        """As if an object had been clicked."""

        def act(_: Any) -> None:
            self.session.choose_object(number)
            self._chose()

        self._do("choose", None, act)

    def _ask(self, _: Any) -> None:
        self.text.value = self.text.value.replace("\n", "")
        self.session.ask(self.text.value)
        self._answered()

    def _try(self, _: Any) -> None:
        self.text.value = self.tried.value
        self._ask(None)

    def _suggest(self, _: Any) -> None:
        words = suggestions(self.session.scene, self.session.words)
        if words:
            self.tried.options, self.tried.visible = tuple(words), True

    def _ask_picture(self, _: Any) -> None:
        file = self.upload.value
        self.session.ask_picture(picture_in(file.content), texts.printable(file.name))
        self._answered()

    def _more(self, _: Any) -> None:
        self.session.more_like_this()
        self._answered()

    def _answered(self) -> None:
        """Show a new answer: in the scene first, then beside it."""
        self.window.repaint()
        labels = self._labels
        self.which.options = labels or ("-",)
        self.which.value = self.which.options[0]
        self.which.visible = len(labels) > 1
        self._new_slider()
        self._follow()

    def _follow(self) -> None:
        """The words and the list, after the answer or its threshold has changed."""
        self.mode.value = self.session.mode.value
        said = (escaped(result.said, 600) for result in self.session.results)
        self.told.content = paragraphs(*said)
        self.finds.show(finds_of(self.session.results))
        if self.thing is not None:
            self.thing.show()

    def fly(self, event: Any, match: Match) -> None:
        """Move the camera of the browser that a press came from before a match."""
        scene = self.session.scene
        match = placed_now(self.session, match)
        eye = before(match, scene.gaussians, scene.views, self.window.up)
        self.flights.do(event.client_id, lambda: self.window.fly(event.client, eye, match.center))

    # --- the threshold ---

    @property
    def _labels(self) -> tuple[str, ...]:
        """Of the queries; numbers tell apart what looks the same."""
        labels = [texts.printable(result.label, 60) for result in self.session.results]
        return tuple(
            f"{label} ({number})" if labels.count(label) > 1 else label for number, label in enumerate(labels, start=1)
        )

    @property
    def _chosen(self) -> int:
        labels = self._labels
        return labels.index(self.which.value) if self.which.value in labels else 0

    def _new_slider(self, _: Any = None) -> None:
        """Of the query chosen, with its own threshold marked."""
        if self.slider is None:
            with self.answer:
                self.slider = self.gui.add_slider("Threshold", 0.0, 1.0, STEP, 0.5, marks=((0.5, "auto"),), order=1.0)
            self._by_hand(self.slider, "cut", self._cut)
        result = self.session.results[self._chosen] if self.session.results else None
        self.slider.visible = result is not None and not result.answer.is_exact
        if result is None:
            return
        low, high = result.limits
        low, high = float(np.floor(low / STEP) * STEP), float(np.ceil(high / STEP) * STEP)
        self.slider.min, self.slider.max = round(low, 3), round(high, 3)
        self.slider.value = round(float(np.clip(result.threshold, low, high)), 3)
        own = replace(self.slider._marks[0], value=round(result.answer.threshold, 3))
        self.slider._marks = (own,)
        self.slider.hint = (
            f"{result.answer.measure} above which a Gaussian is selected; "
            f"the mark is the rule's choice ({result.answer.rule})"
        )

    def _cut(self, _: Any) -> None:
        """Of many places on the way of a hand, only the latest is shown."""
        self.session.set_threshold(self._chosen, float(self.slider.value))
        self.window.repaint()
        self._follow()

    # --- showing ---

    def _set_mode(self, _: Any) -> None:
        if self.mode.value not in self.mode.options:
            self.mode.value = self.session.mode.value
        self.session.mode = Mode(self.mode.value)
        self.window.repaint()

    def _set_boxes(self, _: Any) -> None:
        self.window.boxes = self.boxes.value
        self.window.repaint()

    def _set_look(self, _: Any) -> None:
        themed(self.gui, self.look.value != LIGHT)

    def _classify(self, _: Any) -> None:
        self.classes.value = self.classes.value.replace("\n", "")
        found = self.session.classify(self.classes.value.split(","))
        self.legend.content = legend_html(found.names, found.counts)
        self.mode.value = self.session.mode.value
        self.window.repaint()

    def _clicked(self, event: Any) -> None:
        this = self.session.click(np.array(event.ray_origin), np.array(event.ray_direction))
        self.more.visible = this is not None
        nothing = paragraphs("Nothing with a feature is there.")
        self.this.content = nothing if this is None else said_of_this(this)
        self._show_photo()
        if self.thing is not None:
            self._answered()

    def _list_pressed(self, event: Any, number: int) -> None:
        self.session.choose_object(number)
        self._chose()
        if event.client is not None:
            self.fly(event, self.session.results[0].matches[0])

    def _chose(self) -> None:
        """Show another part, thing or group, or another name of it."""
        self._answered()
        self._show_photo()

    def _show_photo(self) -> None:
        this = self.session.clicked
        photo = None if this is None else photo_of(self.session.scene, this)
        self.photo.visible = photo is not None
        if photo is not None:
            self.photo.image = photo

    def _changing(self, change: Callable[[], None]) -> Callable[[Any], None]:
        def act(_: Any) -> None:
            change()
            self.window.repaint()
            self.mode.value = self.session.mode.value

        return act

    # --- saving ---

    def _save_ply(self, event: Any, selected_only: bool) -> None:
        def write(path: Path) -> None:
            saving.save_scene(path, self.session, selected_only=selected_only)

        self._save(event, "selection" if selected_only else "found", ".ply", write)

    def _save_png(self, event: Any) -> None:
        view = self.window.seen_by(event.client, PICTURE_SIZE)
        data = saving.png_of(saving.picture_of(self.session, view))
        self._save(event, "found", ".png", lambda path: saving.write_bytes(path, data))

    def _save(self, event: Any, stem: str, suffix: str, write: Callable[[Path], None]) -> None:
        path, data = self.saves.save(stem, suffix, write)
        kept = self.saves.folder is not None
        sent = bool(data) and not self.window.is_sending(event.client)
        if sent:
            event.client.send_file_download(path.name, data)
        said = "Saved" if kept else "Sent" if sent else "Take the last file first; not sent:"
        self.saved.content = paragraphs(f"{said} {escaped(str(path) if kept else path.name, 600)}")


def said_of_this(this: This) -> str:
    """Its best words, and the photos and masks behind it, as HTML."""
    place = ", ".join(f"{x:.2f}" for x in this.point)
    words = [f"{escaped(one.text)} {one.score:.2f}" for one in this.words]
    best = (
        f"<strong>{escaped(this.words[0].text)}</strong> {this.words[0].score:.2f}"
        if words
        else "No encoder here has words for it."
    )
    masks = [f"{escaped(one.view_name)}, mask {one.mask_id} ({one.share:.0%})" for one in this.evidence]
    others = "or " + ", ".join(words[1:]) if words[1:] else ""
    return paragraphs(best, others, f"at {place}", "Seen in " + "; ".join(masks) if masks else "")
