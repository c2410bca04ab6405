"""`python -m factory` is `factory`."""

from factory.cli.main import main

main()
