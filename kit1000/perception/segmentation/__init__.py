"""Instance masks of the kits and of each part from one depth image.

A network that reads no masks restores a noisy image first (`kit1000.perception.restoration`), and another one separates
its parts (`part_finder`): each pixel votes for the middle of its part. Exact images need neither.

Read it in the order of the method: `instances` (what stands on the table, and the masks), `pieces` (smooth surfaces
between steps and creases, and which of them are of one part), `predicted_masks` (queries with these masks instead of
the given ones).
"""
