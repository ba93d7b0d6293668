"""make paper: every claim is told, what does not hold is not hidden, and the pieces it is made of are right."""

import math
import runpy
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import psfcli
from psfcli.montecarlo.cells import CellGrid, cell_counts
from psfcli.montecarlo.estimate import batch_size, chance
from psfcli.montecarlo.third_order import ThirdOrderRays
from psfcli.planning.geometry import mean_incidence
from psfcli.telescope.paraxial import trace
from psfcli.validation.cells import CellComparison, compare_cells

ROOT = Path(__file__).resolve().parent.parent
SCRIPT = ROOT / "scripts" / "paper.py"
CONFIGS = ROOT / "configs"
NEED_RAYS = ("exact rays",)


@pytest.fixture(scope="module")
def paper():
    return runpy.run_path(str(SCRIPT))


@pytest.fixture(scope="module")
def small():
    sizes = ["detector.pixels=4", "detector.oversample=5"]
    system = psfcli.load(CONFIGS / "euv_two_mirror.yaml", overrides=sizes, fields=["0.5 deg"])
    return system, np.asarray(psfcli.run(system).psf_over[0, 0])


def test_the_paper_is_made_anew(tmp_path):
    ran = subprocess.run(
        [sys.executable, SCRIPT, "--quick", "--jobs", "1", tmp_path / "made"], capture_output=True, text=True
    )
    assert ran.returncode == 0, ran.stderr
    page = (tmp_path / "made" / "summary.md").read_text(encoding="utf-8")
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in page.splitlines() if line.startswith("| ")][1:]
    for where, claim, figure, holds, _ in rows:
        assert " ".join(figure.split()) in ran.stdout
        open_ = claim.startswith("W311") or any(name in claim for name in NEED_RAYS)
        assert holds == ("open" if open_ else "yes"), (where, claim, figure)
    assert {row[0] for row in rows} == {"Table 1", "Sec. 4", *(f"Fig. {n}" for n in range(6, 11))}
    made = {path.name for path in (tmp_path / "made").iterdir()}
    assert {"table1.csv", *(f"fig{n}.png" for n in range(6, 11))} <= made
    assert all(f"]({name})" in page for name in made - {"summary.md"})


def test_a_claim_that_does_not_hold_is_told_and_ends_with_1(paper, capsys):
    Claim, Part, report = paper["Claim"], paper["Part"], paper["report"]
    true, unknown, wrong = (Claim("Fig. 0", f"it is {h}", "1.0", h, "nothing") for h in (True, None, False))
    assert report([Part("", (true, unknown), {})]) == 0
    assert "NO" not in capsys.readouterr().out
    assert report([Part("", (true,), {}), Part("", (unknown, wrong), {})]) == 1
    assert "it is False" in (line := capsys.readouterr().out.splitlines()[-1])
    assert " NO " in line


def test_another_table_1_does_not_hold(paper, monkeypatch):
    table = paper["table_1"]
    monkeypatch.setitem(paper["TABLE_1"], "W131", -7.61)
    assert [claim.claim for claim in table().claims if claim.holds is False] == ["W131 = -7.61 waves"]


# -- rays in cells


def test_rays_are_counted_in_their_cells(small):
    system, _ = small
    rays = ThirdOrderRays(system.telescope, system.surfaces, system.wavelengths[0], system.fields[0])
    grids = [CellGrid(-0.042, -0.03, 0.0021, 40), CellGrid(0.0, -0.01, 0.005, 3)]
    traced, counts = cell_counts(rays, grids, 100_000, seed=(3,))
    landed = [np.hstack(list(rays.landings(chance((3,), n), batch_size(100_000)))) for n in range(128)]
    x, y = np.hstack(landed)
    assert traced == x.size >= 100_000
    for grid, counted in zip(grids, counts, strict=True):
        edges = np.arange(grid.number + 1) * grid.width
        expected, *_ = np.histogram2d(y, x, [grid.y_start + edges, grid.x_start + edges])
        assert np.array_equal(counted, expected)
    _, by_two = cell_counts(rays, grids, 100_000, seed=(3,), jobs=2)
    assert all(np.array_equal(a, b) for a, b in zip(counts, by_two, strict=True))


def test_the_image_stands_up_to_rays_in_cells_and_a_wrong_one_does_not(small):
    system, image = small
    (found,) = compare_cells([system], [image], 1_000_000)
    assert found.cells == image.size
    assert found.explained
    assert 0.7 < found.chi_squared / found.cells < 1.2
    assert not replace(found, convolution=np.roll(image, 1, axis=0)).explained
    # 3 % of 0.64 of the light: sum N p 0.03^2 = 580 more, 20 standard deviations of chi^2
    assert not replace(found, convolution=1.03 * image).explained
    (upside_down,) = compare_cells([system], [image[::-1]], 1_000_000)
    assert not upside_down.explained


def test_cells_with_few_rays_are_not_judged():
    found = CellComparison(np.array([[0.5, 1e-6]]), np.array([[0.5, 3e-6]]), 1_000_000)
    assert (found.cells, found.chi_squared, found.rms_difference) == (1, 0.0, 0.0)


# -- incidence


@pytest.mark.parametrize(("fields", "relative"), [(["0 deg"], [0.0]), (["0 deg", "0.5 deg"], [0.0, 1.0])])
def test_the_mean_incidence_is_that_of_rays_all_over_the_pupil(fields, relative):
    system = psfcli.load(CONFIGS / "euv_prescription.yaml", fields=fields)
    rng = np.random.default_rng(1)
    r = 95.0 * np.sqrt(rng.uniform(0.48**2, 1.0, 400_000))
    angle = rng.uniform(0.0, 2.0 * math.pi, r.size)
    H = math.tan(math.radians(0.5)) * np.array(relative)[:, None]
    # a mirror turns a ray by twice the incidence: to the primary's focus, from there to the system's
    f1, f = 0.5 * 1466.0206, 1750.0
    chief = {"primary": 1.0, "secondary": 1.0 + 463.0318 / 929.1389}  # the secondary's normal leans, too
    of_marginal = {"primary": 0.5 / f1, "secondary": 0.5 / f1 + 0.5 / f}
    rays = trace(system.prescription, system.telescope.max_field)
    for name in chief:
        i_x = of_marginal[name] * r * np.sin(angle)
        i_y = of_marginal[name] * r * np.cos(angle) + chief[name] * H
        expected = math.sqrt(np.mean(i_x**2 + i_y**2))
        found = mean_incidence(rays, name, system.telescope, system.fields)
        assert found == pytest.approx(expected, rel=1e-3)
