import pytest

from flows.run.processes import one_thread


def test_torch_has_one_thread_inside_and_its_former_number_after() -> None:
    torch = pytest.importorskip("torch")
    had = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        with one_thread():
            assert torch.get_num_threads() == 1
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(had)


def test_the_libraries_of_numpy_and_scikit_learn_have_one_thread_inside() -> None:
    pytest.importorskip("sklearn")
    pools = pytest.importorskip("threadpoolctl")
    with one_thread():
        inside = pools.threadpool_info()
    assert {pool["num_threads"] for pool in inside} == {1}
    assert {"blas", "openmp"} <= {pool["user_api"] for pool in inside}
