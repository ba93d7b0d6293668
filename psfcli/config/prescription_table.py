"""The keys of a prescription: the part of the table of keys that says how a telescope is built."""

from __future__ import annotations

from psfcli.config.kinds import Either, Key, Listing, Number, Quantity, Section, Text, Variants, Word
from psfcli.config.units import INVERSE_POWERS, LENGTH

INDEX = Number(0.1, 10)

_NAME = Key(Text(), "What reports, stop and the list of finishes under surfaces call it.", required=True)
_KIND = Key(
    Word(("mirror", "refracting", "aperture")), "What it does to light; an aperture: nothing.", default="mirror"
)
_THICKNESS = Key(
    Either(scalar=Quantity(LENGTH, "-1e6 km", "1e6 km", "mm"), word=Word(("focus",))),
    "Along z to the next vertex, below 0 after an odd number of mirrors; the last one to the detector, or focus.",
    required=True,
)
_SHAPE = {
    "radius": Key(
        Either(scalar=Quantity(LENGTH, "1 um", "1e6 km", "mm", magnitude=True), word=Word(("flat",))),
        "Radius of curvature; above 0 its centre lies towards +z, the way light enters.",
        required=True,
    ),
    "conic": Key(Number(-1e6, 1e6), "Conic constant K: 0 a sphere, -1 a paraboloid.", default=0),
    "aspheric": Key(
        Section(
            {
                f"A{n + 1}": Key(
                    Quantity(INVERSE_POWERS[n], f"-1e12 1/mm^{n}", f"1e12 1/mm^{n}", f"1/mm^{n}"),
                    f"Coefficient of r^{n + 1} in the sag.",
                )
                for n in INVERSE_POWERS
            },
            name="aspheric",
        ),
        "What is added to the sag of the conic.",
    ),
}

OPTICAL_SURFACE = Variants(
    "kind",
    "mirror",
    {
        "mirror": Section(
            {"name": _NAME, "kind": _KIND, **_SHAPE, "thickness": _THICKNESS},
            name="prescription.surfaces[], kind mirror",
        ),
        "refracting": Section(
            {
                "name": _NAME,
                "kind": _KIND,
                **_SHAPE,
                "thickness": _THICKNESS,
                "index": Key(INDEX, "Refractive index behind it.", required=True),
            },
            name="prescription.surfaces[], kind refracting",
        ),
        "aperture": Section(
            {"name": _NAME, "kind": _KIND, "thickness": _THICKNESS},
            name="prescription.surfaces[], kind aperture",
        ),
    },
)

PRESCRIPTION = Section(
    {
        "stop": Key(Text(), "Name of the surface that limits the beam.", required=True),
        "surfaces": Key(Listing(OPTICAL_SURFACE, 1, 1000), "In the order light meets them.", required=True),
        "image_shift": Key(
            Quantity(LENGTH, "-1 km", "1 km", "mm"),
            "Detector from the paraxial image, above 0 behind it as light goes; needs a last thickness of focus.",
        ),
        "object_distance": Key(
            Quantity(LENGTH, "1 um", "1e6 km", "mm"), "Object to first vertex; default: the object lies at infinity."
        ),
        "index_before": Key(INDEX, "Refractive index of the object's space.", default=1, needs="object_distance"),
    },
    name="prescription",
)
