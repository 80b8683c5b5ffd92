"""PC2: wave optics of thin films, from a stack to its table, its spectra, its ellipsometry and its emission."""


def warm_up() -> None:
    """Compile the film kernels, or load what was compiled before, so that the first request need not wait."""
    # imported here: describing the worker or asking for help must not import the compiler
    import numpy as np

    from containers.thin_film.lossless import family_reflectance
    from containers.thin_film.nodes import Axis
    from containers.thin_film.refinement import interpolation_error
    from containers.thin_film.transfer_matrix import solve

    family_reflectance(1.5, 1.0, [1.4], [100.0], [[0]], [500.0], [0.5])
    solve([1.5, 1.4, 1.0], [100.0], 0.0, [500.0], [0.5])
    interpolation_error(np.zeros((1, 3)), Axis((1.0,), 2, 0, np.arange(3, dtype=np.int32)))
