"""Where compiled kernels are kept, and when they are compiled again.

Numba keeps a kernel as long as its own file is as it was. What a kernel calls is compiled into it, though, and may come
from another file. So here a kernel's stamp is made of all files that it can call, or takes a constant from: after a
change, what depends on it is compiled again, and nothing else.

Importing this sets Numba up; the packages that hold kernels do so before anything else.
"""

from __future__ import annotations

import hashlib
import re
import sys
from collections.abc import Callable, Iterable, Iterator
from fcntl import LOCK_EX, flock
from functools import cache
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, TypeVar

from numba import config, njit, types
from numba.core import caching
from numba.core.caching import InTreeCacheLocator, UserProvidedCacheLocator, UserWideCacheLocator
from numba.core.codegen import JITCodeLibrary, ll  # type: ignore[attr-defined]
from numba.core.compiler import CompileResult
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher

F = TypeVar("F", bound=Callable[..., Any])
PACKAGE = Path(__file__).resolve().parent
NAME = "kernel"
"""Stands in the names of kept files where Numba writes a line: a kernel that moves overwrites what it was."""
_IMPORTS = re.compile(r"^from (gpdf_service[\w.]*) import (\([^)]*\)|[^(\n]+)$", re.MULTILINE)
_PLAIN = re.compile(r"(?<=\n\n\n)def (\w+)\(.*\n(?:(?:[ \t)].*)?\n)*?(?=\S|\Z)(?!\))")
"""A function that nothing decorates, which no kernel can call."""
_COMPILED = re.compile(r"^@(?:njit|lean)\b.*\ndef \w+\(.*\n(?:(?:[ \t)].*)?\n)*?(?=\S|\Z)(?!\))", re.MULTILINE)
_KERNEL = re.compile(r"@(njit|lean)\b")
_WORD = re.compile(r"\w+")


def lean(**options: object) -> Callable[[F], F]:
    """`njit` for a loop that makes no array and gives none back: it counts no references to those that it is given.

    Numba counts each array of a tuple wherever the tuple is taken apart or handed on. Of a field's answer, which is
    handed down five calls with nineteen arrays, that was four fifths of the time; and planning threads wait for each
    other's counters. One that makes an array all the same does not compile.

    Args:
        options: More of `njit`'s.
    """
    compiled: Callable[[F], F] = njit(cache=True, nogil=True, _nrt=False, **options)  # type: ignore[call-overload]
    return compiled


@cache
def _is_ours(file: str) -> bool:
    return PACKAGE in Path(file).resolve().parents


class _Ours:
    """A place for the kernels of this package, and of no other."""

    _py_file: str

    @classmethod
    def from_function(cls, py_func: Callable[..., object], py_file: str) -> object:
        """Such a place, or none where nothing can be written or the function is somebody else's."""
        return super().from_function(py_func, py_file) if _is_ours(py_file) else None  # type: ignore[misc]

    def get_source_stamp(self) -> str:
        """What the kernel was compiled from."""
        return stamp_of(self._py_file)

    def get_disambiguator(self) -> str:
        """Names are unique within a file."""
        return NAME


class Provided(_Ours, UserProvidedCacheLocator):  # type: ignore[misc]  # Numba has no types
    """In NUMBA_CACHE_DIR, if that is set."""


class InTree(_Ours, InTreeCacheLocator):  # type: ignore[misc]
    """Beside the file of the kernel, if that folder can be written to."""


class UserWide(_Ours, UserWideCacheLocator):  # type: ignore[misc]
    """In the user's folder for such things."""


OTHERS = "UserProvidedCacheLocator,InTreeCacheLocator,UserWideCacheLocator,IPythonCacheLocator,ZipCacheLocator"
"""Numba's own, for the kernels of others."""
_PLACES = [f"{__name__}.{place.__name__}" for place in (Provided, InTree, UserWide)]
config.CACHE_LOCATOR_CLASSES = ",".join([*_PLACES, getattr(config, "CACHE_LOCATOR_CLASSES", "") or OTHERS])  # type: ignore[attr-defined]


class Index(caching.IndexDataCacheFile):  # type: ignore[misc]
    """What is kept of one kernel; nothing where that cannot be read: a type that it was called with is gone since."""

    def _load_index(self) -> dict[object, str]:
        try:
            kept: dict[object, str] = super()._load_index()  # type: ignore[no-untyped-call]
        except (AttributeError, ImportError, EOFError, UnpicklingError):
            return {}
        return kept


