"""A fit in words: instruments, parameters, roughness in each band and what it scatters, with 95 % intervals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from psfcli.metrology.fit import Fit
from psfcli.metrology.noise import LEAST_SCATTER
from psfcli.metrology.roughness import NORMAL_95, Estimate, band_rms, scattering
from psfcli.products.units import NM

_FAR = 2.0  # standard errors of its prior from which a gain is remarkable
_SINGLE = 1.35  # scatter of ln of a single periodogram, pi/sqrt(6) = 1.28, and some chance


def lines(fit: Fit, wavelengths: Sequence[float]) -> Iterator[str]:
    """The report, line by line; ``wavelengths`` in mm."""
    width = max(10, *(len(one.measurement.name) for one in fit.instruments))
    yield (
        f"{'instrument':{width}}  {'kind':12}  points  {'band [cycles/mm]':>17}  scatter  averages  correlated  "
        f"{'gain':>5} {'95 %':>13}  sigma in the band [nm]"
    )
    for one in fit.instruments:
        m, gain = one.measurement, _exponential(one.log_gain, one.gain_error)
        mean = f"{one.averages:.3g}" if one.scatter > LEAST_SCATTER else "-"
        yield (
            f"{m.name:{width}}  {m.kind:12}  {len(m.frequency):6}  {m.band[0]:8.3g}..{m.band[1]:<7.3g}  "
            f"{one.scatter:7.3g}  {mean:>8}  {one.correlated:10.2g}  {gain.value:5.3g} "
            f"{f'{gain.low:.3g}..{gain.high:.3g}':>13}  {_interval(band_rms(fit, *m.band), NM)}"
        )
    yield ""
    for j, ((ln_A, ln_B, C), (A_error, B_error, C_error)) in enumerate(zip(fit.parameters, fit.errors, strict=True), 1):
        name = f" {j}" * (len(fit.parameters) > 1)
        yield f"A{name} [nm3]  {_interval(_exponential(ln_A, A_error), NM**3)}"
        yield f"B{name} [mm]   {_interval(_exponential(ln_B, B_error))}"
        C_reach = NORMAL_95 * C_error
        yield f"C{name}        {_interval(Estimate(C, C - C_reach, C + C_reach))}"
    yield from _correlations(fit)
    for wavelength in wavelengths:
        scattered = scattering(fit, wavelength)
        yield (
            f"at {NM * wavelength:.6g} nm: sigma_rel {_interval(scattered.sigma_rel, NM)} nm, "
            f"TIS {_interval(scattered.tis)} (a mirror, normal incidence)"
        )


def warnings(fit: Fit, gain_error: float) -> Iterator[str]:
    """Remarks on what contradicts the assumptions of the fit, one line each."""
    for one in fit.instruments:
        name = one.measurement.name
        if gain_error and abs(one.log_gain) > _FAR * gain_error:
            yield (
                f"{name}: its gain, {np.exp(one.log_gain):.3g}, is {abs(one.log_gain) / gain_error:.2g} standard "
                "errors from 1: the instruments disagree; mend the calibration, or say a larger --gain-error"
            )
        if one.scatter > _SINGLE:
            yield f"{name}: scatters by {one.scatter:.3g} in ln PSD, more than a single periodogram does (1.28)"
        if one.correlated > 3.0:
            yield (
                f"{name}: {one.correlated:.2g} neighbours count as one point: a smoothed spectrum, or one that the fit "
                "does not follow; look at the picture"
            )


def _exponential(logarithm: float, error: float) -> Estimate:
    return Estimate(*(float(np.exp(logarithm + side * NORMAL_95 * error)) for side in (0.0, -1.0, 1.0)))


def _interval(estimate: Estimate, scale: float = 1.0) -> str:
    value, low, high = (f"{scale * end:.4g}" for end in (estimate.value, estimate.low, estimate.high))
    return f"{value} ({low}..{high})"


def _correlations(fit: Fit) -> Iterator[str]:
    """The correlation matrix of ln A, ln B and C, its lower half."""
    names = [
        name + f" {j}" * (len(fit.parameters) > 1)
        for j in range(1, len(fit.parameters) + 1)
        for name in ("ln A", "ln B", "C")
    ]
    errors = fit.errors.ravel()
    yield "standard error, and correlation with the others:"
    for i, name in enumerate(names):
        with_others = (fit.covariance[i, k] / (errors[i] * errors[k]) for k in range(i))
        yield f"  {name:6}  {errors[i]:.3g}".ljust(20) + " ".join(f"{share:7.3f}" for share in with_others)
    yield ""
