"""Optimizers: one algorithm or one wrapped library per file; the package is installed as nfbench.solvers."""
