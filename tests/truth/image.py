"""The composite image of one field in many rectangles: the quick judge, for images whose halo is tabled once.

As ``ensquared``, an energy is the unscattered light of the rectangle plus that of S about every ray (``rectangle``),
which the rule of ``pupil`` adds up over the lit pupil.
"""

from __future__ import annotations

import numpy as np

from .geometry import ray_error
from .pupil import FAINTEST, azimuths, pupil_mean
from .radial import RadialScatter, radial_scatter
from .rectangle import Window, energy_about, scales_about
from .specular import specular_energy
from .system import TruthSystem, specular_weight

_UNSCATTERED = 3e-10  # the tolerance of unscattered light, of all light


class Image:
    """One system's image; ``reach`` [mm] bounds the distances between its rays and any corner asked for.

    Energies are fractions of all light: scattered light to 1e-8 of itself, unscattered to 1e-9.
    """

    def __init__(self, system: TruthSystem, reach: float) -> None:
        self.system = system
        self.specular = specular_weight(system)
        self.halo: RadialScatter | None = None
        if system.surfaces:
            self.halo = radial_scatter(system, reach)
        rho, phi = np.linspace(system.obscuration, 1.0, 65)[:, None], np.linspace(*azimuths(system), 721)
        ex, ey = ray_error(system, rho * np.cos(phi), rho * np.sin(phi))
        self._fan = ex.ravel(), ey.ravel()
        self.bounds = float(ex.min()), float(ex.max()), float(ey.min()), float(ey.max())
        self.is_point = self.bounds[1] == self.bounds[0] and self.bounds[3] == self.bounds[2]

    def touches(self, window: Window) -> bool:
        """Whether unscattered light falls into the window: a ray of a fan does, or there is energy."""
        x, y = self._fan
        x0, x1, y0, y1 = window
        return bool(np.any((x >= x0) & (x <= x1) & (y >= y0) & (y <= y1))) or self.unscattered(window) > 0.0

    def unscattered(self, window: Window) -> float:
        """Fraction of PSF_G in the window."""
        x0, x1, y0, y1 = self.bounds
        # the extremes of a fine fan of rays, and more than the fan may have missed
        slack = 1e-2 * max(x1 - x0, y1 - y0)
        x0, x1, y0, y1 = x0 - slack, x1 + slack, y0 - slack, y1 + slack
        if x0 > window[0] and x1 < window[1] and y0 > window[2] and y1 < window[3]:
            return 1.0
        if x1 < window[0] or x0 > window[1] or y1 < window[2] or y0 > window[3]:
            return 0.0
        return specular_energy(self.system, *window, _UNSCATTERED / max(self.specular, 1e-3))

    def scattered(self, window: Window, absolute: float = FAINTEST) -> float:
        """Energy of PSF_G (x) S in the window, relative error ``RELATIVE`` or ``absolute`` error."""
        if (halo := self.halo) is None:
            return 0.0
        if self.is_point:
            x, y = (np.array([self.bounds[i]]) for i in (0, 2))
            return float(energy_about(halo, window, x, y)[0])
        return pupil_mean(
            self.system,
            lambda x, y, error: energy_about(halo, window, x, y, error),
            lambda x, y: scales_about(halo, window, x, y),
            absolute,
        )

    def energy(self, window: Window, absolute: float = FAINTEST) -> float:
        """Fraction of all light in the window (x0, x1, y0, y1) [mm], within 1e-8 of it or ``absolute``."""
        lit = self.specular * self.unscattered(window) if self.specular > 1e-18 else 0.0
        return lit + self.scattered(window, max(absolute, min(1e-8 * lit, _UNSCATTERED)))

    def square(self, half_width: float, centre: tuple[float, float] = (0.0, 0.0)) -> float:
        """Ensquared energy: the square of ``half_width`` [mm] about ``centre`` [mm]."""
        cx, cy = centre
        return self.energy((cx - half_width, cx + half_width, cy - half_width, cy + half_width), _UNSCATTERED)
