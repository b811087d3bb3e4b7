"""Optimizers, one algorithm or one wrapped library a file, installed as nfbench.solvers."""
