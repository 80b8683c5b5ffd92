"""The catalogue: one file for each physical effect, with its formula and where that is written.

An effect here imports the descriptions (`containers.effect`, `scene`, `stack`, `bsdf`, `materials`) and nothing of
the workers.
"""
