"""What accuracy costs, measured: psfcli against what one would do otherwise, on one image of a scene."""
