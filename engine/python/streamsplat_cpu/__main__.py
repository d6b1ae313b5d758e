"""The `streamsplat` program: python -m streamsplat_cpu."""

import sys

from ._streamsplat import main as _main


def main() -> None:
    """Runs the program with the process's arguments."""
    sys.exit(_main(["streamsplat", *sys.argv[1:]]))


if __name__ == "__main__":
    main()
