"""How the shipped checkpoint was made: `python -m train --help`."""
