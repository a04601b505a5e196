import pytest
from numba.core import caching
from numba.core.registry import CPUDispatcher

from operators.compilation import compile_function


def test_a_function_is_compiled_where_no_cache_can_be_written(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])

    @compile_function()
    def twice(value: int) -> int:
        return 2 * value

    assert isinstance(twice, CPUDispatcher)
    assert twice(21) == 42
