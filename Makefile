# Everything runs in .venv, which is made on first use: "make demo" needs only Python and make.
PYTHON ?= python3
DEMO_SECONDS ?= 15
DEMO_DIR ?= demo_out
TIMING ?= kaist_timing
TABLE_DIR ?= table_out
BENCH_DIR ?= bench_out
PICTURES_DIR ?= pictures_out
MUTANTS_DIR ?= mutants_out
MUTANTS ?= 60
TEST_JOBS ?= 2
BENCH_LONG ?= 600
BENCH_HOUR ?= 60
TABLE_CONFIG ?= config/kaist.yaml
JOBS ?= 1

BIN := .venv/bin
INSTALLED := .venv/.installed
MAPPER := $(BIN)/incremental_mapper
export PIP_DISABLE_PIP_VERSION_CHECK := 1

.PHONY: help install demo bare colcon table bench test mutants lint types check format docs pictures view-pictures clean

help:
	@echo 'make demo    simulate a drive of DEMO_SECONDS ($(DEMO_SECONDS)) seconds, map it, draw it, play it'
	@echo '             into the ROS node and check that the node makes the same of it'
	@echo 'make bare    install without extras into a folder of its own, and try what works there'
	@echo 'make colcon  build and test in a colcon workspace, with colcon from PyPI'
	@echo 'make table   evaluate all strategies on simulated drives with the stamps of the paper, which'
	@echo '             TIMING=DIR holds, and write docs/table.md, .csv and .tex; JOBS=N side by side'
	@echo 'make bench   all figures of the speed in one table; BENCH_LONG=S and BENCH_HOUR=MIN set the'
	@echo '             long drives (600 s and 60 min, 0 leaves them out); takes half an hour'
	@echo 'make test    run the tests, TEST_JOBS ($(TEST_JOBS)) files at a time'
	@echo 'make mutants  put MUTANTS ($(MUTANTS)) faults into each core room and count those that a test'
	@echo '             notices; 0 tries all that are possible; takes about an hour, and goes on where it ended'
	@echo 'make lint    ruff and the import contracts'
	@echo 'make types   mypy'
	@echo 'make check   lint, types and test'
	@echo 'make format  let ruff mend formatting and imports'
	@echo 'make docs    the pages in site/, and whether all that they tell people to type exists'
	@echo 'make pictures  draw the pictures of the pages again, from a simulated drive'
	@echo 'make view-pictures  the same of the pictures of Rerun; needs Vulkan'
	@echo 'make clean   remove .venv, caches, site and the output of demo, table, bench, pictures and mutants'
	@echo 'PYTHON=python3.12 chooses the interpreter that .venv is made with (3.11 or later)'

install: $(INSTALLED)

$(INSTALLED): setup.py setup.cfg pyproject.toml
	@command -v $(PYTHON) >/dev/null || \
		{ echo '$(PYTHON) is not installed; name another with make PYTHON=...' >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "$(PYTHON) is $$($(PYTHON) -V 2>&1), 3.11 or later is needed; name another with" \
		'make PYTHON=python3.12' >&2; exit 1; }
	@test -x $(BIN)/pip || $(PYTHON) -m venv --clear .venv
	$(BIN)/python -m pip install --quiet --editable '.[ros,sim,report,formats,test,docs]'
	@# Nobody need wait for the compiler later.
	$(BIN)/python -c 'from incremental_mapper import Config, Mapper; Mapper(Config()).close()'
	@touch $@

