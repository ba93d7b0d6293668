"""The scattered light of the whole telescope without aberrations, PSF_S of Eq. 37, as a sum of Gaussians.

OTF_S(q) = prod_j H_j(lambda d_j q): the mirrors' transfer functions multiply, so the convolutions of Eq. 37 cost
nothing, and S, the transform of OTF_S - exp(-G), is radial and the same at every field. Lengths in mm.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from psfcli.image.collapse import Collapse, collapse, is_collapsed
from psfcli.image.horizon import HorizonLoss, clip_change, horizon_loss
from psfcli.image.quadrature import gauss_rule
from psfcli.image.result import SurfaceScatter
from psfcli.surface.harvey_shack import phase_per_height, phase_variance, relative_rms, total_integrated_scatter
from psfcli.surface.mixture import GaussianMixture, ScatterTerm, mixing_density, trapezoid_step
from psfcli.surface.psd import KCorrelation
from psfcli.surface.surface import Surface
from psfcli.telescope.system import Telescope
from psfcli.tolerance import Tolerance

Real = NDArray[np.float64]

_CLIP_SHARE = 0.05  # of the tolerance: a clip that takes less is not modelled


@dataclass(frozen=True, slots=True)
class Halo:
    """Scattered light as a mixture that holds for distances up to ``reach`` [mm], and the unscattered share.

    The mixture integrates to the scattered light only together with what lies beyond. ``left`` holds distances [mm]
    and relative errors there that a finer mixture does not show, ``left_energy`` the energy in them. ``collapsed`` are
    the surfaces so near the image that all their light stays on the unscattered point; ``unscattered_weight`` includes
    it, ``specular_fraction`` does not.
    """

    mixture: GaussianMixture
    specular_fraction: float
    unscattered_weight: float
    reach: float
    left: tuple[Real, Real]
    left_energy: float
    collapsed: tuple[Collapse, ...]

    def held(self, half_width: Real) -> Real:
        """The squares of ``half_width`` [mm] no larger than the mixture holds: what lies beyond belongs to them all."""
        return np.minimum(half_width, self.reach / math.sqrt(2.0))

    def hidden_error(self, distance: float) -> float:
        """The largest relative error within ``distance`` [mm] that a finer mixture does not show."""
        radius, error = self.left
        return float(np.max(error, where=radius <= distance, initial=0.0))

    def collapse_error(self, length: float) -> float:
        """The light, of all, that the collapse may move across an edge of a cell or box of size ``length`` [mm]."""
        return sum(each.error(length) for each in self.collapsed)


def scatter_table(surfaces: Sequence[Surface], telescope: Telescope, wavelength: float) -> tuple[SurfaceScatter, ...]:
    """Each surface's sigma_rel, g, TIS and d_j at ``wavelength`` [mm]."""
    return tuple(
        SurfaceScatter(
            name=surface.name,
            wavelength=wavelength,
            sigma_rel=relative_rms(surface, wavelength),
            g=phase_variance(surface, wavelength),
            tis=total_integrated_scatter(surface, wavelength),
            magnified_distance=telescope.magnified_distance(surface.marginal_height),
            reflectance=surface.reflectance,
        )
        for surface in surfaces
    )


def clip_is_seen(
    surfaces: Sequence[Surface], telescope: Telescope, wavelength: float, reach: float, tolerance: Tolerance
) -> tuple[bool, Tolerance]:
    """Whether the clip at the horizon is modelled, and a bound of what it changes within ``reach`` [mm].

    Not where that is below a share of the ``tolerance``.
    """
    terms = scatter_terms(surfaces, telescope, wavelength)
    change = clip_change(surfaces, terms, telescope, wavelength, reach) if terms else Tolerance(0.0, 0.0)
    return change.pixel > _CLIP_SHARE * tolerance.pixel or change.ee > _CLIP_SHARE * tolerance.ee, change


def scatter_term(surface: Surface, psd: KCorrelation, telescope: Telescope, wavelength: float) -> ScatterTerm:
    """A PSD term scaled to the image plane: width lambda d_j/B, variance (K sigma)^2."""
    return ScatterTerm(
        phase_variance=(phase_per_height(surface, wavelength) * psd.sigma) ** 2,
        width=wavelength * telescope.magnified_distance(surface.marginal_height) / psd.B,
        nu=(psd.C - 1.0) / 2.0,
    )


def scatter_terms(surfaces: Sequence[Surface], telescope: Telescope, wavelength: float) -> tuple[ScatterTerm, ...]:
    """Every PSD term scaled to the image plane; terms of one shape are one, for their variances add."""
    merged: dict[tuple[float, str], ScatterTerm] = {}
    every = (scatter_term(surface, psd, telescope, wavelength) for surface in surfaces for psd in surface.psd)
    for term in every:
        same = merged.get(term_shape(term))
        added = term if same is None else replace(same, phase_variance=same.phase_variance + term.phase_variance)
        merged[term_shape(term)] = added
    return tuple(term for term in merged.values() if term.phase_variance > 0.0)


