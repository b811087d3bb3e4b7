"""Recordings: data of a real array in place of simulated data."""