demo: $(INSTALLED)
	$(MAPPER) simulate $(DEMO_DIR)/drive --scene street --motion mixed \
		--duration $(DEMO_SECONDS) --seed 1 --force
	$(MAPPER) convert $(DEMO_DIR)/drive $(DEMO_DIR)/bag --force
	$(MAPPER) map $(DEMO_DIR)/bag $(DEMO_DIR)/map --config config/kaist.yaml --force
	@echo
	@echo 'The same bag, played into the ROS node:'
	@rm -rf $(DEMO_DIR)/node $(DEMO_DIR)/node_*
	@$(BIN)/python examples/play_into_node.py $(DEMO_DIR)/bag $(DEMO_DIR)/map $(DEMO_DIR)/node \
		--config config/kaist.yaml
	@echo
	@echo 'Pictures:'
	@ls $(DEMO_DIR)/map/*.png

bare: $(INSTALLED)
	PYTHON=$(PYTHON) .ci/bare

colcon: $(INSTALLED)
	PYTHON=$(PYTHON) .ci/colcon

table: $(INSTALLED)
	@test -d '$(TIMING)' || { echo 'TIMING=$(TIMING) is no folder; name the one with the stamps' \
		'of the sequences, such as constant_speed_urban-26.csv' >&2; exit 1; }
	$(BIN)/python benchmarks/timing_drives.py '$(TIMING)' $(TABLE_DIR)/drives
	$(MAPPER) evaluate $(TABLE_DIR)/drives/* --out $(TABLE_DIR)/evaluation --jobs $(JOBS) \
		--strategies base,mom,mom@0,min_time_shift,min_solver_error,fewest \
		--config $(TABLE_CONFIG) --reference docs/paper.csv \
		--caption 'Simulated street drives that carry the real core stamps of twelve KAIST sequences.'
	cp $(TABLE_DIR)/evaluation/table.md $(TABLE_DIR)/evaluation/table.csv \
		$(TABLE_DIR)/evaluation/table.tex docs

bench: $(INSTALLED)
	$(BIN)/python benchmarks/bench.py $(BENCH_DIR) --long $(BENCH_LONG) --hour $(BENCH_HOUR)

test: $(INSTALLED)
	$(BIN)/python -m pytest -n $(TEST_JOBS) --dist loadfile

mutants: $(INSTALLED)
	$(BIN)/python benchmarks/mutants.py $(MUTANTS_DIR) --per-room $(MUTANTS) --jobs $(JOBS)

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

types: $(INSTALLED)
	$(BIN)/mypy

check: lint types test

format: $(INSTALLED)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# NO_MKDOCS_2_WARNING silences what the theme says of its successor; every warning ends the build.
docs: $(INSTALLED)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	$(BIN)/python docs/tools/check_pages.py --site site

pictures: $(INSTALLED)
	$(MAPPER) simulate $(PICTURES_DIR)/drive --scene street --motion mixed --duration 60 --seed 1 --force
	$(MAPPER) evaluate $(PICTURES_DIR)/drive --out $(PICTURES_DIR)/runs --config config/kaist.yaml \
		--strategies base,mom
	$(BIN)/python docs/tools/pictures.py $(PICTURES_DIR)/runs/drive $(PICTURES_DIR)/drive docs/pictures
	$(BIN)/python examples/figure2.py docs/figure2.png

# Needs Vulkan; without a graphics card: apt-get install mesa-vulkan-drivers
view-pictures: $(INSTALLED)
	$(BIN)/python -m pip install --quiet --editable '.[view]'
	$(MAPPER) simulate $(PICTURES_DIR)/drive --scene street --motion mixed --duration 60 --seed 1 --force
	PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/python docs/tools/rerun_pictures.py --live docs/pictures/rerun_live.png 9 \
		$(MAPPER) map $(PICTURES_DIR)/drive $(PICTURES_DIR)/shown --config config/kaist.yaml --force --view
	$(MAPPER) view $(PICTURES_DIR)/shown --save $(PICTURES_DIR)/shown.rrd
	PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/python docs/tools/rerun_pictures.py $(PICTURES_DIR)/shown.rrd docs/pictures/rerun_run.png

clean:
	rm -rf .venv $(DEMO_DIR) $(BENCH_DIR) $(TABLE_DIR) $(PICTURES_DIR) $(MUTANTS_DIR) site build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache \
		.hypothesis .import_linter_cache
