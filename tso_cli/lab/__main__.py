"""`python -m tso_cli.lab`."""

import sys

from ..cli import main

main(["lab", *sys.argv[1:]])
