"""What each annotator can undo and redo in each layer, without limit and without a search.

An annotator's actions in a layer make two stacks: actions that are done, and undos that can be
redone. Both are linked by ``below_id`` in the journal itself, and the annotator's newest action
tells both tops:

- *do*: it lies upon the done ones, below it what was done before; nothing is left to redo.
- *undo* of T: done is what lies below T; to redo is this undo, below it the undos before.
- *redo* of the undo U of T: done is T again; to redo is what lies below U.

All windows of one person thus share the stacks, and they outlive the program.
"""

from dataclasses import dataclass

from sqlalchemy import Connection, func, select

from fusion_core.annotation import schema
from fusion_core.annotation.action import ActionKind


@dataclass(frozen=True, slots=True)
class StackTops:
    """The actions that the next undo and the next redo take back; None where there is none."""

    undo: int | None = None
    redo: int | None = None

    def below(self, kind: ActionKind) -> int | None:
        """What an action of this kind links to."""
        return {"do": self.undo, "undo": self.redo, "redo": None}[kind]


def find_tops(connection: Connection, layer: str, annotator: str) -> StackTops:
    """The tops of an annotator's stacks in a layer."""
    action = schema.action
    target = action.alias("target")
    layer_id = select(schema.layer.c.id).where(schema.layer.c.name == layer).scalar_subquery()
    # The last entry of the index, whatever the database knows of the size of the tables.
    own = (action.c.layer_id == layer_id, action.c.annotator == annotator)
    newest_id = select(func.max(action.c.id)).where(*own).scalar_subquery()
    newest = connection.execute(
        select(action, target.c.below_id.label("below_target"), target.c.target_id.label("undone"))
        .outerjoin(target, target.c.id == action.c.target_id)
        .where(action.c.id == newest_id)
    ).one_or_none()
    if newest is None:
        return StackTops()
    if newest.kind == "do":
        return StackTops(undo=newest.id)
    if newest.kind == "undo":
        return StackTops(undo=newest.below_target, redo=newest.id)
    return StackTops(undo=newest.undone, redo=newest.below_target)
