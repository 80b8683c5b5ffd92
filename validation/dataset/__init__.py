"""Measured data: the manifest, the folder, its images, spectra and far fields, and what may be wrong with them."""
