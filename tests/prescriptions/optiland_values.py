"""Heights, first-order quantities and Seidel sums of the prescriptions in this directory, by optiland.

``python optiland_values.py > optiland.csv`` in an environment with optiland 0.6.3 and PyYAML; it is no dependency of
the tests, which read the values. Nothing of psfcli is imported: the system files are read as plain YAML.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import yaml
from optiland.materials import IdealMaterial
from optiland.optic import Optic


def length(text):
    return float(text.removesuffix("mm"))


def optic(system, fraction=1.0):
    """The system with its detector at the paraxial image, and a fraction of its field."""
    made, given = Optic(), system["prescription"]
    made.surfaces.add(index=0, radius=np.inf, thickness=np.inf)
    for j, s in enumerate(given["surfaces"], start=1):
        made.surfaces.add(
            index=j,
            radius=length(s["radius"]),
            conic=s.get("conic", 0.0),
            thickness=0.0 if s["thickness"] == "focus" else length(s["thickness"]),
            material=IdealMaterial(s["index"]) if "index" in s else "mirror",
            is_stop=s["name"] == given["stop"],
        )
    made.surfaces.add(index=len(given["surfaces"]) + 1)
    degrees = fraction * float(system["telescope"]["max_field"].removesuffix("deg"))
    made.set_aperture(aperture_type="EPD", value=length(system["telescope"]["aperture_diameter"]))
    made.fields.set_type(field_type="angle")
    made.fields.add(y=0.0)
    made.fields.add(y=degrees)
    made.wavelengths.add(value=float(system["wavelengths"][0].removesuffix("nm")) / 1000.0, is_primary=True)
    y, u = (np.ravel(v) for v in made.paraxial.marginal_ray())
    made.updater.set_thickness(-y[-2] / u[-2], len(given["surfaces"]))
    return made, math.tan(math.radians(degrees))


def distortion(system):
    """The third-order S_V, from exact chief rays of two small fields: y - f tan = -(S_V/2)/u' H^3 + O(H^5)."""
    full = optic(system)[1]
    cubic = []
    for fraction in (0.05, 0.025):
        made, tangent = optic(system, fraction)
        _, u = (np.ravel(v) for v in made.paraxial.marginal_ray())
        made.ray_tracer.set_aiming("iterative", max_iter=100, tol=1e-13)
        rays = made.trace_generic(0.0, 1.0, 0.0, 0.0, made.primary_wavelength)
        off = float(np.squeeze(rays.y)) - float(np.squeeze(made.paraxial.f2())) * tangent
        cubic.append(-2.0 * abs(u[-2]) * off / (tangent / full) ** 3)
    return (4.0 * cubic[1] - cubic[0]) / 3.0


print("system,quantity,value")
for path in sorted(Path(__file__).parent.glob("*.yaml")):
    system = yaml.safe_load(path.read_text())
    made, _ = optic(system)
    y, u = (np.ravel(v) for v in made.paraxial.marginal_ray())
    ybar, _ = (np.ravel(v) for v in made.paraxial.chief_ray())
    found = {"focal_length": made.paraxial.f2(), "image_distance": -y[-2] / u[-2]}
    # its sums have the other sign; its distortion does not fit its own rays where there are mirrors, so rays it is
    found |= {f"S{k}": -S for k, S in enumerate(np.ravel(made.aberrations.seidels())[:4], start=1)}
    found["S5"] = distortion(system)
    found |= {f"y{j}": v for j, v in enumerate(y[1:-1])} | {f"ybar{j}": v for j, v in enumerate(ybar[1:-1])}
    for name, value in found.items():
        print(f"{path.stem},{name},{float(np.squeeze(value))!r}")
