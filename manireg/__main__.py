"""`python -m manireg`, the same as the command `manireg`."""

from ._cli.app import main

main()
