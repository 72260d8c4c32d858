"""When a kernel is compiled again, where it is kept, and what it takes from other files."""

import ast
import json
import os
import shutil
import subprocess
import sys
from importlib import import_module
from types import ModuleType

import pytest
from numba.core.dispatcher import Dispatcher

from gpdf_service.kernel_cache import PACKAGE, sources_of

KERNEL_FILES = sorted(path for path in PACKAGE.rglob("*.py") if "@njit" in path.read_text())
SMALL = {
    "__init__.py": "",
    "low/__init__.py": "import gpdf_service.kernel_cache\nfrom gpdf_service.low.inner import inner as passed_on\n",
    "low/inner.py": "from numba import njit\nfrom gpdf_service.low.numbers import (\n    TEN,  # of them\n)\n\n\n"
    "@njit(cache=True)\ndef inner(x):\n    return x + TEN\n",
    "low/numbers.py": "TEN = 10\n",
    "low/made.py": "from numba import njit\n\n\ndef make():\n    return _half() * 2\n\n\n"
    "def _half():\n    return 4\n\n\nMADE = make()\n\n\n@njit(cache=True)\ndef made(x):\n    return x + MADE\n\n\n"
    "def plain(\n    x,\n):\n    return made(x)\n",
    "low/apart.py": "from numba import njit\n\n\n@njit(cache=True)\ndef apart(x):\n    return x\n",
    "high.py": "from numba import njit\nfrom gpdf_service.low import passed_on as called\n\n\n"
    "@njit(cache=True)\ndef outer(x):\n    return 2 * called(x)\n",
}
"""A package of four kernels; what one of them calls is passed on by another file and takes a constant from a third."""
ASK = """
import json, sys
from gpdf_service.high import outer
from gpdf_service.low.apart import apart
from gpdf_service.low.made import made as self_made, plain
from gpdf_service.kernel_cache import forget_others
made = [outer(1), apart(7), plain(0)]
compiled = [sum(one.stats.cache_misses.values()) for one in (outer, apart, self_made)]
print(json.dumps([made, compiled, forget_others([outer, apart]) if sys.argv[1:] else 0, outer.stats.cache_path]))
"""
IN_TURN = """
import json, os, sys, time
from pathlib import Path
from gpdf_service.high import outer
from gpdf_service.kernel_cache import compile_in_turn
compile_in_turn(Path("turns"))
Path(sys.argv[1]).touch()
while not (Path("0").exists() and Path("1").exists()):
    time.sleep(0.001)
outer(1)
outer([1.0, 1][int(sys.argv[1])])
print(sum(outer.stats.cache_misses.values()))
"""
LINKAGE = """
import json
from gpdf_service.high import outer
made = [outer(10)]
(kept,) = outer.overloads.values()
called = (one for one in kept.library._final_module.functions if "inner" in one.name and not one.is_declaration)
print(json.dumps([made, sorted({one.linkage.name for one in called})]))
"""
FORKS = """
import json, os, sys
from numba import config, njit
njit(lambda x: x + 1)(1)  # to load Numba and to compile for the first time is most of what asking takes
for line in sys.stdin:
    asked, folder, words, environment = json.loads(line)
    if (child := os.fork()) == 0:
        os.chdir(folder)
        os.environ.update(environment)
        config.reload_config()
        sys.path.insert(0, folder)
        sys.argv = ["", *words]
        exec(asked, {"__name__": "__main__"})
        sys.stdout.flush()
        os._exit(0)
    if os.waitpid(child, 0)[1]:
        sys.exit(1)
"""
"""Asks in a process of its own each time, with Numba in it and nothing of the package."""


@pytest.fixture(scope="module")
def forks():
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("NUMBA_", "XDG_"))}
    kept["PYTHONDONTWRITEBYTECODE"] = "1"  # Python's own takes an edit of one length in one second for none
    kept.pop("PYTHONPATH", None)
    words, pipe = [sys.executable, "-c", FORKS], subprocess.PIPE
    with subprocess.Popen(words, env=kept, stdin=pipe, stdout=pipe, text=True) as process:
        yield process
        process.stdin.close()
        assert process.wait(60) == 0


@pytest.fixture
def small(tmp_path):
    """The folder of the small package, with the real `kernel_cache`."""
    for name, text in SMALL.items():
        file = tmp_path / "gpdf_service" / name
        file.parent.mkdir(exist_ok=True)
        file.write_text(text)
    shutil.copy(PACKAGE / "kernel_cache.py", tmp_path / "gpdf_service")
    return tmp_path / "gpdf_service"


