"""Every tolerance of the library, by name, with its unit and the reason for its size.

The formulas themselves need none: they hold their accuracy at any distance from a singularity.
Tolerances only decide what counts as a rotation matrix, as reachable, as inside a limit, as
singular, and as an arm of the class that is solved here.
"""

from __future__ import annotations

from typing import Final

ROTATION_TOLERANCE: Final = 1e-6
"""Largest |r_i . r_j - delta_ij| and |r_0 x r_1 - r_2| of a rotation matrix [1].

Lets poses through that were stored as float32, and refuses scaled and reflected matrices.
"""

REACH_TOLERANCE: Final = 1e-14
"""How far the wrist center may lie outside of reach and count as on its edge.

As a fraction of the stretched arm's length [1]. Rounding alone puts half of the poses of an exactly
stretched arm outside, by some 1e-16. A pose that is outside gets the configurations of the nearest
one that is not, so what is granted here is what such a solution may be off.
"""

SHARPEN: Final = 1e-9
"""Closer to the edge of reach the elbow is computed in extended precision; fraction of reach [1].

Nothing but the digits of theta3 depends on it: without, they would be off by up to four times what
the rounding of the pose makes them.
"""

SINGULAR_TOLERANCE: Final = 1e-9
"""Below this distance from a singularity a branch is flagged as singular [1].

The distances are those of `ik.singularity_distances`; nothing but the flag depends on it.
"""

SLIDE_TOLERANCE: Final = 1e-12
"""Below this |sin theta5| joint 4 may be given any angle, joint 6 following [1].

That turns the tool by no more than twice as much.
"""

LIMIT_SLACK: Final = 1e-9
"""How far a joint may lie outside of its limits and count as inside [rad]."""

ANGLE_TOLERANCE: Final = 1e-6
"""How far axes may be from parallel or perpendicular in an arm of the class [rad].

1.570796 for pi/2 passes (3e-7), 1.5708 does not (4e-6) unless the caller loosens the tolerance.
"""

LENGTH_TOLERANCE: Final = 1e-6
"""How far the three wrist axes may miss their common point in an arm of the class [m]."""

CLOSE_POSE: Final = 0.1
"""Waypoints are close below this distance, rotation plus translation over L2 + L3 [rad]."""

STRAY: Final = 0.01
"""Between close waypoints the tool may be this much further from them than they are apart [rad].

As a distance of the same kind. Beyond it the step is a jump.
"""

TIE_WEIGHT: Final = 1e-9
"""Weight of the sum of the joints' times against the time of the slowest one [1].

Decides between paths that take the same time in favour of the one with less travel.
"""

SMALL: Final = 1e-100
"""Shorter lengths are taken as zero, before their squares lose digits to underflow [m]."""
