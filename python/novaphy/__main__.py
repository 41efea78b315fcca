"""``python -m novaphy`` runs the command `novaphy`."""

import sys

from ._command import main

if __name__ == "__main__":
    sys.exit(main())
