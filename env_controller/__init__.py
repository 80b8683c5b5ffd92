"""PC1: the environment-control agent, which hands out work and is the only way to a worker."""