caching.IndexDataCacheFile = Index  # type: ignore[misc]

_kept_of: Any = CompileResult._reduce
_load_whole: Any = JITCodeLibrary._unserialize.__func__  # type: ignore[attr-defined]
_module_of: Any = JITCodeLibrary._get_module_for_linking


def _keep(own: Any) -> tuple[object, ...]:  # noqa: ANN401
    """What is kept of a compiled kernel: of ours also what it defines."""
    (name, kind, parts), *rest = _kept_of(own)
    if own.fndesc.modname.partition(".")[0] == PACKAGE.name:
        module, closed = own.library._get_module_for_linking(), ll.Linkage.internal
        shown = [one for one in (*module.functions, *module.global_variables) if one.linkage is not closed]
        parts = *parts, [one.name for one in shown if not one.is_declaration]
    return (name, kind, parts), *rest


def _load(cls: Any, codegen: Any, state: tuple[str, str, tuple[Any, ...]]) -> object:  # noqa: ANN401
    """A kept kernel, ready to be called.

    Numba reads its source for LLVM, too, which is asked for where another kernel is compiled with it, and takes from it
    what the kernel defines: four fifths of the time. What is kept without that is loaded as Numba does.
    """
    name, _, parts = state
    if len(parts) != 3:
        return _load_whole(cls, codegen, state)
    code, source, defined = parts
    own = codegen.create_library(name)
    own.enable_object_caching()
    own._set_compiled_object(code)
    own._finalize_final_module()
    own._codegen._engine._defined_symbols.update(defined)
    own._source = source
    return own


def _linked(own: Any) -> object:  # noqa: ANN401
    """The module of a kernel for another one that is compiled with it; read where that is first asked for."""
    if (source := vars(own).pop("_source", None)) is not None:
        own._shared_module = ll.parse_bitcode(source)
    return _module_of(own)


_optimized: Any = JITCodeLibrary._optimize_final_module


def _closed(own: Any) -> None:  # noqa: ANN401
    """Optimise a kernel with what it calls as its own.

    Else of all kernels that call one the first that is loaded lends it to the others. Where sums may be taken in any
    order, each has it with other roundings: so a process that compiles had others than those that load what it kept.
    """
    for one in own._final_module.functions:
        if not one.is_declaration and one.linkage is ll.Linkage.linkonce_odr:
            one.linkage = "internal"
    _optimized(own)


JITCodeLibrary._optimize_final_module = _closed  # type: ignore[method-assign]
CompileResult._reduce = _keep  # type: ignore[method-assign]
JITCodeLibrary._unserialize = classmethod(_load)  # type: ignore[method-assign, assignment]
JITCodeLibrary._get_module_for_linking = _linked  # type: ignore[method-assign]

_template_of_call: Any = Dispatcher.get_call_template


def _for_all_numbers(own: Any, args: Iterable[object], kws: dict[str, object]) -> Any:  # noqa: ANN401
    """What a kernel calls is compiled for numbers, and not once more for each number that stands in a call.

    Of `count = 0; count = add(count)` in a loop Numba compiles `add` for a zero at first, and drops it in the end.
    """
    of: Any = types.unliteral if _is_ours(own.py_func.__code__.co_filename) else lambda kind: kind
    return _template_of_call(own, tuple(map(of, args)), {name: of(kind) for name, kind in kws.items()})


Dispatcher.get_call_template = _for_all_numbers  # type: ignore[assignment, method-assign]


@cache
def stamp_of(file: str) -> str:
    """A hash of a file and of all that its kernels can call, and of how they are compiled."""
    digest = hashlib.sha256(_text(Path(__file__)).encode())
    for source in sorted(sources_of(Path(file).resolve())):
        digest.update(_named(source))
    return digest.hexdigest()


def sources_of(file: Path) -> set[Path]:
    """The files that the kernels of a file can call or take a constant from, itself among them."""
    found, left = set[Path](), [file]
    while left:
        if (source := left.pop()) not in found:
            found.add(source)
            left += _taken_from(source)
    return found


@cache
def _text(file: Path) -> str:
    return file.read_text()


@cache
def _named(file: Path) -> bytes:
    return hashlib.sha256(f"{file.relative_to(PACKAGE)}\n{_compiled(_text(file))}".encode()).digest()


