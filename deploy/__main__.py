"""`python -m formation.deploy` is the `formation` command."""

import sys

from formation.deploy.cli import main

if __name__ == "__main__":
    sys.exit(main())
