"""Which ending of a name says which unit: the one table that files, commands and the tests of names read."""

from __future__ import annotations

UNITS = {
    "_w_per_m2": "W/m2",
    "_cd_per_m2": "cd/m2",
    "_w_per_sr": "W/sr",
    "_lm_per_w": "lm/W",
    "_per_mm2": "1/mm2",
    "_per_cm": "1/cm",
    "_per_mm": "1/mm",
    "_per_um": "1/um",
    "_per_s": "1/s",
    "_dn_per_e": "DN/e",
    "_dn": "DN",
    "_e": "e",
    "_ev": "eV",
    "_nm": "nm",
    "_um": "um",
    "_mm": "mm",
    "_rad": "rad",
    "_deg": "deg",
    "_lx": "lx",
    "_w": "W",
    "_ns": "ns",
    "_ms": "ms",
    "_s": "s",
    "_hz": "Hz",
    "_px": "px",
    "_c": "deg C",
    "_percent": "%",
    "_bytes": "bytes",
    "_mb": "MB",
    "_gb": "GB",
}


def unit_of(name: str) -> str:
    """The unit that the ending of `name` states, "" where it states none; the longest ending that fits decides."""
    endings = [ending for ending in UNITS if name.endswith(ending)]
    return UNITS[max(endings, key=len)] if endings else ""
