"""PC2 and PC3: the thin-film worker, the ray-tracing worker, and the descriptions both share."""
