"""The house held as a table: who imports whom, what is imported where, and how large a module may grow."""

from __future__ import annotations

import ast
import sys
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent / "psfcli"

# From the user down to the physics; imports go down only.
ORDER = (
    "cli",
    "validation",
    "tradeoff",
    "scattering",
    "prediction",
    "recipe",
    "config",
    "metrology",
    "products",
    "planning",
    "image",
    "montecarlo",
    "surface",
    "telescope",
    "pictures",
    "tolerance",
)

# What each part may import of the others, for type checkers too: nobody needs the name of what they must not know.
# recipe.py alone joins planning, image and products; products know images, not how they were asked for or planned.
MAY_IMPORT = {
    "cli": {
        "validation",
        "tradeoff",
        "scattering",
        "prediction",
        "recipe",
        "config",
        "metrology",
        "products",
        "planning",
        "telescope",
        "pictures",
        "tolerance",
    },
    # it alone joins the rays with what they judge
    "validation": {
        "recipe",
        "config",
        "products",
        "image",
        "montecarlo",
        "surface",
        "telescope",
        "pictures",
        "tolerance",
    },
    "tradeoff": {
        "montecarlo",
        "recipe",
        "config",
        "products",
        "planning",
        "image",
        "surface",
        "telescope",
        "pictures",
        "tolerance",
    },
    "scattering": {"surface", "pictures"},  # surfaces alone: no image, no telescope
    "prediction": {"recipe", "planning", "image", "tolerance"},
    "recipe": {"config", "products", "planning", "image", "tolerance"},
    "config": {"metrology", "image", "surface", "telescope", "tolerance"},  # a system file may name measured spectra
    "metrology": {"products", "surface", "pictures"},  # of products, the units on the way out
    "products": {"image", "surface", "telescope", "pictures", "tolerance"},  # products read back are drawn
    "planning": {"image", "surface", "telescope", "tolerance"},
    "image": {"surface", "telescope", "tolerance"},
    # of surfaces it takes what the system file says of them, and no function: DATA_OF_SURFACES
    "montecarlo": {"surface", "telescope"},
    "surface": {"tolerance"},
    "telescope": {"tolerance"},
    "pictures": set(),  # they draw what they are given
    "tolerance": set(),
}

# Where each library may be imported, the longest name that fits deciding; one that is not listed may be nowhere.
LIBRARIES = {
    "click": {"cli"},  # the rest is a library for Python, too
    "yaml": {"config"},
    "astropy.units": {"config", "products"},  # units change at the two doors
    "astropy.io": {"products"},
    "astropy.table": {"products"},
    "OpenEXR": {"products"},
    "threadpoolctl": {"prediction", "recipe"},
    "matplotlib": {"pictures"},
    "PIL": {"pictures"},
    "scipy": {"validation", "tradeoff", "metrology", "image", "surface"},
    "numpy": {
        "validation",
        "tradeoff",
        "metrology",
        "scattering",
        "products",
        "planning",
        "image",
        "montecarlo",
        "surface",
        "telescope",
        "pictures",
    },  # the system file is checked without arrays
}

# (importing module, imported name): the reason it is let through
EXCEPTIONS: dict[tuple[str, str], str] = {
    ("psfcli", "psfcli.config"): "the Python interface: psfcli.load, imported when asked for",
    ("psfcli", "psfcli.products"): "the Python interface: psfcli.OutputError, imported when asked for",
    ("psfcli", "psfcli.recipe"): "the Python interface: psfcli.plan, run, write, SceneError, imported when asked for",
    ("psfcli.__main__", "psfcli.cli"): "python -m psfcli",
    ("psfcli.recipe", "psfcli.surface.mixture"): "the error of a scatter that no mixture can hold, told to the user",
}

# What the rays may know of surfaces: dataclasses that hold the numbers of the system file.
DATA_OF_SURFACES = {"psfcli.surface.surface": {"Surface"}, "psfcli.surface.psd": {"KCorrelation"}}

MODULES = {
    ".".join(path.relative_to(ROOT.parent).with_suffix("").parts).removesuffix(".__init__"): path
    for path in sorted(ROOT.rglob("*.py"))
}


