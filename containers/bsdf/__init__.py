"""How a surface scatters: every kind has the three verbs sample, evaluate, albedo (`surface.Bsdf`).

    Lambertian, GaussianLobe          lobes        spread light
    Mirror, Fresnel, SpecularTable    specular     light in one direction (delta parts)
    Facets                            facets       a rough clear face
    Mixture, Coated                   mixture      several of them on one surface
    Tabulated, tabulate               tabulated    any of them as arrays, sampled exactly

Whatever the kind, each sample carries weight = albedo(theta_in), so nothing is lost or made by sampling.
"""

from containers.bsdf.checks import check_energy, one_way_share, reciprocity_defect, symmetrised, transmission_defect
from containers.bsdf.facets import Facets
from containers.bsdf.lobes import GaussianLobe, Lambertian
from containers.bsdf.mixture import Coated, Mixture
from containers.bsdf.specular import Fresnel, Mirror, SpecularTable
from containers.bsdf.surface import Bsdf, Deltas, Sample, direction_of
from containers.bsdf.tabulated import Tabulated, tabulate

__all__ = [
    "Bsdf",
    "Coated",
    "Deltas",
    "Facets",
    "Fresnel",
    "GaussianLobe",
    "Lambertian",
    "Mirror",
    "Mixture",
    "Sample",
    "SpecularTable",
    "Tabulated",
    "check_energy",
    "direction_of",
    "one_way_share",
    "reciprocity_defect",
    "symmetrised",
    "tabulate",
    "transmission_defect",
]
