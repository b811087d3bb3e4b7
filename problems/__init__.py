"""Problems: near-field source localization and test functions; installed as nfbench.problems."""
