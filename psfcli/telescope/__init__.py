"""The telescope as third-order optics sees it (Eq. 2-5)."""
