"""Lets ``python -m ronnaplan`` do what the ``ronnaplan`` command does."""

import sys

from ronnaplan.cli import main

if __name__ == "__main__":
    sys.exit(main())
