"""What a step is worth: the paper's three rewards, and a plain one. U in [0, 1] here, in percent in the formulas."""

from __future__ import annotations

from luxloop.campaign import Reward


def reward_of(name: Reward, uniformity: float, before: float | None) -> float:
    """The reward of having come to `uniformity` from `before` (None: a lane's beginning, where nothing changed).

    Notes
    -----
    r1 = (U - U_before) / 100 (Eq. 3, as Table 5 has it), r2 = (U - 75)^3 / 1000 (Eq. 4), r3 = (U - 79)^3 / 1000
    (Eq. 5), gain = (U - U_before) / 10.
    """
    percent = 100.0 * uniformity
    change = 0.0 if before is None else percent - 100.0 * before
    match name:
        case "r1":
            return change / 100.0
        case "r2":
            return (percent - 75.0) ** 3 / 1000.0
        case "r3":
            return (percent - 79.0) ** 3 / 1000.0
        case "gain":
            return change / 10.0
