"""The surface functions at the ends of their ranges: arguments drawn at random, and exact values by mpmath.

``exact``: the definitions, evaluated with as many digits as it takes; it imports nothing of psfcli. ``grid``: the
arguments, region by region, and the tables autocovariance.csv, transfer.csv and bsdf.csv with what was computed for
them. ``judge``: errors in units of the allowed ones. ``python scripts/extremes.py --tables`` makes the tables anew.
"""
