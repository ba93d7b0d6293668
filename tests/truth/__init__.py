"""The judge: what the tests hold the product against.

Nothing here imports psfcli, and no method is shared with it. Plain functions on plain numbers: lengths in mm, spatial
frequencies in cycles/mm, angles in rad, energies as fractions of all light.

=============  ==================================================================================================
module         what it computes, and how
=============  ==================================================================================================
system         ``TruthSystem``: the numbers that define a case
correlation    1 - rho(u) of a K-correlation surface, in doubles and in mpmath
scatter        transfer functions, S(r) from the contour, and by FFTLog
contour        S(r) on a slanted ray of the complex plane, in mpmath; tables of it
contours       S(r) in doubles, each radius on the contour that loses least
radial         tables of that and of its energy
panels         S(r) on the real axis, by panels between Bessel zeros
horizon        what the clip at the horizon takes away from S
geometry       third-order ray errors, counted rays, closed forms of simple spots
specular       unscattered light in a rectangle: the lit fraction of rings of the pupil, between its kinks
rings          that fraction: crossings of a ring with the edges as roots of quartics
ensquared      energies of pixels, boxes and of all that lies outside a window
image          the same energies, quickly: tables of the halo, cells of the pupil
rectangle      the energy of S about rays in a rectangle
pupil          means over the pupil, in cells
montecarlo     sampled deviations and ray errors
cases          the paper's telescope and the reference systems
halo           S(r) of sixteen systems, stored
scenes         system files as dictionaries, read anew
random_systems system files at random, over all a user may have
=============  ==================================================================================================
"""

from .ensquared import box_energy, outside_fraction, pixel_energy
from .scatter import scatter_psf
from .system import TruthSystem

__all__ = ["TruthSystem", "box_energy", "outside_fraction", "pixel_energy", "scatter_psf"]
