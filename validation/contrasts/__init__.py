"""What is left after a fit: is it noise, and where is it not? Contrasts of the whitened residual and their null."""

from validation.contrasts.structure import FamilyFound, Region, ShotFound, Structure, structure

__all__ = ["FamilyFound", "Region", "ShotFound", "Structure", "structure"]