@cache
def tree(module: str) -> ast.Module:
    return ast.parse(MODULES[module].read_text(encoding="utf-8"))


@cache
def imported(module: str) -> frozenset[str]:
    """Every module named in an import statement in ``module``, those for a type checker or within a function too."""
    names = set()
    for node in ast.walk(tree(module)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}: imports are absolute"
            assert node.module
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                package = inner in MODULES or node.module in {"astropy", "scipy"}
                names.add(inner if package else node.module)
    return frozenset(names)


def part(module: str) -> str:
    """The part of the house a module belongs to; the empty string for the package itself."""
    return [*module.split("."), ""][1]


def library(name: str) -> str | None:
    """The entry of LIBRARIES that decides about ``name``."""
    fits = [listed for listed in LIBRARIES if name == listed or name.startswith(listed + ".")]
    return max(fits, key=len, default=None)


def test_every_module_lies_in_a_part_of_the_house():
    assert {part(module) for module in MODULES} - {"", "__main__"} == set(ORDER)


def test_the_table_itself_only_goes_down():
    assert set(MAY_IMPORT) == set(ORDER)
    for importer, others in MAY_IMPORT.items():
        assert others <= set(ORDER[ORDER.index(importer) + 1 :]), importer


@pytest.mark.parametrize("module", MODULES)
def test_imports_within_the_house_go_down_the_list(module):
    allowed = {part(module)} | MAY_IMPORT.get(part(module), set())
    ours = {name for name in imported(module) if name == "psfcli" or name.startswith("psfcli.")}
    wrong = sorted(name for name in ours if part(name) not in allowed and (module, name) not in EXCEPTIONS)
    assert not wrong, f"{module} must not import {', '.join(wrong)}"


@pytest.mark.parametrize("module", MODULES)
def test_each_library_is_imported_where_it_belongs(module):
    foreign = {name for name in imported(module) if name.split(".")[0] not in sys.stdlib_module_names | {"psfcli"}}
    wrong = [name for name in foreign if part(module) not in LIBRARIES.get(library(name) or "", set())]
    assert not [name for name in wrong if (module, name) not in EXCEPTIONS], f"{module} must not import {wrong}"


@pytest.mark.parametrize("module", [module for module in MODULES if part(module) == "montecarlo"])
def test_the_rays_share_no_calculation_with_what_they_judge(module):
    methods = {
        node.name for data in DATA_OF_SURFACES for node in ast.walk(tree(data)) if isinstance(node, ast.FunctionDef)
    }
    assert "band_share" in methods
    for node in ast.walk(tree(module)):
        if isinstance(node, ast.ImportFrom) and part(node.module) == "surface":
            assert {alias.name for alias in node.names} <= DATA_OF_SURFACES.get(node.module, set())
        if isinstance(node, ast.Attribute):
            assert node.attr not in methods


def test_no_imports_go_in_a_circle():
    # a package stands for its __init__; a module's own package is no dependency, or every package would be a circle
    graph = {
        module: {name for name in imported(module) if name in MODULES and not module.startswith(name + ".")}
        for module in MODULES
    }
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as circle:
        pytest.fail(" <- ".join(circle.args[1]))


def test_every_exception_is_needed():
    stale = [key for key in EXCEPTIONS if key[1] not in imported(key[0])]
    assert not stale


@pytest.mark.parametrize("module", MODULES)
def test_a_module_is_short(module):
    assert len(MODULES[module].read_text(encoding="utf-8").splitlines()) <= 300


@pytest.mark.parametrize("module", MODULES)
def test_everything_public_says_what_it_is(module):
    silent = [] if ast.get_docstring(tree(module)) or module.endswith("__main__") else [module]
    scopes: list[ast.Module | ast.ClassDef] = [tree(module)]
    while scopes:
        for node in scopes.pop().body:
            if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) or node.name.startswith("_"):
                continue
            if not ast.get_docstring(node):
                silent.append(node.name)
            if isinstance(node, ast.ClassDef):
                scopes.append(node)
    assert not silent, f"{module}: no docstring: {', '.join(silent)}"
