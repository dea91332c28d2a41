"""`python -m kr210_sim`: the command, for those whose PATH does not have it."""

import sys

from kr210_sim.cli import main

if __name__ == "__main__":
    sys.exit(main())
