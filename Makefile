# Each target sets up what it needs.
.PHONY: demo test test-slow test-lerobot test-cluster chaos faults scene scene-fit check docs figures release-check bench models sizes detector-pages clean

demo:  ## run the demo without hardware: a simulated rig, slip events, a labelled dataset
	@deploy/prepare demo
	.venv/bin/slipflow demo --for 20s --out recordings

test: check  ## run the static checks, then the tests
	.venv/bin/python -m pytest -n 2 --dist worksteal -m "not slow and not cluster"

test-slow:  ## run the tests that take longer than a minute
	@deploy/prepare test
	.venv/bin/python -m pytest -m slow

test-lerobot: LEROBOT = $(CURDIR)/.venv/lerobot
test-lerobot:  ## read an export with LeRobot's own loader: 180 MB more
	@deploy/prepare test
	test -d $(LEROBOT) || .venv/bin/python -m venv $(LEROBOT)
	$(LEROBOT)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --requirement tests/lerobot.txt
	.venv/bin/python -c 'import site; print(*site.getsitepackages())' >$$(echo $(LEROBOT)/lib/python3*/site-packages)/base.pth
	LEROBOT_PYTHON=$(LEROBOT)/bin/python .venv/bin/python -m pytest tests/test_docs_lerobot.py

test-cluster:  ## replay on a Dask cluster on this machine and kill its parts: about two minutes
	@deploy/prepare test
	.venv/bin/python -m pytest -m cluster

chaos:  ## test crash safety: kills of processes; prints a table: six minutes
	@deploy/prepare test
	.venv/bin/python -m tests.chaos.run

faults:  ## simulate the whole system under drawn faults until stopped; prints schedules per minute
	@deploy/prepare test
	.venv/bin/python -m tests.faults

scene:  ## print how well the simulated scene meets its targets, for docs/explanations/scene.md; judge=FILE trace=FILE
	@deploy/prepare test
	.venv/bin/python -m tests.scene.scene_fit --judge $(judge) --trace $(trace) --rounds 0 --ablate

scene-fit:  ## fit the constants of the scene to real data, half an hour on two cores; judge=FILE trace=FILE
	@deploy/prepare test
	.venv/bin/python -m tests.scene.scene_fit --judge $(judge) --trace $(trace)

check:  ## check format, lint, types and import contracts
	@deploy/prepare test
	.venv/bin/ruff format --check
	.venv/bin/ruff check
	.venv/bin/lint-imports --no-logo
	.venv/bin/mypy

docs: export NO_MKDOCS_2_WARNING=1
docs:  ## build the documentation site into build/site; warnings are errors
	@deploy/prepare test
	.venv/bin/python -m tests.reference_pages
	.venv/bin/mkdocs build --quiet

figures:  ## retake the screenshots of the live page and of show in docs/figures, on an idle machine
	@deploy/prepare test
	.venv/bin/python -m tests.page_figures docs/figures

release-check:  ## build wheel and sdist into dist, compare their files with git, run the wheel in a new environment
	@deploy/prepare test
	.venv/bin/python -m tests.release_check

bench:  ## run the benchmarks and print their tables
	@deploy/prepare test
	for name in engine live_path replay; do \
	    .venv/bin/python -m tests.benchmarks.bench_$$name || exit 1; done

models sizes detector-pages: export PATH := $(CURDIR)/.venv/bin:$(PATH)
models sizes: export OMP_NUM_THREADS := 1
models sizes: DATA := $(addprefix models/,paper-0 paper-1 paper-2 wide-3 wide-4 wide-5 slow-3 slow-4 calm-3 calm-4 grasps-3 grasps-4 grasps-5 grasps-6 grasps-7)
models: PAPER := train models/paper-0 --method
models:  ## train the models in storage/trained: an hour on two cores
	@deploy/prepare test
	mkdir -p models
	for name in $(notdir $(DATA)); do rm -rf models/$$name; \
	    slipflow simulate models/$$name --plan $${name%-*} --seed $${name#*-} || exit 1; done
	{ echo "train $(DATA) -o models/tcn.safetensors"; \
	  for network in paper_tcn frequency_cnn; do \
	    echo "$(PAPER) $$network -o models/$$network.safetensors"; done; \
	} | xargs -P 2 -L 1 slipflow
	for name in tcn paper_tcn frequency_cnn; do \
	    cp models/$$name.safetensors models/$$name.json storage/trained/ || exit 1; done

sizes:  ## train the tcn in ten sizes and print speed against accuracy, after `make models`: hours; strokes=, grasps=, trace=: datasets
	python -m tests.benchmarks.bench_sizes models --train $(DATA) --paper models/paper-0 \
	    --strokes $(strokes) --grasps $(grasps) --trace $(trace) --out docs/explanations/detectors/sizes.svg

detector-pages:  ## print the tables and figures of docs/explanations/detectors into models/pages, after `make models`: half an hour
	slipflow evaluate models/paper-0 --chart --out models/pages
	slipflow evaluate --stress $(addprefix --method ,tcn paper_tcn psd) --out models/pages
	cp models/pages/*.svg docs/explanations/detectors/

clean:  ## delete everything that was set up or built
	rm -rf .venv dist .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
