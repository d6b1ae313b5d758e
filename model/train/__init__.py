"""Training of the shipped checkpoint: `python -m train --help`."""
