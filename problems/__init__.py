"""Problems: near-field source localization and test functions; the package is installed as nfbench.problems."""
