"""``python -m shift3d``: the command line, where no script is installed."""

import sys

from shift3d.cli.main import main

sys.exit(main(sys.argv[1:]))
