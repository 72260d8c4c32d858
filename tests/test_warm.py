import json
import subprocess
import sys

import pytest

from gpdf_service.cli import main


@pytest.mark.slow
def test_what_was_warmed_once_is_not_compiled_again(capsys):
    assert main(["warm", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["compiled"] >= 0
    words = [sys.executable, "-m", "gpdf_service.cli", "warm", "--json"]
    again = subprocess.run(words, capture_output=True, text=True, check=True, timeout=600)
    assert json.loads(again.stdout)["compiled"] == 0
    found = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, check=True, timeout=600)
    assert {"ends_in", "pairs_within", "pairs_over_gaps", "whole_around", "across_in", "grown_sheet"} <= set(
        found.stdout.split()
    )


LOADED = """
from gpdf_service.warm import Warming, kernels
Warming().plans()
assert len(list(kernels())) > 100
before = {one for one in kernels() if one.signatures}
Warming().heaps()
print(*(one.__name__ for one in kernels() if one.signatures and one not in before))
"""
"""What the heaps run that plans do not: none of it is compiled where somebody waits, or where memory is measured."""
