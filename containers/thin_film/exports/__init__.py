"""Film tables in the formats of other programs, each with an own reader, each saying what it cannot carry.

speos          R and T in percent, s and p, wavelength, angle      loses scatter
opticstudio    scattered light about the specular direction        loses wavelength, polarisation; spreads deltas
radiance_xml   Klems matrices of 145 x 145 patches                 loses wavelength, polarisation; spreads deltas
"""

from containers.thin_film.exports.exported import Exported
from containers.thin_film.exports.opticstudio import ScatterFile, opticstudio, read_opticstudio
from containers.thin_film.exports.radiance_xml import radiance_xml, read_radiance_xml
from containers.thin_film.exports.speos import CoatedSurface, coated_surface, read_speos, speos

__all__ = [
    "CoatedSurface",
    "Exported",
    "ScatterFile",
    "coated_surface",
    "opticstudio",
    "radiance_xml",
    "read_opticstudio",
    "read_radiance_xml",
    "read_speos",
    "speos",
]
