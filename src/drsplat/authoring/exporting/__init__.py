"""A scene with its objects, the answer to a query and annotations, in the formats of other programs.

`labelled` brings together what is known of a scene, as it is after its edits; `export` writes it as the name of the
output says.
"""

from .writing import Exported, export, labelled, labelled_alone

__all__ = ["Exported", "export", "labelled", "labelled_alone"]
