# Each target sets up what it needs.
.PHONY: demo test test-slow check bench clean

demo:  ## the main job with nothing attached: a simulated rig, slip events, a labelled dataset
	@deploy/prepare demo
	.venv/bin/slipflow demo --for 20s --out recordings

test: check  ## everything that must hold: static checks, then the tests
	.venv/bin/python -m pytest -n 2 -m "not slow"

test-slow:  ## the tests that take longer than a minute
	@deploy/prepare test
	.venv/bin/python -m pytest -m slow

check:  ## format, lint, types, import contracts
	@deploy/prepare test
	.venv/bin/ruff format --check
	.venv/bin/ruff check
	.venv/bin/mypy
	.venv/bin/pyright
	.venv/bin/lint-imports --no-logo

bench:  ## measure; prints tables
	@deploy/prepare test
	.venv/bin/python tests/benchmarks/bench_engine.py
	.venv/bin/python tests/benchmarks/bench_scene.py

clean:  ## forget everything that was set up or built
	rm -rf .venv dist .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
