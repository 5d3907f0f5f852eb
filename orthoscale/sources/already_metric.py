"""Where a model's cameras stand in its coordinates, which may show that these are metres already."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.source import GpsScale

# Cameras this many times their own extent from the origin have map coordinates; a reconstruction's own origin lies
# among its cameras.
FAR_OFF = 100.0
GPS_SURE = 0.03  # relative one sigma of a scale by GPS up to which 1 m per unit is no coincidence


@dataclass(frozen=True)
class FromOrigin:
    """away : distance of a model's cameras from its origin, extent : theirs [model units]."""

    away: float
    extent: float

    @classmethod
    def of(cls, centres: np.ndarray) -> FromOrigin:
        """Of the camera centres (N, 3)."""
        return cls(float(np.linalg.norm(np.median(centres, axis=0))), float(np.linalg.norm(np.ptp(centres, axis=0))))

    @property
    def as_on_a_map(self) -> str:
        """Says that the coordinates are those of a map; empty if they are not."""
        if not self.away > FAR_OFF * self.extent > 0:
            return ""
        return (
            f"its cameras stand {self.away:,.0f} from its origin and within {self.extent:,.0f} of each other, "
            "as on a map"
        )

    def moved(self, scale: float) -> str:
        """Says how far a model in map coordinates moves when it is scaled by `scale` about their origin; empty for
        other models."""
        if not self.as_on_a_map:
            return ""
        away = f"the copy is {abs(scale - 1) * self.away:,.0f} m away from its place there"
        return f"its coordinates, as on a map, are scaled about their own origin: {away}"


def where_gps_says(gps: GpsScale) -> str:
    """Says that the GPS positions of a model's frames are its cameras' own; empty if they are not."""
    for told in gps.evidence:
        if told.relative_sd < GPS_SURE and abs(np.log(told.value)) < 2 * told.relative_sd:
            return f"{told.says} are those of its cameras ({told.value:.3f} m per unit)"
    return ""
