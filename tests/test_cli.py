"""What a user of the command line meets at its edges."""

import subprocess
import sys
from pathlib import Path

import pytest

import psfcli

PAPER = Path(__file__).parent.parent / "configs" / "euv_two_mirror.yaml"


def test_a_full_standard_output_is_one_line_and_exit_code_4():
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "psfcli", "schema"], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 4
    assert done.stderr == "standard output cannot be written: No space left on device\n"


def test_a_box_beyond_every_horizon_holds_all_light_and_spoils_nothing():
    far = psfcli.load(PAPER, ["ensquared_energy={half_widths: [30 um, 1 km]}"], ["0 deg"])
    result = psfcli.run(far)
    (reached,) = result.reached
    # what Gaussians do not hold of the clip's ripples lies far outside the window
    assert reached.pixel <= far.tolerance.pixel
    assert reached.ee <= far.tolerance.ee
    assert result.ensquared_energy["ee"][1] == pytest.approx(1.0, abs=far.tolerance.ee)
