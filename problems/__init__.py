"""Near-field source localization problems, installed as nfbench.problems."""
