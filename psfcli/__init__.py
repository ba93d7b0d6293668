"""Image degradation by surface scatter and aberrations together (Choi & Harvey 2012).

In Python: ``system = psfcli.load("telescope.yaml")``, ``psfcli.plan(system)``, ``result = psfcli.run(system)``; then
``result.psf`` and ``result.ensquared_energy`` are arrays and tables with units.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from psfcli.config import ConfigError as ConfigError
    from psfcli.config import load as load
    from psfcli.products import OutputError as OutputError
    from psfcli.recipe import SceneError as SceneError
    from psfcli.recipe import plan as plan
    from psfcli.recipe import run as run
    from psfcli.recipe import write as write

__all__ = ["ConfigError", "OutputError", "SceneError", "load", "plan", "run", "write"]


def __getattr__(name: str) -> Any:
    # imported when asked for, so that the command line starts quickly
    if name in {"SceneError", "plan", "run", "write"}:
        from psfcli import recipe

        return getattr(recipe, name)
    if name in {"load", "ConfigError"}:
        from psfcli import config

        return getattr(config, name)
    if name == "OutputError":
        from psfcli import products

        return products.OutputError
    raise AttributeError(f"module 'psfcli' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
