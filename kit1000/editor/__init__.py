"""The scene-editing page: a person drags seen parts onto cavities, and a method snaps them.

Read it in this order: `session` (edits and their history), `seen` and `plates` (what one depth image shows), `pointing`
and `gestures` (what the hand does), `proposals` and `worker` (where parts may snap), `report` (how well that fits),
`records` (what is written), `controller`, which joins them, and `page` with `serve`: viser, and nothing else knows it.
"""
