"""Radar band letters and a usual frequency of each."""

from collections.abc import Mapping

# Hz, within IEEE Std 521: ALOS-2, NISAR's S band, Sentinel-1, TerraSAR-X, airborne Ku and Ka radars
BANDS: Mapping[str, float] = {
    "L": 1.2575e9,
    "S": 3.2e9,
    "C": 5.405e9,
    "X": 9.65e9,
    "Ku": 16.7e9,
    "Ka": 35.0e9,
}