@pytest.fixture
def ask(small, forks):
    """What the small package's kernels give, how often they were compiled, how many files went, and where they are."""

    def ask(*words, **environment):
        said = [ASK, str(small.parent), words, {"HOME": str(small.parent)} | environment]
        forks.stdin.write(json.dumps(said) + "\n")
        forks.stdin.flush()
        return json.loads(forks.stdout.readline())

    return ask


def edit(file, before, after):
    text = file.read_text()
    assert text.count(before) == 1
    file.write_text(text.replace(before, after))


def test_a_kernel_is_compiled_again_when_a_type_that_it_was_called_with_is_gone_or_what_is_kept_is_damaged(small, ask):
    file = small / "low/apart.py"
    file.write_text(
        "from typing import NamedTuple\n\nfrom numba import njit\n\n\nclass Was(NamedTuple):\n    x: int\n\n\n"
        "@njit(cache=True)\ndef kernel(pair):\n    return pair.x\n\n\n"
        "class apart:\n    stats = kernel.stats\n\n    def __new__(cls, x):\n        return kernel(Was(x))\n"
    )

    def asked():
        made, compiled = ask()[:2]
        return made[1], compiled[1]

    assert asked() == (7, 1)
    file.write_text(file.read_text().replace("Was", "Now"))
    assert asked() == (7, 1)
    (index,) = (small / "low/__pycache__").glob("apart.kernel*.nbi")
    index.write_bytes(index.read_bytes()[:-9])
    assert asked() == (7, 1)
    assert asked() == (7, 0)


def test_a_kernel_is_compiled_again_when_what_it_calls_in_another_file_has_changed_and_no_other_is(small, ask):
    assert ask() == [[22, 7, 8], [1, 1, 1], 0, str(small / "__pycache__")]
    edit(small / "low/inner.py", "x + TEN", "x - TEN")
    assert ask()[:2] == [[-18, 7, 8], [1, 0, 0]]
    edit(small / "low/numbers.py", "10", "20")
    assert ask()[:2] == [[-38, 7, 8], [1, 0, 0]]
    edit(small / "low/apart.py", "return x", "return -x")
    assert ask()[:2] == [[-38, -7, 8], [0, 1, 0]]


def test_a_change_of_what_no_kernel_can_call_compiles_nothing_and_of_what_makes_a_constant_it_does(small, ask):
    ask()
    edit(small / "low/made.py", "return made(x)", "return -made(x)")
    assert ask()[:2] == [[22, 7, -8], [0, 0, 0]]
    edit(small / "low/made.py", "return 4", "return 5")
    assert ask()[:2] == [[22, 7, -10], [0, 0, 1]]


def test_a_kernel_is_compiled_for_numbers_and_not_for_each_that_stands_in_a_call(small, ask):
    (small / "low/apart.py").write_text(
        "from numba import njit\n\n\n@njit(cache=True)\ndef added(x, y):\n    return x + y\n\n\n"
        "@njit(cache=True)\ndef total(count):\n    made = 0\n    for _ in range(count):\n"
        "        made = added(made, 1)\n    return made\n\n\n"
        "class apart:\n    stats = added.stats\n\n    def __new__(cls, x):\n        return total(x)\n"
    )
    made, compiled = ask()[:2]
    assert (made[1], compiled[1]) == (7, 1)


def test_a_kept_kernel_is_read_for_llvm_only_where_another_one_is_compiled_with_it(small, ask):
    ask()
    edit(small / "high.py", "2 * called", "3 * called")
    assert ask()[:2] == [[33, 7, 8], [1, 0, 0]]
    never = "def _never(source):\n    raise AssertionError\n\n\nll.parse_bitcode = _never\n"
    (small / "__init__.py").write_text(f"from gpdf_service.kernel_cache import ll\n\n\n{never}")
    assert ask()[:2] == [[33, 7, 8], [0, 0, 0]]


def test_a_kernel_has_what_it_calls_for_itself_alone(small, forks):
    """Else a process that compiles it may run another kernel's, and one that loads what is kept its own."""
    twice = "    return x if x < 2 else inner(x - 1) + inner(x - 2)"  # no compiler puts all of that into its caller
    edit(small / "low/inner.py", "    return x + TEN", twice)
    forks.stdin.write(json.dumps([LINKAGE, str(small.parent), [], {"HOME": str(small.parent)}]) + "\n")
    forks.stdin.flush()
    assert json.loads(forks.stdout.readline()) == [[110], ["internal"]]


