"""The scene-editing page: a person drags seen parts onto cavities, a method snaps them. Beside it, hand control.

Read it in this order: `session` (edits and their history), `seen` and `seen_plates` (what one depth image shows),
`pointing` and `dragging` (what the hand does), `scene`, `proposals` and `worker` (where parts may snap),
`records`, `picks` and `moves` (what is written), `workspace` (all of this at one moment), `hand` (the same with two
cups in place of parts), `keys`, `texts`, `display` and `controller` (which takes the events). `page`, `label_page` and
`serve` use viser, and nothing else does.
"""

SNAP = "registration"
"""The method of the catalog that snaps if none is named."""
