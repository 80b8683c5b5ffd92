"""What the ray-tracing worker computes in the formats of other programs, each with an own reader.

ies     luminous intensity against direction, ANSI/IES LM-63-2019 text
tm25    the light that leaves a chip, ray by ray, IES TM-25 binary
"""

from containers.ray_tracing.exports.ies import PhotometricWeb, ies, photometric_web, read_ies
from containers.ray_tracing.exports.tm25 import RaySet, read_tm25, tm25

__all__ = ["PhotometricWeb", "RaySet", "ies", "photometric_web", "read_ies", "read_tm25", "tm25"]
