"""`python -m truewrench`: the command line, as the console script runs it."""

from __future__ import annotations

import sys

from truewrench.command_line import main

if __name__ == "__main__":
    sys.exit(main())
