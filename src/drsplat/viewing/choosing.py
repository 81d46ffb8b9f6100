"""The controls of the object that was clicked: what it is, what is smaller and larger, and its name."""

from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

from ..query.nodes import numbered
from ..query.objects import objects_of
from ..terminal import counted
from .session import Session
from .texts import escaped, paragraphs

Act = Callable[[Any], None]


@runtime_checkable
class Maker(Protocol):
    """Who makes a control of a label that does something when it is pressed."""

    def __call__(self, label: str, act: Act, /) -> Any: ...


class ChosenControls:
    """Made in the folder that is open. button, prompt: who makes them. changed: after another node is selected."""

    def __init__(self, session: Session, gui: Any, button: Maker, prompt: Maker, changed: Callable[[], None]) -> None:
        self.session, self.changed = session, changed
        self.said = gui.add_html("")
        self.smaller = button("Smaller", self._changing(session.smaller))
        self.larger = button("Larger", self._changing(session.larger))
        self.text = prompt("Name", self._name)
        self.naming = button("Name it", self._name)
        self.show()

    def show(self) -> None:
        """What is chosen now; nothing can be pressed where that is nothing."""
        chosen = self.session.chosen
        objects = objects_of(self.session.scene.field)
        smaller = None if chosen is None else chosen.smaller(objects)
        larger = None if chosen is None else chosen.larger()
        for button, other in ((self.smaller, smaller), (self.larger, larger)):
            button.visible, button.disabled = chosen is not None, other is None
            button.hint = None if other is None else f"Select the {numbered(objects, other.node)}"
        self.said.visible = chosen is not None
        self.text.visible = self.naming.visible = chosen is not None and self.session.can_name
        if chosen is not None:
            self.said.content = said_of_node(self.session, chosen.node)

    def _changing(self, change: Callable[[], None]) -> Act:
        def act(_: Any) -> None:
            change()
            self.changed()

        return act

    def _name(self, _: Any) -> None:
        self.text.value = self.text.value.replace("\n", "")
        self.session.name(self.text.value)
        self.text.value = ""
        self.changed()


def said_of_node(session: Session, node: int) -> str:
    """Its name, its number, how many Gaussians and photos it has and how far these agree, as HTML."""
    objects = objects_of(session.scene.field)
    name, number = session.results[0].label, numbered(objects, node)
    own = "" if name == number else f", {number}"
    photos = counted(int(objects.num_views[node]), "photo")
    size = counted(int(objects.sizes[node]), "Gaussian")
    return paragraphs(f"<b>{escaped(name)}</b>{own}", f"{size} in {photos}, sure {objects.sure[node]:.2f}")
