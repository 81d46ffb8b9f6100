"""Time in the viewer: a slider, play, and the span of time that queries ask of."""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ..kernels.boxes import box_of
from ..query import Match
from ..scene.boxes import solid
from .session import Session

PAUSE = 0.03  # seconds between two times, for what else is pressed
Act = Callable[[Any], None]


def placed_now(session: Session, match: Match) -> Match:
    """A match with its box where its Gaussians are now, at the session's time and after its edits."""
    now, ids = session.edits.standing, match.gaussian_ids
    if session.time is None and np.array_equal(now.means[ids], session.scene.gaussians.means[ids]):
        return match
    box = box_of(now, solid(now, ids), session.scene.up)
    return replace(match, center=box.center, axes=box.axes, extent=box.extent)


class TimeControls:
    """Of a scene that moves; made in the folder that is open.

    do: acts later, after what was pressed before, as `Panel._do`. moved: shows the session anew.
    """

    def __init__(
        self, session: Session, gui: Any, do: Callable[[str, Any, Act], None], moved: Callable[[], None]
    ) -> None:
        self.session, self.do, self.moved = session, do, moved
        self.times = session.scene.moving.times.tolist()
        low, high = self.times[0], self.times[-1]
        step = (high - low) / 1000
        self.slider = gui.add_slider("Time", low, high, step, low)
        self.playing = gui.add_checkbox("Play", False)
        self.span = gui.add_multi_slider("Query from, to", low, high, step, (low, high))
        self.span.hint = "Queries ask what photos of this span of time have shown; press enter in the query again"
        self.span.visible = session.scene.field.times is not None
        self._by_hand(self.slider, "time", self._show)
        self._by_hand(self.playing, "play", self._step)
        self._by_hand(self.span, "span", self._ask_of)
        session.time = low

    def _by_hand(self, control: Any, what: str, act: Act) -> None:
        """When people change a control, not when we do."""

        def changed(event: Any) -> None:
            if event.client is not None:
                self.do(what, event, act)

        control.on_update(changed)

    def _show(self, _: Any = None) -> None:
        """Of many places on the way of a hand, only the latest is shown."""
        self.session.time = float(np.clip(self.slider.value, self.times[0], self.times[-1]))
        self.moved()

    def _step(self, event: Any) -> None:
        """One of the scene's times after another, from the first again after the last, while it plays."""
        if not self.playing.value:
            return
        now = self.session.time or 0.0
        self.slider.value = next((later for later in self.times if later > now + 1e-9), self.times[0])
        self._show()
        time.sleep(PAUSE)
        self.do("play", event, self._step)

    def _ask_of(self, _: Any) -> None:
        start, end = self.span.value
        whole = (start, end) == (self.times[0], self.times[-1])
        self.session.during = None if whole else (float(start), float(end))
