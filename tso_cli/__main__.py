"""`python -m tso_cli`."""

from .cli import main

main()