def term_shape(term: ScatterTerm) -> tuple[float, str]:
    """What terms have in common whose autocovariances in the image are proportional: order, and width to rounding."""
    return term.nu, f"{term.width:.12g}"


def scattered_light(
    surfaces: Sequence[Surface], telescope: Telescope, wavelength: float, reach: float, tolerance: Tolerance
) -> Halo:
    """PSF_S of Eq. 37 for distances up to ``reach`` [mm], its density to ``tolerance.pixel`` relative and its energy to

    ``tolerance.ee``, both within a fraction that leaves room for the other steps.
    """
    rows = scatter_table(surfaces, telescope, wavelength)
    near = [is_collapsed(row.magnified_distance, reach) for row in rows]
    collapsed = tuple(
        collapse(surface, telescope, wavelength) for surface, is_near in zip(surfaces, near, strict=True) if is_near
    )
    surfaces = [surface for surface, is_near in zip(surfaces, near, strict=True) if not is_near]
    total_variance = sum(phase_variance(surface, wavelength) for surface in surfaces)
    terms = scatter_terms(surfaces, telescope, wavelength)
    specular_fraction = math.exp(-sum(row.g for row in rows))
    unscattered_weight = math.exp(-total_variance)
    if not terms:
        nothing = GaussianMixture(np.empty(0), np.empty(0))
        return Halo(nothing, specular_fraction, unscattered_weight, reach, (np.zeros(1), np.zeros(1)), 0.0, collapsed)
    # energies average the mixture's error over radius: they keep a hundredth of it
    share = min(0.3 * tolerance.pixel, 10.0 * tolerance.ee)
    step = trapezoid_step(share, max(term.nu for term in terms), total_variance)
    flattest = min(term.nu for term in terms)
    # one-fold light has v = w^2/2t with t gamma-distributed of order nu + 1: nothing lies below t = nu + 60
    low = min(0.5 * term.width**2 / (term.nu + 60.0) for term in terms)
    # terms wider than all this add a pedestal smaller than the error allowed at the farthest distance: of one sign,
    # which energies do not average, and on a density from which the horizon may take nearly all
    pedestal = min(share, 1e-3 * tolerance.ee)
    high = max(reach, *(term.width for term in terms)) ** 2 * pedestal ** (-1.0 / (1.0 + flattest))
    variance = np.exp(np.arange(math.log(low), math.log(high), step))
    density, doubt = mixing_density(variance, terms, total_variance)
    weight, variance = _without_empty_core(step * density, variance, share)
    mixture = _merge_wide_terms(GaussianMixture(weight, variance), reach)
    seen, change = clip_is_seen(surfaces, telescope, wavelength, reach, tolerance)
    loss = horizon_loss(surfaces, telescope, wavelength, mixture, reach) if seen else HorizonLoss.ignored(change)
    return Halo(
        GaussianMixture(
            np.append(mixture.weight, -loss.mixture.weight), np.append(mixture.variance, loss.mixture.variance)
        ),
        specular_fraction,
        unscattered_weight,
        reach,
        (loss.radius, loss.left + doubt),
        loss.energy + doubt * (1.0 - unscattered_weight),
        collapsed,
    )


def _without_empty_core(weight: Real, variance: Real, share: float) -> tuple[Real, Real]:
    """The mixture less the narrowest terms that together hold less than ``share`` of energy and central density."""
    peak = np.cumsum(weight / variance)
    energy = np.cumsum(weight)
    empty = (peak < 0.1 * share * peak[-1]) & (energy < 0.1 * share * energy[-1])
    first = int(np.argmin(empty))
    return weight[first:], variance[first:]


def _merge_wide_terms(mixture: GaussianMixture, reach: float) -> GaussianMixture:
    """The same density within ``reach``, all terms with s > 2 reach replaced by three.

    Seen from r <= reach such terms are exp(-y r^2/2) with y r^2/2 <= 1/8, y = 1/v: a measure in y whose three-point
    Gauss rule (Golub & Welsch) leaves a relative error below (1/8)^6/6! 2^-11 ~ 3e-12.
    """
    lit = mixture.weight > 0.0
    mixture = GaussianMixture(mixture.weight[lit], mixture.variance[lit])
    wide = mixture.variance > 4.0 * reach**2
    if np.count_nonzero(wide) <= 3:
        return mixture
    y = 1.0 / mixture.variance[wide]
    scale = y.max()
    nodes, masses = gauss_rule(y / scale, mixture.weight[wide] * y, 3)
    return GaussianMixture(
        np.append(mixture.weight[~wide], masses / (nodes * scale)),
        np.append(mixture.variance[~wide], 1.0 / (nodes * scale)),
    )
