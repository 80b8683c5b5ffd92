"""Media that are fine mixtures of two others, and layers of them between two media of a stack."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from containers.checked import within
from containers.stack import StackRows
from luxloop.errors import InputError

Complex = NDArray[np.complex128]

ROUNDING_NM = 1e-9
"""A neighbour that gives all that it has may seem to lack so much."""


def bruggeman(index_a: ArrayLike, index_b: ArrayLike, share_b: float = 0.5) -> Complex:
    """Index n + ik of a fine mixture of two media, `share_b` of the volume being b.

    The root with Im e >= 0 of (1 - f)(e_a - e)/(e_a + 2e) + f (e_b - e)/(e_b + 2e) = 0, e = n^2, f = share_b; the
    other root, -e_a e_b / 2e, has Im e <= 0. InputError for a share outside 0 to 1, and for what is no index. For
    grains far below the wavelength. Source: Bruggeman, Ann. Phys. 416, 636 (1935).
    """
    within("share_b", share_b, 0.0, 1.0, "the share of the volume that is b")
    e_a, e_b = (_index(field, n) ** 2 for field, n in (("index_a", index_a), ("index_b", index_b)))
    half = ((2.0 - 3.0 * share_b) * e_a + (3.0 * share_b - 1.0) * e_b) / 4.0
    root = np.sqrt(half**2 + e_a * e_b / 2.0)
    plus = (root.imag > 0.0) | ((root.imag == 0.0) & (root.real >= 0.0))
    mixed: Complex = np.sqrt(half + np.where(plus, root, -root))
    return mixed.real + 1j * np.maximum(mixed.imag, 0.0)  # rounding may leave k = -1e-16


def with_interlayer(rows: StackRows, face: int, thickness_nm: float, share_outer: float = 0.5) -> StackRows:
    """The rows with a mixed layer of both neighbours at one face: roughness as ellipsometry models it.

    Parameters
    ----------
    face : 0 is the face of the inside bulk, the number of layers that of the outermost layer.
    thickness_nm : of the mixed layer, about 2 to 3 rms heights. What it is made of is taken from the two neighbours:
        a face becomes rough, no material is added.
    share_outer : volume share of the outer neighbour (`bruggeman`).

    Raises
    ------
    InputError for a value out of range, or a face that the stack does not have.
    """
    within("share_outer", share_outer, 0.0, 1.0, "the share of the volume that is the outer neighbour")
    within("thickness_nm", thickness_nm, 0.0, 1e9, "the thickness of the mixed layer in nm")
    faces = range(len(rows.thickness_nm) + 1)
    if face not in faces:
        raise InputError("face", face, f"0 to {faces[-1]}, counted from the inside", "name a face of the stack")
    mixed = bruggeman(rows.index[:, face], rows.index[:, face + 1], share_outer)
    left = np.array([np.inf, *rows.thickness_nm, np.inf])  # the half spaces give without becoming thinner
    left[face : face + 2] -= thickness_nm * np.array([1.0 - share_outer, share_outer])
    if left.min() < -ROUNDING_NM:
        raise InputError("thickness_nm", thickness_nm, "no more than its neighbours can give", "make it thinner")
    left = np.maximum(left, 0.0)
    return replace(
        rows,
        index=np.insert(rows.index, face + 1, mixed, axis=1),
        thickness_nm=np.insert(left[1:-1], face, thickness_nm),
        roughness_nm=np.insert(rows.roughness_nm, face + 1, 0.0),
        coherent=np.insert(rows.coherent, face, True),
        film=np.insert(rows.film, face, False),
    )


def _index(field: str, value: ArrayLike) -> Complex:
    index = np.asarray(value, complex)
    if not (np.isfinite(index) & (index.real > 0.0) & (index.imag >= 0.0)).all():
        raise InputError(field, value, "n > 0 and k >= 0, as n + ik", "give k with a plus sign")
    return index
