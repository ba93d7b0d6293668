"""Seidel sums: third-order aberrations of a prescription, surface by surface, as a table of wavefront coefficients.

W. T. Welford, Aberrations of Optical Systems (1986), section 8: with A = n i and Abar = n ibar of the marginal and the
chief ray, H the Lagrange invariant, c the curvature and D(.) the change of a quantity at the surface,

    S_I   = -A^2 y D(u/n)              W040 = S_I/8
    S_II  = -A Abar y D(u/n)           W131 = S_II/2
    S_III = -Abar^2 y D(u/n)           W222 = S_III/2
    S_IV  = -H^2 c D(1/n)              W220 = (S_III + S_IV)/4
    S_V   = -Abar [Abar^2 y D(1/n^2) + (H - Abar y) ybar c D(1/n)]      W311 = S_V/2

and the departure of an asphere from its sphere, (K c^3/8 + A4) r^4, adds g y^4, g y^3 ybar, g y^2 ybar^2, 0 and
g y ybar^3, g = (K c^3 + 8 A4) D(n). Terms of r^6 and beyond are of higher order.
"""

from __future__ import annotations

from psfcli.telescope.paraxial import ParaxialTrace
from psfcli.telescope.prescription import OpticalSurface
from psfcli.telescope.seidel import SeidelTable


def surface_tables(trace: ParaxialTrace) -> tuple[SeidelTable, ...]:
    """Each surface's part of the wavefront at the pupil rim and full field [mm], in the order light meets them."""
    return tuple(_table(trace, j, surface) for j, surface in enumerate(trace.prescription.surfaces))


def defocus(trace: ParaxialTrace) -> SeidelTable:
    """W020 [mm] of a detector ``image_shift`` behind the paraxial image: u'^2 shift/(2 n'), < 0 inside focus."""
    n = abs(trace.indices[-1])
    return SeidelTable(W020=trace.image_slope**2 * trace.prescription.image_shift / (2.0 * n))


def system_table(trace: ParaxialTrace) -> SeidelTable:
    """The table of the whole: the sum of the surfaces' (Eq. 3, 5) and the detector's defocus [mm]."""
    return SeidelTable.total([*surface_tables(trace), defocus(trace)])


def petzval_radius(trace: ParaxialTrace) -> float:
    """Radius of the Petzval surface [mm], > 0 where it bends the way light goes (a positive lens: < 0); or infinite.

    1/radius = n' sum c D(1/n).
    """
    n = trace.indices
    curvature = sum(
        s.curvature * (1.0 / behind - 1.0 / before)
        for s, before, behind in zip(trace.prescription.surfaces, n, n[1:], strict=False)
    )
    return 1.0 / (abs(n[-1]) * curvature) if curvature else float("inf")


def _table(trace: ParaxialTrace, j: int, surface: OpticalSurface) -> SeidelTable:
    n, behind = trace.indices[j], trace.indices[j + 1]
    y, ybar, c = trace.marginal.heights[j], trace.chief.heights[j], surface.curvature
    u, u_behind = trace.marginal.slopes[j], trace.marginal.slopes[j + 1]
    i, ibar = trace.incidences[j]
    H, A, Abar = trace.lagrange_invariant, n * i, n * ibar
    bend = y * (u_behind / behind - u / n)  # y D(u/n)
    inverse, inverse_squared = 1.0 / behind - 1.0 / n, 1.0 / behind**2 - 1.0 / n**2
    fourth_order = surface.aspheric[0] if surface.aspheric else 0.0
    g = (surface.conic * c**3 + 8.0 * fourth_order) * (behind - n)
    S1 = -(A**2) * bend + g * y**4
    S2 = -A * Abar * bend + g * y**3 * ybar
    S3 = -(Abar**2) * bend + g * y**2 * ybar**2
    S4 = -(H**2) * c * inverse
    S5 = -Abar * (Abar**2 * y * inverse_squared + (H - Abar * y) * ybar * c * inverse) + g * y * ybar**3
    return SeidelTable(W040=S1 / 8.0, W131=S2 / 2.0, W222=S3 / 2.0, W220=(S3 + S4) / 4.0, W311=S5 / 2.0)
