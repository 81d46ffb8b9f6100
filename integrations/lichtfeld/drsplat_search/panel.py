"""The panel: where the service is, words, and what became of them."""

from concurrent.futures import Future, ThreadPoolExecutor

import lichtfeld as lf
import numpy as np

from .asking import AskingError, Service, mask_of, place_of


class SearchPanel(lf.ui.Panel):
    """Words in, a selection out. The service is asked in a thread of its own, so that the program goes on drawing."""

    id = "drsplat_search.panel"
    label = "Search in words"
    space = lf.ui.PanelSpace.MAIN_PANEL_TAB
    order = 210

    def __init__(self) -> None:
        self.address, self.key, self.text, self.message = "http://127.0.0.1:8765", "", "", ""
        self._worker = ThreadPoolExecutor(1)
        self._waiting: Future[np.ndarray] | None = None
        self._asked = ""

    def draw(self, ui) -> None:
        _, self.address = ui.input_text("drsplat serve", self.address)
        _, self.key = ui.input_text("Key", self.key)
        _, self.text = ui.input_text_with_hint("Words", "red mug", self.text)
        if ui.button("Select") and self.text.strip() and self._waiting is None:
            self.ask(self.text.strip())
        if ui.button("Clear"):
            self.message = ""
            scene = lf.get_scene()
            if scene is not None:
                scene.clear_selection()
        self.take_answer()
        ui.text_wrapped(self.message)

    def ask(self, text: str) -> None:
        """Begin to ask; `take_answer` shows what comes of it."""
        scene = lf.get_scene()
        model = None if scene is None else scene.combined_model()
        if model is None:
            self.message = "Open a scene first."
            return
        positions = model.means_raw.cpu().numpy()
        starts = part_starts(scene)
        self._asked, self.message = text, f"Asking for {text} ..."
        self._waiting = self._worker.submit(selected, self.address, self.key, text, positions, starts)

    def take_answer(self) -> None:
        """Show the answer once it is there."""
        if self._waiting is None or not self._waiting.done():
            return
        waiting, self._waiting = self._waiting, None
        try:
            mask = waiting.result()
        except AskingError as error:
            self.message = str(error)
            return
        scene = lf.get_scene()
        if scene is None or scene.combined_model() is None or scene.combined_model().num_points != len(mask):
            self.message = "The scene has changed: ask again."
            return
        scene.set_selection_mask(lf.Tensor.from_numpy(mask))
        scene.notify_changed()
        self.message = f"{self._asked}: {mask.sum():,} of {len(mask):,} Gaussians"


def selected(address: str, key: str, text: str, positions: np.ndarray, starts: list[int]) -> np.ndarray:
    """Return the mask of what a text selects among the Gaussians that are shown."""
    service = Service(address, key)
    name, start = place_of(service.scenes(len(positions)), positions, starts)
    return mask_of(service.rows(name, text), start, len(positions))


def part_starts(scene) -> list[int]:
    """Return the rows of the combined model at which the Gaussians of a visible node may begin."""
    counts = [node.gaussian_count for node in scene.get_visible_nodes()]
    return sorted({0, *np.cumsum(counts, dtype=int).tolist()})
