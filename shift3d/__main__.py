"""Entry point of ``python -m shift3d``: the command line without an installed script."""

import sys

from shift3d.cli.main import main

sys.exit(main(sys.argv[1:]))
