"""``python -m psfcli``."""

from psfcli.cli import main

main(prog_name="psfcli")
