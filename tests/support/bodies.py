"""Bodies of vehicles as explicit points, so that the program's own hull is tested against something independent.

A body is a stack of rings: (height [m], front, rear, half width), the latter three as shares of the vehicle's length
and width from its middle. Corners are cut off, by a share of the width across and by 1 / 2.4 of that along the length.
"""

from __future__ import annotations

import numpy as np

Rings = tuple[tuple[float, float, float, float], ...]

# A mid-size car: its full footprint up to the bumpers at 0.4 m; above, its ends lean inwards by 10 % of the length for
# each metre. From the belt line at 0.85 m to the roof at 1.5 m it also narrows, by 30 % of the length in front, 12 %
# behind and 10 % of the width on each side.
CAR: Rings = ((0.0, 0.5, -0.5, 0.5), (0.4, 0.5, -0.5, 0.5), (0.85, 0.455, -0.455, 0.5), (1.5, 0.09, -0.27, 0.4))
# The same with vertical ends up to the belt line.
UPRIGHT: Rings = ((0.0, 0.5, -0.5, 0.5), (0.85, 0.5, -0.5, 0.5), (1.5, 0.2, -0.38, 0.4))
# A car that narrows less: a tall estate.
ESTATE: Rings = ((0.0, 0.5, -0.5, 0.5), (0.85, 0.5, -0.5, 0.5), (1.5, 0.3, -0.45, 0.45))
# A van: belt line at 1.1 m, roof at 2.0 m, hardly narrowed behind.
VAN: Rings = ((0.0, 0.5, -0.5, 0.5), (1.1, 0.5, -0.5, 0.5), (2.0, 0.32, -0.48, 0.44))
CAR_CORNER, VAN_CORNER = 0.25, 0.10  # of the width


def body(rings: Rings = CAR, top: float = 0.8, corner: float = CAR_CORNER) -> tuple[np.ndarray, np.ndarray]:
    """The part of a body below `top` [m]: (P, 2) points for unit length and width, and (P,) their heights [m]."""
    levels = np.array([ring[0] for ring in rings])
    kept = [*levels[levels < top], min(top, levels[-1])]
    front, rear, side = (np.interp(kept, levels, [ring[k] for ring in rings]) for k in (1, 2, 3))
    plan = []
    for f, r, s in zip(front, rear, side, strict=True):
        cut = corner / 2.4
        plan += [(f, s - corner), (f - cut, s), (r + cut, s), (r, s - corner)]
        plan += [(r, corner - s), (r + cut, -s), (f - cut, -s), (f, corner - s)]
    return np.array(plan), np.repeat(kept, 8)


def block(height: float) -> tuple[np.ndarray, np.ndarray]:
    """A cuboid of `height` [m], as from `body`."""
    corners = [(x, y) for x in (0.5, -0.5) for y in (0.5, -0.5)]
    return np.array(corners * 2), np.repeat([0.0, height], 4)
