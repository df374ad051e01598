"""`python -m deploy` is the `formation` command."""

import sys

from deploy.cli import main

if __name__ == "__main__":
    sys.exit(main())
