"""The hall of luxloop: the words that all rooms use. No physics beyond photometry, no learning."""

import os
from importlib.metadata import version

__version__ = version("luxloop")

# One thread for BLAS unless told otherwise, set before anything imports numpy: our matrices are small, and threads
# that wait for each other made the film tests 10 times slower. Kernels use the cores.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
