"""The scene-editing page: a person drags seen parts onto cavities, a method snaps them. Beside it, hand control.

Read it in this order: `session` (edits and their history), `seen` and `seen_plates` (what one depth image shows),
`pointing`, `dragging` and `gestures` (what the hand does), `proposals` and `worker` (where parts
may snap), `part_on_plate` (how well that fits), `records` (what is written), `workspace` (all of this at a moment),
`hand` (the same with two cups in place of parts), `controller`, which takes the events, and `page` with `serve`:
viser, and nothing else knows it.
"""

SNAP = "registration"
"""The method of the catalog that snaps where none is named."""
