# KinCal: build, test and demo. `make help` lists the targets.
#
# CMakeLists.txt says what is compiled, CMakePresets.json in which variants. Products go to build/, the Python
# environment to .venv; both can be deleted at any time.

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.SUFFIXES:
MAKEFLAGS += --no-builtin-rules

Q        := $(if $(V),,@)
BUILD    := build
PYTHON   ?= python3
PY       := .venv/bin/python
export PYTHON
# Hundreds of programs start: each reads what the first one compiled.
unexport PYTHONDONTWRITEBYTECODE
# Those that one step may use; `make test` gives each of its steps one.
PROCESSORS ?= $(shell nproc)
export CMAKE_BUILD_PARALLEL_LEVEL := $(PROCESSORS)

.PHONY: help
help: ## list the targets (V=1 shows whole commands)
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  %-15s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

# ---- set-up: what is missing is installed, once; afterwards nothing here needs a network -------------

STAMP := $(BUILD)/stamp

.PHONY: setup setup-demo
setup: setup-demo $(STAMP)/apt-test .venv/.stamp-dev $(BUILD)/unity/src/unity.c ## all that tests need
setup-demo: $(STAMP)/apt-build .venv/.stamp $(BUILD)/musl/COPYRIGHT $(BUILD)/monocypher/LICENCE.md ## all that the demo needs

$(STAMP)/apt-%: .ci/packages.%
	@mkdir -p $(@D)
	@.ci/apt $<
	@touch $@
$(STAMP)/apt-test: | $(STAMP)/apt-build # one after the other also with -j: apt locks its database

.venv/.stamp: ground/requirements.lock ground/requirements-install.lock .ci/venv | $(STAMP)/apt-build
	.ci/venv ground/requirements.lock
	@touch $@

.venv/.stamp-dev: ground/requirements-dev.lock .venv/.stamp
	.ci/venv ground/requirements-dev.lock
	@touch $@

.venv/.stamp-bench: ground/requirements-bench.lock .venv/.stamp-dev
	.ci/venv ground/requirements-bench.lock
	@touch $@

$(BUILD)/unity/src/unity.c:
	.ci/unity $(BUILD)/unity

$(BUILD)/musl/COPYRIGHT: .ci/musl.sha256
	.ci/musl $(BUILD)/musl

$(BUILD)/monocypher/LICENCE.md: .ci/monocypher.sha256
	.ci/monocypher $(BUILD)/monocypher

.PHONY: lock
lock: ## resolve the Python requirements anew (needs the network)
	.ci/lock

# ---- build: a variant is a preset of CMake, and has its folder in build/ ------------------------------

.PHONY: build core fsw tagdet messages
build: $(BUILD)/rel/build.ninja ## everything that runs
	$(call compile,rel,all)

core: $(BUILD)/rel/build.ninja ## the flight core as a library, and the ground's build
	$(call compile,rel,core)

fsw: $(BUILD)/rel/build.ninja ## the flight process
	$(call compile,rel,kincal-fsw)

tagdet: $(BUILD)/rel/build.ninja ## the tag detector process
	$(call compile,rel,kincal-tagdet)

messages: $(BUILD)/rel/build.ninja ## LCM types for C and Python
	$(call compile,rel,messages)

# variant, targets. Locked: two of make's jobs may want the same folder, ninja expects to be alone there.
compile = $(Q)flock $(BUILD)/$1 cmake --build --preset $1 $(if $(V),--verbose) --target $2

# Only the first time, and for other presets: a build looks for other sources and CMake files by itself.
$(BUILD)/%/build.ninja: CMakePresets.json | $(STAMP)/apt-build $(BUILD)/musl/COPYRIGHT $(BUILD)/monocypher/LICENCE.md
	$(Q)mkdir -p $(@D) && flock $(@D) cmake --preset $* > $(@D).log || { cat $(@D).log; exit 1; }
	@touch $@

# ---- tests --------------------------------------------------------------------------------------------

JUNIT  := $(BUILD)/junit
PYTEST := $(PY) -m pytest -q -rsfE -c tests/pytest.ini
# variant, name of the report
ctest   = $(Q)ctest --test-dir $(BUILD)/$1 -j $(PROCESSORS) --progress --output-on-failure --no-tests=error \
    --output-junit $(CURDIR)/$(JUNIT)/$2.xml

.PHONY: units unit unit-san oracle integration ground-test workbench-test live-test lint-test
units: $(BUILD)/rel/build.ninja $(BUILD)/unity/src/unity.c
	$(call compile,rel,units)
