"""Connected components of a graph, without the packages that a library of sparse graphs loads."""

from __future__ import annotations

import numpy as np

from kit1000.numerics.compiled import compiled


def component_labels(count: int, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(count,) int64 component of each node of a graph with edges from nodes a (e,) to b (e,).

    Components are numbered from 0, in the order of their first nodes.
    """
    return _component_labels(count, np.ascontiguousarray(a, np.int64), np.ascontiguousarray(b, np.int64))


@compiled
def _component_labels(count, a, b):
    parent = np.empty(count, np.int64)
    for node in range(count):
        parent[node] = node
    for e in range(a.shape[0]):
        i, j = a[e], b[e]
        while parent[i] != i:
            parent[i] = parent[parent[i]]  # paths get shorter each time that they are walked
            i = parent[i]
        while parent[j] != j:
            parent[j] = parent[parent[j]]
            j = parent[j]
        parent[max(i, j)] = min(i, j)  # a root is the first node of its component
    labels = np.empty(count, np.int64)
    found = 0
    for node in range(count):
        if parent[node] == node:
            labels[node] = found
            found += 1
        else:
            labels[node] = labels[parent[node]]
    return labels
