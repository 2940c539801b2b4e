"""Instance masks of the kits and of each part from one depth image, without learning shapes.

A noisy image is restored first, by a network that reads no masks (`baselines.restoration`), or taken as it is.

Read it in the order of the method: `bodies` (what stands on the table, and on which half), `pieces` (smooth surfaces
between steps and creases), `merging` (which pieces are of one part), `instances` (the masks), `queries` (queries with
these masks in place of the given ones). `fit` fits the weights of `merging` to the training split.
"""
