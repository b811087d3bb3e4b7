"""Makes ``python -m nfbench`` equivalent to the command ``nfbench``."""

from nfbench.cli import main

if __name__ == "__main__":
    main()
