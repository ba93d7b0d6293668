"""Profiles of a BSDF as a picture, in the manner of Fig. 7: by scatter angle, and shifted by the specular one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import groupby
from typing import Any, BinaryIO

import numpy as np

from psfcli.pictures.canvas import sheet
from psfcli.scattering.profile import Profile

_DECADES = 24  # of the BSDF that are drawn
_SHADES = ("#08306b", "#e6550d", "#41ab5d", "#9e9ac8", "#bdbdbd")  # from dark to light


def draw(stream: BinaryIO, title: str, profiles: Sequence[Profile]) -> None:
    """Write the picture as PNG: a row of two panels for each kind of surface. Raises ImportError without matplotlib."""
    kinds = [(names, list(same)) for names, same in groupby(profiles, key=lambda profile: profile.surfaces)]
    with sheet(stream, 8.6, 0.5 + 3.4 * len(kinds)) as figure:
        rows = figure.subplots(len(kinds), 2, squeeze=False)
        for (by_angle, shifted), (names, same) in zip(rows, kinds, strict=True):
            for number, profile in enumerate(same):
                # the first ones wider, since where they agree they lie on each other
                width = 1.0 + 3.0 * (1.0 - (number + 1) / len(same))
                _curves(by_angle, shifted, profile, _SHADES[number % len(_SHADES)], width)
            _axes(by_angle, shifted, same)
            by_angle.set_title(" and ".join(names), fontsize=9)
        figure.suptitle(title, fontsize=9.5)


def _curves(by_angle: Any, shifted: Any, profile: Profile, colour: str, width: float) -> None:
    label = f"{math.degrees(profile.scatter.incidence.angle):.6g}°"
    by_angle.plot(np.degrees(profile.theta_s), profile.bsdf, color=colour, lw=width, label=label)
    for side, style in ((1.0, "-"), (-1.0, ":")):
        on = side * profile.offset > 0.0
        name = f"{label}, {'away from' if side > 0.0 else 'towards'} the normal"
        shifted.plot(np.abs(profile.offset[on]), profile.bsdf[on], color=colour, lw=width, ls=style, label=name)


def _axes(by_angle: Any, shifted: Any, profiles: Sequence[Profile]) -> None:
    top = max(float(profile.bsdf.max()) for profile in profiles)
    least = min(float(profile.bsdf[profile.bsdf > 0.0].min()) for profile in profiles)
    ends = max(0.3 * least, 10.0**-_DECADES * top), 3.0 * top
    by_angle.set(xlabel="scatter angle θ$_s$  [deg]", xlim=(-90, 90), xticks=range(-90, 91, 30), ylabel="BSDF  [1/sr]")
    shifted.set(xlabel="$|β-β_0|$, direction cosines", xscale="log")
    for axis in (by_angle, shifted):
        axis.set(yscale="log", ylim=ends)
        axis.minorticks_off()
        axis.legend(fontsize=7.5)