unit: units ## unit tests
	$(call ctest,rel,unit)

# One build has sanitizers and counters: what they mean for each condition, `make cov` reads from the library, which has the
# whole core, and from the process, which has fsw/lcm.
COUNTED := $(BUILD)/cov/profile
unit-san: export LLVM_PROFILE_FILE = $(CURDIR)/$(COUNTED)/%m.profraw
unit-san: $(BUILD)/cov/build.ninja $(BUILD)/unity/src/unity.c ## unit tests under ASan and UBSan, which also counts for `make cov`
	$(call compile,cov,units kincal_shared kincal-fsw)
	@rm -rf $(COUNTED)
	$(call ctest,cov,unit-san)

oracle: core .venv/.stamp-dev ## the core's numbers against independent libraries
	$(PYTEST) tests/oracle --junitxml=$(JUNIT)/oracle.xml

integration: build .venv/.stamp-dev ## processes over LCM
	$(PYTEST) tests/integration --junitxml=$(JUNIT)/integration.xml

# Three steps, so that none is left alone at the end. Those that wait for a flight, a browser or a worker are one of
# them: they leave the processor to the others.
named     = $(foreach t,$1,$(filter tests/ground/test_$t.py,$(wildcard tests/ground/*.py)))
LIVE      := $(call named,campaign command console% corrected killed operat% recording two_holders)
WORKBENCH := $(call named,api arms background blind bounds claims_bench consistency export% findings hidden \
    identifiability promises reachable real_bench workbench% wrong_inputs)
ground-test: build .venv/.stamp-dev ## the ground tool, but for workbench-test and live-test
	$(PYTEST) tests/ground $(patsubst %,--ignore=%,$(LIVE) $(WORKBENCH)) --junitxml=$(JUNIT)/ground.xml

workbench-test: build .venv/.stamp-dev ## the model workbench: fits, diagnoses, exports
	$(PYTEST) $(WORKBENCH) --junitxml=$(JUNIT)/workbench.xml

live-test: build .venv/.stamp-dev ## the ground tool while flight runs: console, commands, kills, campaigns
	$(PYTEST) $(LIVE) --junitxml=$(JUNIT)/live.xml

lint-test: $(BUILD)/unity/src/unity.c .venv/.stamp-dev ## the checks find what they are there for
	$(PYTEST) tests/lint --junitxml=$(JUNIT)/lint.xml

.PHONY: test
test: ## everything a change has to pass, with a summary
	@$(MAKE) --no-print-directory -j4 -k setup build units || $(MAKE) --no-print-directory setup # a failed build is a step's
	@rm -rf $(JUNIT)
	@$(PYTHON) tests/suite.py --junit $(JUNIT) --logs $(BUILD)/log --first build --first unit \
	    --idle cov --idle mutation-short --idle sigma-short --idle wcet \
	    live-test workbench-test integration ground-test lint fuzz oracle lint-test size heapcheck

# libFuzzer under ASan and UBSan: a few seconds of each harness as part of the tests; more by SECONDS or RUNS, one
# harness by HARNESS. Inputs that reach something new stay in build/fuzz/corpus.
FUZZ = $(PYTHON) tests/fuzz/run.py $(BUILD)/$1/fuzz $(BUILD)/fuzz/corpus $(HARNESS)
.PHONY: fuzz fuzz-cov fuzz-seeds
fuzz: $(BUILD)/fuzz/build.ninja $(BUILD)/unity/src/unity.c $(STAMP)/apt-test ## fuzz tables, messages, store and sequences of steps (SECONDS or RUNS of each, HARNESS)
	$(call compile,fuzz,harnesses)
	$(Q)$(call FUZZ,fuzz) $(if $(SECONDS),--seconds $(SECONDS)) $(if $(RUNS),--runs $(RUNS))

fuzz-cov: $(BUILD)/fuzz-cov/build.ninja $(BUILD)/unity/src/unity.c $(STAMP)/apt-test ## lines and branches of flight that the inputs of `make fuzz` reach
	$(call compile,fuzz-cov,harnesses)
	$(Q)$(call FUZZ,fuzz-cov) --coverage $(wildcard fsw/*/)

fuzz-seeds: fuzz ## tests/fuzz/seeds anew from what was found
	$(Q)$(call FUZZ,fuzz) --pack

.PHONY: mutation mutation-short mutation-ground
mutation: $(BUILD)/rel/build.ninja $(BUILD)/unity/src/unity.c ## do the unit tests notice a changed token? (FILES or rooms, N of each, SEED, JOBS, PATIENCE; 5 min)
	$(call compile,rel,units)
	$(Q)$(PYTHON) tests/mutation.py $(FILES) $(if $(N),--number $(N)) $(if $(SEED),--seed $(SEED)) $(if $(JOBS),--jobs $(JOBS)) $(if $(PATIENCE),--patience $(PATIENCE))
mutation-short: ## a few of them, of what guards the arm and takes commands
	$(Q)$(MAKE) mutation FILES="fsw/motion/kc_guard.c fsw/command/kc_cmd.c fsw/app/kc_dispatch.c fsw/store/kc_change.c" N=5
mutation-ground: core messages .venv/.stamp-dev ## do the ground's tests notice a changed token of its safety code? (ROOMS, N of each, SEED, JOBS, PATIENCE; a second start goes on)
	$(Q)$(PY) tests/mutation_ground.py $(ROOMS) $(if $(N),--number $(N)) $(if $(SEED),--seed $(SEED)) $(if $(JOBS),--jobs $(JOBS)) $(if $(PATIENCE),--patience $(PATIENCE))

# The same bits everywhere: recorded calibrations give the same telemetry and tables on every CPU and with every compiler,
# also without an operating system. Unit tests on other CPUs besides. fma needs a processor that has it.
CROSS  := aarch64 riscv64 powerpc64
REPLAY := rel fma clang-plain clang-fma cortex-m7 $(CROSS)
.PHONY: cross $(CROSS:%=cross-%) $(REPLAY:%=replay-%)
cross: $(CROSS:%=cross-%) $(REPLAY:%=replay-%) ## other CPUs: unit tests, and calibrations bit for bit (installs compilers and qemu)
$(CROSS:%=cross-%): cross-%: $(STAMP)/apt-cross $(BUILD)/%/build.ninja $(BUILD)/unity/src/unity.c
	$(call compile,$*,units)
	$(call ctest,$*,$*)
$(REPLAY:%=replay-%): replay-%: $(BUILD)/cross/record.bin $(BUILD)/%/build.ninja $(BUILD)/unity/src/unity.c
	$(call compile,$*,replayed)
$(filter-out $(BUILD)/rel/%,$(REPLAY:%=$(BUILD)/%/build.ninja)): | $(STAMP)/apt-cross
$(BUILD)/clang%/build.ninja: | $(STAMP)/apt-test
$(BUILD)/fuzz/build.ninja $(BUILD)/fuzz-cov/build.ninja: | $(STAMP)/apt-test

.PHONY: record
$(BUILD)/cross/record.bin: record
record: core messages .venv/.stamp ## calibrations for the replay, and what it has to give
	$(Q)$(PY) tests/cross/record.py $(BUILD)/cross

# ---- measures of the flight core ----------------------------------------------------------------------

.PHONY: cov size heapcheck wcet wcet-search
$(BUILD)/cov/build.ninja: | $(STAMP)/apt-test
cov: unit-san ## lines, branches and conditions (MC/DC) of flight by the unit tests
	$(Q)llvm-profdata-19 merge -o $(BUILD)/cov/core.profdata $(COUNTED)
	$(Q)llvm-cov-19 export -instr-profile=$(BUILD)/cov/core.profdata $(BUILD)/cov/libkincal.so \
	    -object $(BUILD)/cov/kincal-fsw > $(BUILD)/cov/core.json
	$(Q)$(PYTHON) tests/coverage.py $(BUILD)/cov/core.json tests/coverage.csv

size: $(BUILD)/rel/build.ninja ## static bytes by module and worst stack
	$(call compile,rel,size)

heapcheck: $(BUILD)/rel/build.ninja ## fails when the core references a heap function
	$(call compile,rel,heapcheck)

wcet: $(BUILD)/rel/build.ninja $(BUILD)/unity/src/unity.c $(STAMP)/apt-wcet ## instructions of every step with all sizes at their limits (installs valgrind; CASES, 4 min)
	$(call compile,rel,wcet)
	$(Q)$(PYTHON) tests/bench/wcet.py $(CASES)

wcet-search: $(BUILD)/rel/build.ninja $(BUILD)/count/build.ninja $(BUILD)/unity/src/unity.c $(STAMP)/apt-wcet ## which tables that flight accepts take the most instructions? (MINUTES, SEED; a second start goes on)
	$(call compile,rel,wcet-search)
	$(call compile,count,wcet-search)
	$(Q)$(PYTHON) tests/bench/wcet_search.py $(if $(MINUTES),--minutes $(MINUTES)) $(if $(SEED),--seed $(SEED))

# ---- lint ---------------------------------------------------------------------------------------------

C_DIRS := fsw ground/native sim/native sim/tagdet
C_ALL   = $(shell find $(C_DIRS) tests/unit tests/system tests/cross tests/fuzz -name '*.[ch]' -o -name '*.[ch]pp')

.PHONY: lint lint-clang lint-tidy lint-cppcheck lint-misra lint-analyzer lint-format lint-direction lint-loops lint-requirements \
        lint-python lint-types \
        lint-layers lint-generated lint-glossary
lint: lint-clang lint-direction lint-loops lint-requirements lint-format lint-cppcheck lint-misra lint-analyzer lint-python lint-types lint-layers lint-generated lint-glossary ## all static checks

lint-clang lint-tidy &: $(BUILD)/clang/build.ninja $(STAMP)/apt-test ## clang's warnings (of tests: `make cov`), clang-tidy, every header alone
	$(call compile,clang,all all_verify_interface_header_sets)

# uninitvar is off: cppcheck 2.10 does not see arrays filled through a pointer to their struct's member; gcc,
# clang-tidy and the sanitizers look for the same. -UKC_GROUND: flight's limits, which the messages have too.
lint-cppcheck: messages $(STAMP)/apt-test ## cppcheck
	@mkdir -p $(BUILD)/cppcheck
	$(Q)cppcheck --quiet --error-exitcode=1 --inline-suppr --enable=warning,performance,portability \
	    --std=c11 --std=c++17 -UKC_GROUND --cppcheck-build-dir=$(BUILD)/cppcheck --suppress=missingIncludeSystem \
	    --suppress=uninitvar $(addprefix -I,$(wildcard fsw/*/ $(BUILD)/made/*/)) -I$(BUILD)/gen -I$(BUILD)/gen-all --suppress='*:$(BUILD)/gen/*' $(C_DIRS)

lint-misra: messages $(STAMP)/apt-test ## MISRA C:2012 over the core: no deviation that tests/lint/misra.csv does not decide
	$(Q)$(PYTHON) tests/lint/misra.py $(BUILD)/misra

# The check for uninitialised values is off for the reason above: gcc 12 takes one turn of a loop that fills an array.
CORE_ROOMS := $(filter-out eigen,$(shell awk -F '[( )]' '/^kc_room/ { print $$2 }' fsw/CMakeLists.txt))
ANALYZED = $(patsubst %.c,$(BUILD)/analyzer/%.o,$(wildcard $(CORE_ROOMS:%=fsw/%/*.c)))
lint-analyzer: $(ANALYZED) ## gcc -fanalyzer over the core
$(ANALYZED): $(BUILD)/analyzer/%.o: %.c Makefile | messages
	@mkdir -p $(@D)
	$(Q)gcc -std=c11 -O2 -fanalyzer -Werror -Wno-analyzer-use-of-uninitialized-value -MMD -MP \
	    $(addprefix -I,$(wildcard fsw/*/ $(BUILD)/made/*/)) -isystem $(BUILD)/monocypher/src -c $< -o $@
-include $(ANALYZED:.o=.d)

lint-format: $(STAMP)/apt-test ## C and C++ layout
	$(Q)clang-format-19 --dry-run --Werror $(C_ALL)

lint-direction: ## what includes name; the simulator loads no flight code
	$(Q)$(PYTHON) tests/lint/direction.py

lint-requirements: ## every requirement of flight has a test, every test of flight a requirement
	$(Q)$(PYTHON) tests/lint/requirements.py

lint-loops: ## every loop of the core has a named bound (build/LOOPS.md)
	$(Q)$(PYTHON) tests/lint/loops.py

lint-glossary: ## one vocabulary, every term in docs/GLOSSARY.md, links lead somewhere
	$(Q)$(PYTHON) tests/lint/glossary.py

lint-python: | .venv/.stamp-dev ## ruff: rules and lay-out
	$(Q).venv/bin/ruff check --output-format=concise --quiet --config tests/ruff.toml ground sim tests
	$(Q).venv/bin/ruff format --quiet --check --config tests/ruff.toml ground sim tests || \
	    { .venv/bin/ruff format --check --config tests/ruff.toml ground sim tests; exit 1; }

lint-types: stubs | .venv/.stamp-dev ## mypy, strict, over the ground tool and the simulator
	$(Q)$(PY) tests/lint/typed.py --config-file tests/mypy.ini ground/kincal ground/kincal_shared sim/kincal_sim

lint-layers: | .venv/.stamp-dev ## import-linter: Python packages import downwards
	$(Q).venv/bin/lint-imports --config tests/layers.ini --cache-dir $(BUILD)/import-linter

lint-generated: core messages .venv/.stamp-dev $(STAMP)/tables ## generated files are what their sources say
	$(Q)$(PYTHON) tests/lint/events.py --check
	$(Q)$(PY) ground/gen_docs.py --check
	$(Q)$(PY) ground/stubs.py --check
	$(Q)$(PY) ground/message_stubs.py --check

# Half a minute: only when something that tables are made from or by has changed.
$(STAMP)/tables: $(wildcard tables/src/* tables/bin/* $(addsuffix /*.py,ground/kincal ground/kincal/api \
    ground/kincal/flight ground/kincal/space ground/kincal_shared ground/kincal_shared/schema)) \
    tests/lint/tables.py $(BUILD)/libkincal.so .venv/.stamp-dev
	$(Q)$(PY) tests/lint/tables.py
	@touch $@
$(BUILD)/libkincal.so: core ;

.PHONY: format dict docs stubs tables pictures
format: $(STAMP)/apt-test .venv/.stamp-dev ## lay out C, C++ and Python
	clang-format-19 -i $(C_ALL)
	.venv/bin/ruff check --quiet --fix-only --select I --config tests/ruff.toml ground sim tests
	.venv/bin/ruff format --quiet --config tests/ruff.toml ground sim tests

dict: ## docs/EVENTS.md and the tables of docs/OPERATIONS.md from the event list
	$(PYTHON) tests/lint/events.py

docs: dict core messages .venv/.stamp stubs ## the generated parts of docs/
	$(PY) ground/gen_docs.py

stubs: core .venv/.stamp ## types of flight core and messages for mypy, JSON Schemas for editors, lists of channels and variables
	$(Q)$(PY) ground/stubs.py
	$(Q)$(PY) ground/message_stubs.py
	$(Q).venv/bin/kincal schema -o $(BUILD)/schema >$(BUILD)/schema.log

tables: core .venv/.stamp ## tables/bin from tables/src
	.venv/bin/kincal table build tables/src tables/bin

pictures: setup build ## docs/img made again: the sheet of a run through pixels, the tutorial's figures
	.venv/bin/kincal run paper --accept ground --out $(BUILD)/pictures
	cp $(BUILD)/pictures/summary.png docs/img/run.png
	$(PY) ground/gen_tutorial.py

# ---- running ------------------------------------------------------------------------------------------

.PHONY: demo hil bench scaling bench-samples blind study alarm montecarlo sigma camera-chain campaign-faults assurance occlusion real halves
demo: setup-demo build ## the paper's error set through pixels; picture and report in build/demo
	.venv/bin/kincal run sim/scenarios/paper.toml --accept ground --out $(BUILD)/demo

hil: setup build ## the scenarios as separate processes at real-time pace (URL=... for another LCM network)
	.venv/bin/python -m kincal_sim.hil $(if $(URL),--url $(URL))

bench: setup build .venv/.stamp-bench ## how fast against other software? (ONLY="kernel qp", PROBLEMS; WRITE=1 for docs/BENCHMARKS.md)
	.venv/bin/python tests/bench/bench.py $(if $(ONLY),--only $(ONLY)) $(if $(PROBLEMS),--problems $(PROBLEMS)) \
	    $(if $(WRITE),--write)

scaling: setup core messages ## what would a million cases of a campaign take on a cluster? (SIZES, POSES; WRITE=1 for docs/SCALING.md)
	.venv/bin/python tests/bench/scaling.py $(if $(SIZES),--sizes $(SIZES)) $(if $(POSES),--poses $(POSES)) $(if $(WRITE),--write)

bench-samples: setup build ## held-out error against number of poses, for all acquisitions
	.venv/bin/python tests/bench/samples.py
	.venv/bin/python tests/bench/samples.py --space tables/bin/space.tbl

study: setup core messages .venv/.stamp-bench ## poses, seconds and joules until an arm is calibrated, by design (SEEDS, FIRST, DESIGNS, SCENARIOS, SET, PIXELS=1; WRITE=1 for docs/STUDY.md)
	.venv/bin/python tests/bench/study.py $(if $(SEEDS),--seeds $(SEEDS)) $(if $(FIRST),--first $(FIRST)) \
	    $(if $(DESIGNS),--designs $(DESIGNS)) $(if $(SCENARIOS),--scenarios $(SCENARIOS)) $(if $(SET),--set $(SET)) \
	    $(if $(PIXELS),--pixels) $(if $(WRITE),--write)

blind: setup core ## sealed hidden effects: what the workbench finds, and whether its probabilities are honest
	.venv/bin/python tests/bench/blind.py

sigma: setup build ## calibrations through pixels: is the stated sigma what the error is? (RUNS, POSES, SEED)
	.venv/bin/python tests/bench/sigma.py $(if $(RUNS),--runs $(RUNS)) $(if $(POSES),--poses $(POSES)) $(if $(SEED),--seed $(SEED)) \
	    $(if $(OUT),--out $(OUT))

.PHONY: sigma-short
sigma-short: ## a few short ones, which determine as many coefficients each
	@rm -f $(BUILD)/sigma-short.jsonl
	$(Q)$(MAKE) sigma RUNS=6 POSES=8 OUT=$(BUILD)/sigma-short.jsonl

alarm: setup core ## from the monitor's alarm to a calibrated arm: visits, and what a wrong suspicion does (SEEDS, FIRST)
	.venv/bin/python tests/bench/alarm.py $(if $(SEEDS),--seeds $(SEEDS)) $(if $(FIRST),--first $(FIRST))

montecarlo: setup core ## thousands of recalibrations of wrong arms: contacts, unverified commands, how they end (RUNS, OUTSIDE, SEED)
	.venv/bin/python tests/bench/montecarlo.py $(if $(RUNS),--runs $(RUNS)) $(if $(OUTSIDE),--outside $(OUTSIDE)) $(if $(SEED),--seed $(SEED))

campaign-faults: setup core ## every kind of fault between flight and its surroundings (SEEDS, FIRST; PAIRS=1: two at once; WRITE=1 for docs/ASSURANCE.md)
	.venv/bin/python tests/bench/faults.py $(if $(SEEDS),--seeds $(SEEDS)) $(if $(FIRST),--first $(FIRST)) $(if $(PAIRS),--pairs --out $(BUILD)/campaigns/fault-pairs) $(if $(WRITE),--write)

camera-chain: setup core ## errors of camera, pan-tilt unit and tags: are the stated errors true? (SEEDS, FIRST)
	.venv/bin/python tests/bench/camera_chain.py $(if $(SEEDS),--seeds $(SEEDS)) $(if $(FIRST),--first $(FIRST))

.PHONY: coverage-stop
coverage-stop: setup core ## calibrations that stop when good enough: is the error within the stated bound? (SEEDS, FIRST, SET)
	.venv/bin/python tests/bench/coverage_stop.py $(if $(SEEDS),--seeds $(SEEDS)) $(if $(FIRST),--first $(FIRST)) \
	    $(if $(SET),--set $(SET))

assurance: setup build ## every long check of the flight core, for docs/ASSURANCE.md (CHECKS="wcet cov"; all: hours)
	$(Q)$(PYTHON) tests/assurance.py $(CHECKS)

occlusion: setup core ## drawn frames against the search's verdict on what the arm hides
	.venv/bin/python tests/bench/occlusion.py

real: setup core ## measured sets of real arms: what the diagnosis names and gains (SETS=folder, ONLY=names, JSON=file)
	.venv/bin/python tests/bench/real.py $(SETS) $(if $(ONLY),--only $(ONLY)) $(if $(JSON),--json $(JSON))

halves: setup core ## measured sets of real arms: the same answer on random halves, silence on permuted residuals, claims against poses kept away (SETS, ONLY)
	.venv/bin/python tests/bench/halves.py $(SETS) $(if $(ONLY),--only $(ONLY))
	.venv/bin/python tests/bench/claims.py $(SETS) $(if $(ONLY),--only $(ONLY))

# ---- tidying ------------------------------------------------------------------------------------------

.PHONY: clean distclean
clean: ## delete what was built; keep the downloads
	rm -rf $(filter-out $(BUILD)/unity $(BUILD)/musl $(BUILD)/monocypher $(STAMP),$(wildcard $(BUILD)/*))

distclean: ## delete the downloads too
	rm -rf $(BUILD) .venv
