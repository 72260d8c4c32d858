import dataclasses
import pickle
from errno import ENOSPC

import numpy as np
import pytest

from gpdf_service.errors import SceneFileError
from gpdf_service.store import flatten, read_arrays, restore, write_arrays


@dataclasses.dataclass(frozen=True)
class Inner:
    values: np.ndarray
    width: float
    count: int


@dataclasses.dataclass(frozen=True)
class Outer:
    parts: tuple[Inner, ...]
    flags: np.ndarray


def example():
    return Outer((Inner(np.arange(3.0), 0.5, 7), Inner(np.zeros((0, 2)), 1.5, 0)), np.array([True, False]))


def test_nested_dataclasses_come_back_equal(tmp_path):
    write_arrays(tmp_path / "a.gpdf", flatten(example(), "x"), {"version": 3})
    arrays, meta, _ = read_arrays(tmp_path / "a.gpdf")
    back = restore(Outer, arrays, "x")
    assert meta["version"] == 3
    assert len(back.parts) == 2
    np.testing.assert_array_equal(back.parts[0].values, [0, 1, 2])
    assert back.parts[1].values.shape == (0, 2)
    assert (back.parts[0].width, back.parts[0].count) == (0.5, 7)
    np.testing.assert_array_equal(back.flags, [True, False])


def test_an_empty_tuple_comes_back_empty():
    assert restore(Outer, flatten(Outer((), np.zeros(1)), "x"), "x").parts == ()


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(SceneFileError, match="there is no such file"):
        read_arrays(tmp_path / "none.gpdf")


@pytest.mark.parametrize("damage", ["cut", "flip", "empty", "text"])
def test_a_damaged_file_is_refused(tmp_path, damage):
    path = tmp_path / "a.gpdf"
    write_arrays(path, {"points": np.random.default_rng(0).normal(size=3000)}, {"version": 1})
    raw = bytearray(path.read_bytes())
    if damage == "flip":
        raw[len(raw) // 2] ^= 0xFF
    path.write_bytes({"cut": bytes(raw[: len(raw) // 2]), "flip": bytes(raw), "empty": b"", "text": b"hello"}[damage])
    with pytest.raises(SceneFileError, match="damaged"):
        read_arrays(path)


def test_a_file_of_another_schema_version_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("gpdf_service.store.SCHEMA_VERSION", 999)
    write_arrays(tmp_path / "a.gpdf", {}, {})
    monkeypatch.undo()
    with pytest.raises(SceneFileError, match="schema version 999"):
        read_arrays(tmp_path / "a.gpdf")


def test_a_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "a.gpdf"
    write_arrays(path, {"a": np.ones(2)}, {})
    with pytest.raises(ValueError, match="object"):
        write_arrays(path, {"a": np.array([object()])}, {})

    def full(handle):
        raise OSError(ENOSPC, "no space")

    monkeypatch.setattr("gpdf_service.store.os.fsync", full)
    with pytest.raises(OSError, match="no space"):
        write_arrays(path, {"a": np.zeros(2)}, {})
    assert read_arrays(path)[0]["a"].tolist() == [1, 1]
    assert [p.name for p in tmp_path.iterdir()] == ["a.gpdf"]


def test_what_is_read_later_is_checked_at_once_and_outlives_the_file(tmp_path):
    path = tmp_path / "a.gpdf"
    write_arrays(path, {"now": np.ones(2), "then/a": np.arange(5.0)}, {})
    arrays, _, later = read_arrays(path, later="then/")
    assert list(arrays) == ["now"]
    write_arrays(path, {"now": np.zeros(2)}, {})
    assert later.under("then/")["a"].tolist() == [0, 1, 2, 3, 4]


def test_damage_in_what_is_read_later_is_refused_at_once(tmp_path):
    path = tmp_path / "a.gpdf"
    write_arrays(path, {"now": np.ones(2), "then": np.random.default_rng(0).normal(size=3000)}, {})
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 2] ^= 0xFF
    path.write_bytes(raw)
    with pytest.raises(SceneFileError, match="damaged"):
        read_arrays(path, later="then")


def test_a_file_that_was_written_over_since_is_an_error_and_no_answer(tmp_path):
    path = tmp_path / "a.gpdf"
    write_arrays(path, {"now": np.ones(2), "then/a": np.random.default_rng(0).normal(size=30000)}, {})
    later = read_arrays(path, later="then/")[2]
    path.write_bytes(b"x" * len(path.read_bytes()))
    with pytest.raises(SceneFileError, match="damaged"):
        later.under("then/")


def test_a_file_of_something_else_is_refused_and_nobody_is_advised_to_run_it(tmp_path):
    for content in (b"hello", pickle.dumps(["an object"])):
        (tmp_path / "a.gpdf").write_bytes(content)
        with pytest.raises(SceneFileError, match=r"damaged or no scene \(File is not a zip file\)"):
            read_arrays(tmp_path / "a.gpdf")
    np.savez(tmp_path / "b.npz", meta=np.array([object()]))
    with pytest.raises(SceneFileError, match="no arrays of numbers"):
        read_arrays(tmp_path / "b.npz")


def test_a_file_that_says_it_unpacks_to_all_memory_is_refused_before_memory_is_taken(tmp_path):
    path = tmp_path / "a.gpdf"
    write_arrays(path, {"a": np.zeros(10_000_000)}, {})
    assert path.stat().st_size < 80_000_000 / 1000
    with pytest.raises(SceneFileError, match="unpacks to more"):
        read_arrays(path)


def test_a_compressed_file_with_a_spoiled_byte_is_refused(tmp_path):
    np.savez_compressed(tmp_path / "a.npz", values=np.random.default_rng(0).normal(size=1000))
    whole = (tmp_path / "a.npz").read_bytes()
    for at in range(100, len(whole) - 200, 97):
        spoiled = bytearray(whole)
        spoiled[at] ^= 0xFF
        (tmp_path / "a.npz").write_bytes(spoiled)
        with pytest.raises(SceneFileError, match="damaged"):
            read_arrays(tmp_path / "a.npz")
