"""The Radiance / WINDOW 6 XML: Klems matrices of 145 x 145 patches of direction.

The basis "LBNL/Klems Full": rings of theta with bounds 0 5 15 25 35 45 55 65 75 90 deg and 1 8 16 20 24 24 24 16 12
patches; patch p of a ring is centred at azimuth p x 360 / patches. A patch has the projected solid angle
pi (cos^2 theta_0 - cos^2 theta_1) / patches; all sum to pi. In a block columns are incident, rows outgoing patches;
the number is the mean bsdf (1/sr), so that sum over rows of value x projected solid angle = power from one column.
An incident patch is named by where its light travels to, so the mirror and the straight-on direction of a patch have
its own number: a specular surface is a diagonal matrix. (Bounds, order and this convention: as Radiance's own reader
and genBSDF have them. Not verified: WINDOW itself, and its use of media other than air, where theta is taken in the
medium of each side.)
"""

from __future__ import annotations

import xml.etree.ElementTree as Xml
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from containers.bsdf import Bsdf, direction_of
from containers.thin_film.exports.exported import Exported, checked_text, lost_words, numbers
from containers.thin_film.table import Real
from luxloop.errors import InputError

NAMESPACE = "http://windows.lbl.gov"
BASIS = "LBNL/Klems Full"
BOUNDS_DEG = (0.0, 5.0, 15.0, 25.0, 35.0, 45.0, 55.0, 65.0, 75.0, 90.0)
PATCHES = (1, 8, 16, 20, 24, 24, 24, 16, 12)
BLOCKS = ("Transmission Front", "Reflection Front", "Transmission Back", "Reflection Back")
FINE = 480
"""Azimuths; every border of every ring's patches falls between two of them."""
_ORDER_IN, _ORDER_OUT = 8, 12
_DENSE = 10_000
NO_POWER = 1e-12


def projected_sr() -> Real:
    """Projected solid angle of each of the 145 patches."""
    squares = np.cos(np.radians(BOUNDS_DEG)) ** 2
    return np.repeat(np.pi * (squares[:-1] - squares[1:]) / PATCHES, PATCHES)


