"""`python -m infrablend`: the command line."""

import sys

from infrablend.cli import main

if __name__ == "__main__":
    sys.exit(main())
