"""Scenes of several sizes for the tests of the diagnosis, with sources well inside the box."""

from nfbench.problems.near_field.scenario import NearField


def ula(elements, spacing=0.25):
    return {"kind": "ula", "elements": elements, "spacing_wavelengths": spacing, "origin": "center"}


LARGE = {
    "array": ula(128),
    "wavelength_m": 0.02,
    "sources": 3,
    "snapshots": 200,
    "azimuth_deg": (-60, 60),
    "range_m": (1.27, 8.0),
    "min_separation_deg": 3.0,
}
PLANE = {
    "array": {"kind": "upa", "columns": 8, "rows": 8, "spacing_wavelengths": 0.5, "origin": "center"},
    "wavelength_m": 0.1,
    "sources": 2,
    "snapshots": 124,
    "azimuth_deg": (-60, 60),
    "elevation_deg": (-60, 60),
    "range_m": (0.4, 2.0),
    "min_separation_deg": 15.0,
}
SMALL = {
    "array": ula(16, 0.5),
    "wavelength_m": 0.1,
    "sources": 2,
    "snapshots": 60,
    "azimuth_deg": (-50, 50),
    "range_m": (0.4, 1.2),
    "min_separation_deg": 20.0,
}
SCENES = {
    "ULA of 128 elements, 20 dB": NearField(**LARGE, snr_db=20.0),
    "ULA of 128 elements, 0 dB": NearField(**LARGE, snr_db=0.0),
    "UPA of 8 × 8 elements": NearField(**PLANE, snr_db=10.0),
    "ULA of 16 elements": NearField(**SMALL, snr_db=15.0),
    "ULA of 128 elements, few snapshots": NearField(**{**LARGE, "snapshots": 50, "sources": 2}, snr_db=0.0),
}