@pytest.mark.parametrize("told", [True, False])
def test_kernels_are_kept_where_numba_is_told_or_for_the_user_where_the_package_cannot_be_written_to(small, ask, told):
    if not told:
        for folder in (small, small / "low"):
            (folder / "__pycache__").write_text("no folder can be made here")
    words, place = ({"NUMBA_CACHE_DIR": f"{small.parent}/told"}, "told") if told else ({}, ".cache")
    assert ask(**words)[3].startswith(f"{small.parent}/{place}/")
    edit(small / "low/inner.py", "x + TEN", "x - TEN")
    assert ask(**words)[:2] == [[-18, 7, 8], [1, 0, 0]]


def test_what_is_kept_of_a_function_that_is_gone_is_deleted_and_nothing_else_is(small, ask):
    ask()
    old = [small / "__pycache__" / f"high.gone-{line}.py311.{end}" for line, end in ((3, "nbi"), ("kernel", "1.nbc"))]
    others = [small / "__pycache__" / name for name in ("other.outer-3.py311.nbi", "high.gone-3.txt")]
    for file in old + others:
        file.touch()
    assert ask("forget")[1:3] == [[0, 0, 0], 2]
    assert [file.exists() for file in old + others] == [False, False, True, True]


def test_of_processes_that_compile_at_once_one_compiles_a_kernel_and_all_that_they_compile_is_kept(small):
    (small.parent / "turns").mkdir()
    given = {"cwd": small.parent, "env": os.environ | {"PYTHONPATH": str(small.parent)}, "text": True}
    words = [sys.executable, "-c", IN_TURN]
    both = [subprocess.Popen([*words, name], stdout=subprocess.PIPE, **given) for name in "01"]
    assert sum(int(one.communicate(timeout=60)[0]) for one in both) == 2  # one for each type
    assert subprocess.run([*words, "0"], stdout=subprocess.PIPE, check=True, **given).stdout == "0\n"


@pytest.mark.parametrize("path", KERNEL_FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_what_a_kernel_takes_from_another_file_is_in_its_stamp(path):
    module = import_module(".".join(("gpdf_service", *path.relative_to(PACKAGE).with_suffix("").parts)))
    tree, taken = ast.parse(path.read_text()), set(map(str, sources_of(path)))
    imported = {
        alias.asname or alias.name: node.module
        for node in tree.body
        if isinstance(node, ast.ImportFrom) and node.module.startswith("gpdf_service")
        for alias in node.names
    }
    for name in imported.keys() & set(names_in_kernels(tree)):
        value = getattr(module, name)
        assert not isinstance(value, ModuleType), f"{name}: what a kernel takes from a module is not seen"
        if isinstance(value, Dispatcher):
            assert value.py_func.__code__.co_filename in taken, name
        else:
            made = getattr(value, "__module__", "")
            assert sys.modules[made if made.startswith("gpdf_service") else imported[name]].__file__ in taken, name


def names_in_kernels(tree):
    """Every name in the decorators and bodies of compiled functions; what annotations say is for the reader."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef) and any("njit" in ast.unparse(one) for one in node.decorator_list):
            inner = [one for part in (*node.decorator_list, *node.body) for one in ast.walk(part)]
            said = {id(word) for one in inner if isinstance(one, ast.AnnAssign) for word in ast.walk(one.annotation)}
            yield from (one.id for one in inner if isinstance(one, ast.Name) and id(one) not in said)


@pytest.mark.parametrize("path", KERNEL_FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_numba_is_set_up_before_the_kernels_and_they_are_told_apart_by_name(path):
    text = path.read_text()
    modules = [line for line in text.splitlines() if line.startswith("import gpdf_service")]
    before = (path.parent / "__init__.py").read_text()
    assert "\nimport gpdf_service.kernel_cache " in before or sources_of(path) == {path}
    assert not modules, "a kernel could reach all of a module that is imported as one"
    names = [node.name for node in ast.parse(text).body if isinstance(node, ast.FunctionDef)]
    assert len(names) == len(set(names))


def lean_functions():
    """Each function that is compiled by `lean`: its file, its name and what it says that it gives back."""
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef) and any(
                ast.unparse(d).startswith("lean(") for d in node.decorator_list
            ):
                yield path.name, node.name, ast.unparse(node.returns) if node.returns else ""


def test_no_lean_kernel_gives_an_array_back():
    """It counts no references: who counts them frees an array that another one holds."""
    found = list(lean_functions())
    assert len(found) > 50
    assert not [kernel for kernel in found if "Array" in kernel[2] or not kernel[2]]
