"""The deterministic twin of Monte Carlo: the same scene, smooth in every parameter (docs/decisions/0017).

direct, direct_kernel   light before its first arrival at the receiver, landed from stored exits
closure, shadow         what comes back from above, and what chips do to it
cell, exchange, module  an endless array; a finite one
reweighting, columns    stored exits of a slightly other chip; parameters and their steps
prediction              Monte Carlo at an anchor plus the twin's differences; images and Jacobians
"""