def _compiled(text: str) -> str:
    """A file without its plain functions, but for those that the rest names: they may make a constant of a kernel."""
    kept, named = "", _PLAIN.sub("", text)
    while named != kept:
        kept, words = named, set(_WORD.findall(named))
        named = _PLAIN.sub(lambda one: one[0] if one[1] in words else "", text)  # noqa: B023
    return kept


@cache
def _imports(file: Path) -> list[tuple[str, str, str]]:
    """Module, name there and name here of what a file imports from this package while it is loaded."""
    found = []
    for module, names in _IMPORTS.findall(_text(file)):
        for name in re.sub(r"#.*|[()]", "", names).split(","):
            if words := name.split():
                found.append((module, words[0], words[-1]))
    return found


@cache
def _taken_from(file: Path) -> frozenset[Path]:
    origins = ((name, _origin(module, name)) for module, name, _ in _imports(file))
    return frozenset(source for name, source in origins if name.isupper() or _KERNEL.search(_text(source)))


def _origin(module: str, name: str) -> Path:
    """The file that a name comes from, through packages that pass it on."""
    folder = PACKAGE.parent.joinpath(*module.split("."))
    if (inner := folder / f"{name}.py").is_file():
        return inner
    if (file := folder.with_suffix(".py")).is_file():
        return file
    passed = [(at, was) for at, was, now in _imports(folder / "__init__.py") if now == name]
    return _origin(*passed[0]) if passed else folder / "__init__.py"


def kernels(package: str = "gpdf_service") -> Iterator[Dispatcher]:
    """Every compiled function of the modules of a package that are loaded."""
    for name in [name for name in sys.modules if f"{name}.".startswith(f"{package}.")]:
        module = sys.modules[name]
        for value in list(vars(module).values()):
            if isinstance(value, Dispatcher) and value.py_func.__module__ == name:
                yield value


@cache
def load_kept(*packages: str) -> None:
    """Load what is kept of the kernels that these packages call from Python, so that no first call waits for that."""
    called = set[str]()
    for file in (file for package in packages for file in (PACKAGE / package).glob("*.py")):
        called |= set(_WORD.findall(_IMPORTS.sub("", _COMPILED.sub("", _text(file)))))
    own: Any  # Numba has no types, nor a word for this
    for own in (kernel for package in packages for kernel in kernels(f"{PACKAGE.name}.{package}")):
        kept = own._cache
        if own.py_func.__name__ not in called or isinstance(kept, caching.NullCache):
            continue
        for key in kept._cache_file._load_index():
            if key == kept._index_key(key[0], own.targetctx.codegen()):
                own.compile(key[0])


def compile_in_turn(folder: Path) -> None:
    """Of all processes that call this with the same `folder`, one at a time compiles a kernel; others load it then.

    Without it each would compile what all need, and of two that keep a kernel at once, for arrays of two types, one
    would be lost. Whoever compiles a kernel waits for those that it calls, and these never for it.
    """
    alone: Any  # Numba's types are of what calls it, not of what stands in for it
    alone, held = Dispatcher.compile, set[Path]()

    def in_turn(own: Any, signature: object) -> object:  # noqa: ANN401
        file = folder / f"{own.py_func.__module__}.{own.py_func.__qualname__}"
        with global_compiler_lock:  # first, or a thread that has it waits for the file of one that waits for it
            if file in held or isinstance(own._cache, caching.NullCache):
                return alone(own, signature)
            with file.open("w") as turn:
                flock(turn, LOCK_EX)
                held.add(file)
                try:
                    return alone(own, signature)
                finally:
                    held.remove(file)

    Dispatcher.compile = in_turn  # type: ignore[assignment, method-assign]


def forget_others(kernels: Iterable[Dispatcher]) -> int:
    """Delete what is kept of the files of these kernels for functions that they hold no more; gives how many files."""
    kept: dict[Path, set[str]] = {}
    for kernel in kernels:
        name = kernel.py_func.__qualname__.replace("<", "").replace(">", "")  # as Numba writes it
        stem = f"{Path(kernel.py_func.__code__.co_filename).stem}.{name}-{NAME}"
        kept.setdefault(Path(str(kernel.stats.cache_path)), set()).add(stem)
    old = [
        file
        for folder, stems in kept.items()
        for file in folder.glob("*.nb[ic]")
        if file.name.partition(".")[0] in {stem.partition(".")[0] for stem in stems}
        and file.name.partition(".py3")[0] not in stems
    ]
    for file in old:
        file.unlink(missing_ok=True)
    return len(old)
