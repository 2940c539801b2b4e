"""Instance masks of the kits and of each part from one depth image.

A noisy image is restored first, by a network that reads no masks (`kit1000.perception.restoration`), and another one
separates its parts; exact images need neither.

Read it in the order of the method: `bodies` (what stands on the table, and on which half), `pieces` (smooth surfaces
between steps and creases), `merging` (which pieces are of one part), `instances` (the masks), `predicted_masks`
(queries with these masks instead of the given ones). In restored images each pixel votes for the middle of its part:
`evidence` (what the network reads), `network`, `votes` (from votes to parts) and `part_finder` (its use).
"""
