"""`python -m gpdf_service.cli` is `gpdf`."""

import sys

from gpdf_service.cli import main

sys.exit(main())
