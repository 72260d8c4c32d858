"""The numbers of the accuracy and speed pages: `make measure` runs the benchmarks and keeps what they print as JSON."""

from __future__ import annotations

import datetime
import json
import os
import platform
import subprocess
import sys
from pathlib import Path

FOLDER = Path(__file__).parent.parent / "measured"
COMMANDS = {
    "plan": "bench plan --count 100 --peers 0",
    "build": "bench build",
    "field": "bench field --surface plane --surface stairs --noise 0 --noise 0.02",
    "service": "bench service",
    "drive": "bench drive --runs 20",
    "guide": "bench guide --count 5",
}
"""Small enough for ten minutes on two cores; the same commands with larger counts say the same more exactly."""


def main(names: list[str]) -> None:
    """Run the benchmarks that are named, or all."""
    FOLDER.mkdir(exist_ok=True)
    for name in names or COMMANDS:
        words = [sys.executable, "-m", "gpdf_service.cli", *COMMANDS[name].split(), "--json"]
        print(f"gpdf {COMMANDS[name]}", file=sys.stderr)
        load = f"load average {os.getloadavg()[0]:.1f} before"
        done = subprocess.run(words, stdout=subprocess.PIPE, text=True, check=True)
        facts = {"command": f"gpdf {COMMANDS[name]}", "date": datetime.datetime.now(datetime.UTC).date().isoformat()}
        facts["machine"] = (
            f"{os.cpu_count()} cores, {platform.system()} {platform.machine()}, Python {platform.python_version()}"
        )
        facts["load"] = load  # times that were taken beside other work say so
        rows = json.loads(done.stdout)
        (FOLDER / f"{name}.json").write_text(json.dumps(facts | {"rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
