"""The door: `python run_cycles.py ...` is `kr210-sim run ...`."""

import sys

from kr210_sim.cli import main

if __name__ == "__main__":
    sys.exit(main(["run", *sys.argv[1:]]))
