"""How surfaces scatter: profiles of their BSDF, and how far it is from shift-invariant (Fig. 7)."""
