"""Heights, first-order quantities and Seidel sums of the prescriptions in this directory, by optiland.

``python optiland_values.py > optiland.csv`` in an environment with optiland 0.6.3 and PyYAML; it is no dependency of
the tests, which read the values. Nothing of psfcli is imported: the system files are read as plain YAML.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml
from optiland.materials import IdealMaterial
from optiland.optic import Optic


def length(text):
    return float(text.removesuffix("mm"))


def optic(system):
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
    made.set_aperture(aperture_type="EPD", value=length(system["telescope"]["aperture_diameter"]))
    made.fields.set_type(field_type="angle")
    made.fields.add(y=0.0)
    made.fields.add(y=float(system["telescope"]["max_field"].removesuffix("deg")))
    made.wavelengths.add(value=float(system["wavelengths"][0].removesuffix("nm")) / 1000.0, is_primary=True)
    return made


print("system,quantity,value")
for path in sorted(Path(__file__).parent.glob("*.yaml")):
    made = optic(yaml.safe_load(path.read_text()))
    y, u = (np.ravel(v) for v in made.paraxial.marginal_ray())
    ybar, _ = (np.ravel(v) for v in made.paraxial.chief_ray())
    found = {"focal_length": made.paraxial.f2(), "image_distance": -y[-2] / u[-2]}
    # its sums have the sign of the longitudinal convention of Smith; the test says which
    found |= {f"S{k}": S for k, S in enumerate(np.ravel(made.aberrations.seidels()), start=1)}
    found |= {f"y{j}": v for j, v in enumerate(y[1:-1])} | {f"ybar{j}": v for j, v in enumerate(ybar[1:-1])}
    for name, value in found.items():
        print(f"{path.stem},{name},{float(np.squeeze(value))!r}")