def klems(bsdf: Bsdf) -> tuple[Real, Real]:
    """Mean bsdf (1/sr) of reflection and transmission, each (145 outgoing, 145 incident), delta parts spread.

    Each column holds the mean over its patch of the albedo, weighted by projected solid angle (to 1e-5).
    """
    matrices = np.zeros((2, 145, 145))
    first = 0
    for ring, count in enumerate(PATCHES):
        width = FINE // count
        # where the light of the first patch goes, averaged over the azimuths of that patch
        power = _ring_power(bsdf, ring)
        mean = np.mean([np.roll(power, k - width // 2, axis=-1) for k in range(width)], axis=0)
        for patch in range(count):
            matrices[:, :, first + patch] = _in_patches(np.roll(mean, patch * width, axis=-1))
        first += count
    reflection, transmission = matrices / projected_sr()[:, None]
    return reflection, transmission


def radiance_xml(
    front: Bsdf, back: Bsdf | None = None, name: str = "film", also_lost: Mapping[str, float] | None = None
) -> Exported:
    """The XML text of a surface: front is the side that WINDOW calls so, back its other side if wanted.

    Parameters
    ----------
    front, back : surfaces seen by light from either side.
    also_lost : what was lost before, for instance `surface.averaging_loss` of a film table.

    Notes
    -----
    The format has no polarisation, no wavelength below "Visible", no delta part: specular light is spread over a
    patch. `lost`: "delta_power_ratio", the largest power so spread; "delta_spread_sr", the projected solid angle of
    the largest patch; "ring_ratio", the largest difference between a power at an angle and the mean of its ring.
    """
    lost = dict(also_lost or {}) | _lost(front) | ({} if back is None else _worse(_lost(front), _lost(back)))
    root = Xml.Element("WindowElement", {"xmlns": NAMESPACE})
    root.append(Xml.Comment(f" luxloop; {lost_words(lost).replace('--', '-')} "))
    Xml.SubElement(root, "WindowElementType").text = "System"
    layer = Xml.SubElement(Xml.SubElement(root, "Optical"), "Layer")
    material = Xml.SubElement(layer, "Material")
    for tag, text in (("Name", name), ("Manufacturer", "luxloop"), ("DeviceType", "Other")):
        Xml.SubElement(material, tag).text = text
    _define_basis(layer)
    sides = [front] if back is None else [front, back]
    for side, bsdf in zip(("Front", "Back"), sides, strict=False):
        reflection, transmission = klems(bsdf)
        _block(layer, f"Transmission {side}", "BTDF", transmission)
        _block(layer, f"Reflection {side}", "BRDF", reflection)
    Xml.indent(root)
    return Exported('<?xml version="1.0" encoding="UTF-8"?>\n' + Xml.tostring(root, encoding="unicode") + "\n", lost)


def read_radiance_xml(text: str) -> dict[str, Real]:
    """The blocks of such a text by name ("Reflection Front", ...), each (145 outgoing, 145 incident) in 1/sr."""
    if "<!DOCTYPE" in checked_text("XML", text) or "<!ENTITY" in text:
        raise InputError("XML", "a document type", "plain elements", "entities can be used to exhaust memory")
    try:
        root = Xml.fromstring(text)  # noqa: S314  # without a document type there is nothing to expand
    except Xml.ParseError as error:
        raise InputError("XML", str(error), "a WINDOW 6 BSDF file") from error
    space = {"w": NAMESPACE}
    order = root.findtext(".//w:IncidentDataStructure", "", space).strip()
    if order != "Columns":
        raise InputError("IncidentDataStructure", order, "Columns", "Klems matrices, not tensor trees")
    blocks = {}
    for block in root.iterfind(".//w:WavelengthDataBlock", space):
        direction = block.findtext("w:WavelengthDataDirection", "", space).strip()
        bases = {block.findtext(f"w:{axis}AngleBasis", "", space).strip() for axis in ("Column", "Row")}
        if direction not in BLOCKS or bases != {BASIS}:
            raise InputError("WavelengthDataBlock", (direction, sorted(bases)), f"one of {BLOCKS} in {BASIS}")
        words = block.findtext("w:ScatteringData", "", space).replace(",", " ").split()
        blocks[direction] = np.reshape(numbers(direction, words, 145 * 145), (145, 145))
    return blocks


def _ring_power(bsdf: Bsdf, ring: int) -> Real:
    """Power (reflected or transmitted, outgoing ring, azimuth) of light from one ring, azimuth 0 the mirror's."""
    dense = _angles_of(ring, (np.arange(_DENSE) + 0.5) / _DENSE)
    mirror, refracted = bsdf.deltas(dense)
    want = float((bsdf.albedo(dense) - mirror - refracted).mean())
    power = _spread_from_ring(bsdf, ring) if want > NO_POWER else np.zeros((2, len(PATCHES), FINE))
    power *= want / max(float(power.sum()), NO_POWER)
    power[0, ring, 0] += mirror.mean()
    out = np.degrees(np.arcsin(np.minimum(bsdf.index_ratio * np.sin(dense), 1.0)))
    power[1, :, 0] += np.bincount(_ring_of(out), refracted, len(PATCHES)) / _DENSE
    return power


def _spread_from_ring(bsdf: Bsdf, ring: int) -> Real:
    """The same without the delta parts; InputError where the quadrature misses more than a tenth of a lobe."""
    x, weight = np.polynomial.legendre.leggauss(_ORDER_IN)
    power = np.zeros((2, len(PATCHES), FINE))
    for angle, share in zip(_angles_of(ring, (x + 1.0) / 2.0), weight / 2.0, strict=True):
        want = float(bsdf.albedo(angle) - np.add(*bsdf.deltas(angle)))
        if want <= NO_POWER:
            continue
        spread = _spread_power(bsdf, float(angle))
        total = float(spread.sum())
        if abs(total - want) > 0.1 * want + 1e-9:
            mend = "widen the lobe, or use another format"
            raise InputError("bsdf", f"a lobe at {np.degrees(angle):.2f} deg", "lobes wider than half a degree", mend)
        power += share * spread * (want / total)
    return power


def _angles_of(ring: int, share: Real) -> Real:
    """Angles of incidence (rad) below which lie these shares of a ring's projected solid angle."""
    low, high = np.sin(np.radians(BOUNDS_DEG[ring : ring + 2])) ** 2
    return np.asarray(np.arcsin(np.sqrt(low + (high - low) * share)))


def _spread_power(bsdf: Bsdf, theta_in: float) -> Real:
    """The same for one angle of incidence without the delta parts, by quadrature in each ring."""
    x, weight = np.polynomial.legendre.leggauss(_ORDER_OUT)
    low, high = np.radians(BOUNDS_DEG[:-1])[:, None], np.radians(BOUNDS_DEG[1:])[:, None]
    theta, step = (low + high) / 2 + (high - low) / 2 * x, (high - low) / 2 * weight * (2 * np.pi / FINE)
    phi = np.arange(FINE) * (2 * np.pi / FINE)
    up = bsdf.intensity(theta_in, direction_of(theta[..., None], phi))
    down = bsdf.intensity(theta_in, direction_of(np.pi - theta[..., None], phi))
    return np.stack([(side * (np.sin(theta) * step)[..., None]).sum(axis=1) for side in (up, down)])


def _in_patches(power: Real) -> Real:
    """Sum power (2, ring, azimuth) into the patches: (2, 145)."""
    found = []
    for ring, count in enumerate(PATCHES):
        half = FINE // count // 2 if count > 1 else 0
        found.append(np.roll(power[:, ring], half, axis=-1).reshape(2, count, -1).sum(axis=-1))
    return np.concatenate(found, axis=1)


def _ring_of(theta_deg: Real) -> NDArray[np.intp]:
    return np.minimum(np.searchsorted(BOUNDS_DEG, theta_deg, "right") - 1, len(PATCHES) - 1)


def _lost(bsdf: Bsdf) -> dict[str, float]:
    theta = np.linspace(0.0, np.pi / 2, 9001)
    deltas = bsdf.deltas(theta)
    weight = np.sin(theta) * np.cos(theta) + 1e-12
    ring = _ring_of(np.degrees(theta))
    lost = {"ring_ratio": 0.0}
    for power in (bsdf.albedo(theta), *deltas):
        means = np.bincount(ring, weight * power) / np.bincount(ring, weight)
        lost["ring_ratio"] = max(lost["ring_ratio"], float(np.abs(power - means[ring]).max()))
    if max(deltas.mirror.max(), deltas.refracted.max()) > 0.0:
        lost["delta_power_ratio"] = float(np.add(*deltas).max())
        lost["delta_spread_sr"] = float(projected_sr().max())
    return lost


def _worse(one: dict[str, float], other: dict[str, float]) -> dict[str, float]:
    return {name: max(one.get(name, 0.0), other.get(name, 0.0)) for name in one | other}


def _define_basis(layer: Xml.Element) -> None:
    definition = Xml.SubElement(layer, "DataDefinition")
    Xml.SubElement(definition, "IncidentDataStructure").text = "Columns"
    basis = Xml.SubElement(definition, "AngleBasis")
    Xml.SubElement(basis, "AngleBasisName").text = BASIS
    for low, high, count in zip(BOUNDS_DEG[:-1], BOUNDS_DEG[1:], PATCHES, strict=True):
        block = Xml.SubElement(basis, "AngleBasisBlock")
        Xml.SubElement(block, "Theta").text = f"{(low + high) / 2 if low else 0.0:g}"
        Xml.SubElement(block, "nPhis").text = str(count)
        bounds = Xml.SubElement(block, "ThetaBounds")
        Xml.SubElement(bounds, "LowerTheta").text = f"{low:g}"
        Xml.SubElement(bounds, "UpperTheta").text = f"{high:g}"


def _block(layer: Xml.Element, direction: str, kind: str, matrix: Real) -> None:
    data = Xml.SubElement(layer, "WavelengthData")
    Xml.SubElement(data, "LayerNumber").text = "System"
    Xml.SubElement(data, "Wavelength", {"unit": "Integral"}).text = "Visible"
    Xml.SubElement(data, "SourceSpectrum").text = "CIE Illuminant D65 1nm.ssp"
    Xml.SubElement(data, "DetectorSpectrum").text = "ASTM E308 1931 Y.dsp"
    block = Xml.SubElement(data, "WavelengthDataBlock")
    Xml.SubElement(block, "WavelengthDataDirection").text = direction
    Xml.SubElement(block, "ColumnAngleBasis").text = BASIS
    Xml.SubElement(block, "RowAngleBasis").text = BASIS
    Xml.SubElement(block, "ScatteringDataType").text = kind
    rows = (", ".join(f"{x:.7g}" for x in row) for row in matrix)
    Xml.SubElement(block, "ScatteringData").text = "\n" + ",\n".join(rows) + "\n"
