"""Which effects the data can hardly tell apart: cosines between what the fit leaves of their columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

Real = NDArray[np.float64]

ALIKE = 0.9
"""Cosine beyond which two effects are put into one group."""
TOLD_APART = 5.0
"""Sigma that must be left of an effect beside its rival, so that it may be named."""


@dataclass(frozen=True, eq=False)
class Confounding:
    """Cosines between effects, each by its own columns (of a group of columns: the largest canonical cosine)."""

    names: tuple[str, ...]
    cosines: Real
    """(effect, effect); of two single columns with their sign."""

    @property
    def groups(self) -> tuple[tuple[str, ...], ...]:
        """Effects that are alike, directly or by way of others; the largest group first, loners last."""
        near = csr_array(np.abs(self.cosines) > ALIKE)
        _, labels = connected_components(near, directed=False)
        found = [tuple(n for n, at in zip(self.names, labels, strict=True) if at == one) for one in np.unique(labels)]
        return tuple(sorted(found, key=lambda group: (-len(group), self.names.index(group[0]))))

    @property
    def order(self) -> list[int]:
        """Places of the effects so that groups lie together."""
        return [self.names.index(name) for group in self.groups for name in group]

    def rivals(self, name: str) -> list[tuple[str, float]]:
        """The others by falling likeness, with their cosines."""
        row = self.cosines[self.names.index(name)]
        others = [(other, float(row[k])) for k, other in enumerate(self.names) if other != name]
        return sorted(others, key=lambda one: -abs(one[1]))

    def group_of(self, name: str) -> tuple[str, ...]:
        """Those alike with an effect, itself included."""
        return next((group for group in self.groups if name in group), (name,))


def confounding(columns: dict[str, Real]) -> Confounding:
    """The cosines between effects, by what the fit leaves of their whitened columns (column, row)."""
    names = tuple(columns)
    roots = {name: _orthonormal(rows) for name, rows in columns.items()}
    cosines = np.eye(len(names))
    for i, one in enumerate(names):
        for j in range(i):
            product = roots[one] @ roots[names[j]].T
            largest = np.linalg.norm(product, 2) if product.size > 1 else product.sum()
            cosines[i, j] = cosines[j, i] = largest
    return Confounding(names, np.clip(cosines, -1.0, 1.0))


def left_beside(column: Real, others: Sequence[Real]) -> float:
    """Length of a column (row,) after others (column, row) have taken what they can: sigma at size 1."""
    if not len(others):
        return float(np.linalg.norm(column))
    rows = np.concatenate(list(others))
    gram = rows @ rows.T
    gram += 1e-12 * np.trace(gram) / len(gram) * np.eye(len(gram))
    taken = rows @ column
    square = float(column @ column) - float(taken @ cho_solve(cho_factor(gram), taken))
    return float(np.sqrt(max(square, 0.0)))


def _orthonormal(rows: Real) -> Real:
    """Directions (direction, row) that span columns (column, row)."""
    if len(rows) == 1:  # its sign is kept
        length = float(np.linalg.norm(rows))
        return rows / length if length > 0.0 else rows[:0]
    _, singular, right = np.linalg.svd(rows, full_matrices=False)
    return np.asarray(right[singular > 1e-9 * singular[0]]) if singular.size and singular[0] > 0.0 else right[:0]
